"""Triangle meshes in, PLY out, and what is wrong with a mesh."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
