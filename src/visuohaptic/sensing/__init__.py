"""From images to forces, shapes and motion: foam, primitives, events, haptic tags (Alt 2016, chapter 3 and 4.1)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
