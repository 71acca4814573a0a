"""Wire formats of ROS 2 nodes over zenoh: CDR, type hashes, discovery."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
