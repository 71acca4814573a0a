"""A map drawn by touch alone (Alt 2016, Sec. 3.6)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
