"""Navigation graph and regions of a costmap, updated in place; shortest and any-angle paths by string pulling (Alt 2016, Sec. 4.2)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
