"""Where a pushed object may go, on a costmap around it (Alt 2016, Sec. 4.3.1), and where it goes in MuJoCo."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
