"""Pixels only: contours along lines, templates and tags, point flow, homographies (Alt 2016, Sec. 2.3)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
