"""Grasp planning on deformable containers: where to put two fingers, and how hard to push (Alt 2016, Sec. 6.2)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
