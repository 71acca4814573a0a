"""Deformation of containers: shapes, shell model, contents, stiffness maps (Alt 2016, Sec. 6.1)."""

from ..core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
