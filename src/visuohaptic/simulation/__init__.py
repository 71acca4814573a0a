"""Simulated worlds, robots and cameras: ground truth for tests and demo, independent of the code under test."""

from ..core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
