"""Contours along constraint lines with sub-pixel accuracy (Alt 2016, Sec. 2.3.1)."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
