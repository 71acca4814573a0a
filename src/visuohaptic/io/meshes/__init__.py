"""Triangle meshes in, PLY out, and what is wrong with a mesh."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
