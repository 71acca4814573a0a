"""Navigation graph and regions of a costmap; shortest and any-angle paths by string pulling (Alt 2016, Sec. 4.2)."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
