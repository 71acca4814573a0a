"""Tasks of a mobile base: explore an obstacle by pushing it, map a room by touch, navigate among movable obstacles."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
