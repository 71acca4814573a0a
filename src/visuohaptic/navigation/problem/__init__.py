"""The planning problem: robot, movable objects, cost and failure probability of a push, node types, resulting plan (Alt 2016, Sec. 4.2.1)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
