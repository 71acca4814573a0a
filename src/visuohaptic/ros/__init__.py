"""Real robots over ROS 2, with pip alone: a node that speaks as rmw_zenoh does, and adapters to ``robots``."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
