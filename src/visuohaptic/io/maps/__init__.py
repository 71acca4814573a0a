"""Occupancy maps in the format of map_server."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
