"""A robot, or a simulated world, in a separate process, accessed only through the robot protocols."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
