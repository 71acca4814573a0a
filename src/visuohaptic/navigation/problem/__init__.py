"""The planning problem: robot, movable objects, cost and failure probability of a push, node types, resulting plan (Alt 2016, Sec. 4.2.1)."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
