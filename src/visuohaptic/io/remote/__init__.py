"""A robot, or a simulated world, in a process of its own: only the robot's protocols cross."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
