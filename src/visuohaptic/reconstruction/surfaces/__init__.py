"""Implicit surfaces: radial basis functions and biharmonic fields (Alt 2016, Sec. 5.3)."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
