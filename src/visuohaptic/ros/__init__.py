"""Interface to ROS 2 robots, installable with pip alone: a node compatible with rmw_zenoh, and adapters to ``robots``."""

from ..core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
