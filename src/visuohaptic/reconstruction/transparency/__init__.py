"""Transparent parts found by missing and inconsistent depth (Alt 2016, Sec. 5.2)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
