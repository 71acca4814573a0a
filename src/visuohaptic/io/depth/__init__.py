"""Reading and writing of depth images, depth sequences and camera trajectories."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
