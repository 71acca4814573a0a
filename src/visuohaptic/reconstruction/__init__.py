"""Geometry from vision and touch: fusion, transparent objects, completion (Alt 2016, Ch. 5)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
