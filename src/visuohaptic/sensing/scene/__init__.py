"""Forward camera view: floor motion, obstacles and the pushed object."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
