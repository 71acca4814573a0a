"""Local planners of direct and sideward pushes, and their monitor (Alt 2016, Sec. 4.3.1 and 4.3.2)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
