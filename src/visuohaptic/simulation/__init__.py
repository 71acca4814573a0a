"""Worlds, robots and cameras that make the truth of tests and demo; never what is tested."""

from ..core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
