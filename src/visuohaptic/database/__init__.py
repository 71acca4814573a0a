"""What a robot remembers: local and shared object databases, search, merging and synchronisation (Alt 2016, Sec. 6.3.3)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
