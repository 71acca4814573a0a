"""Route graphs as GeoJSON for Nav2, joint graphs, and layers of a costmap as images."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
