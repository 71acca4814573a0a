"""Navigation among movable obstacles (NAMO): plans with pushes or detours, joint graph, policies, replanning, path following (Alt 2016, Sec. 4.4)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
