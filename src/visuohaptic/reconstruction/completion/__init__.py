"""Completion of surfaces by touch, and planning of the next touch (Alt 2016, Sec. 5.4)."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
