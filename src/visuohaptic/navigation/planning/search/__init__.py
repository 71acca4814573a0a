"""A* over pushes: search domain, admissible heuristic, successors, weighted A* passes (Alt 2016, Sec. 4.2.1)."""

from ....core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
