"""Force, pressure and shape from a strip of foam that a camera watches (Alt 2016, Sec. 3.2 and 3.3)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
