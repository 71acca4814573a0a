"""Push goals of an object on a costmap around it (Alt 2016, Sec. 4.3.1), and simulation of pushes in MuJoCo."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
