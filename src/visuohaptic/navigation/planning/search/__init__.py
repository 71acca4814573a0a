"""A* over pushes: search domain, admissible heuristic, successors, weighted A* passes (Alt 2016, Sec. 4.2.1)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
