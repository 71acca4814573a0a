"""The local planner of direct pushes on a costmap around the object (Alt 2016, Sec. 4.3.1)."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
