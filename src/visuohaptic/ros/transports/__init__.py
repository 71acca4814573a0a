"""Transports of a node's messages: zenoh, ROS 2 itself (rclpy), or Cyclone DDS."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
