"""A* over pushes among movable obstacles: search domain, admissible heuristic, successors and queue (Alt 2016, Sec. 4.2.1)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
