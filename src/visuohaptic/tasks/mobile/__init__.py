"""Tasks of a mobile base: explore an obstacle by pushing it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
