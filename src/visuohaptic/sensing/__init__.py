"""From images to forces, shapes and motion: foam, primitives, events, haptic tags (Alt 2016, chapter 3 and 4.1)."""

from ..core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
