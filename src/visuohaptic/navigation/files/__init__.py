"""Route graphs as GeoJSON for Nav2, joint graphs, and layers of a costmap as images."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
