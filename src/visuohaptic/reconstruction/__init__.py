"""Geometry from vision and touch: fusion, transparent objects, completion (Alt 2016, Ch. 5)."""

from ..core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
