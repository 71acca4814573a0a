"""Robots with ROS 2 topics, implementing the robot protocols of tasks."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
