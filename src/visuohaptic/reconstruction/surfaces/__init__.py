"""Implicit surfaces: radial basis functions and biharmonic fields (Alt 2016, Sec. 5.3)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
