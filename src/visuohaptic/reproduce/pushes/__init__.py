"""Local planners of direct and sideward pushes, and their monitor (Alt 2016, Sec. 4.3.1 and 4.3.2)."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
