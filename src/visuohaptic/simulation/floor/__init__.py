"""Rigid-body simulation of objects on a floor."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
