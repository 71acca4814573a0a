"""Occupancy grid maps from laser scans (scan matching) and from touch (haptic map), and doors found on them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
