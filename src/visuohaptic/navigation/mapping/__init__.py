"""Occupancy grid maps from laser scans (scan matching) and from touch (haptic map), and doors found on them."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
