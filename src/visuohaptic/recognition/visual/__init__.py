"""What an object may be by sight: visual words, shape, and the prior that they give."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
