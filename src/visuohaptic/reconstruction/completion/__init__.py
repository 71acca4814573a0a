"""Surfaces completed by touch, and where to touch next (Alt 2016, Sec. 5.4)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
