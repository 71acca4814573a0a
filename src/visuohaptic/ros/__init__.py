"""Real robots over ROS 2, with pip alone: a node that speaks as rmw_zenoh does, and adapters to ``robots``."""

from ..core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
