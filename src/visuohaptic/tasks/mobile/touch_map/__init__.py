"""Mapping of a room by touch alone (Alt 2016, Sec. 3.6)."""

from ....core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
