"""Exploration within a time budget: which unknown objects are worth touching, and in which order (Alt 2016, Eq. (4.2))."""

from ....core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
