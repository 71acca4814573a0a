"""Costmaps: clearance (distance transform), travel cost and reachability of each cell, and footprints of obstacles."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
