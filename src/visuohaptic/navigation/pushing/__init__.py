"""Quasi-static pushing: object models, simulation, local costmaps, direct and sideward pushes (Alt 2016, Sec. 4.3)."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
