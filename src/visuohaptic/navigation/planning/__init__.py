"""Navigation among movable obstacles (NAMO): search, joint graph, policies and path tracking (Alt 2016, Sec. 4.4)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
