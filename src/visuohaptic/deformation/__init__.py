"""How a container deforms: shapes, shells, contents, stiffness maps (Alt 2016, Sec. 6.1)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
