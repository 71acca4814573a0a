"""Six axes of force and moment from templates on a bending rod (Alt 2016, Sec. 3.2 and 3.4)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
