"""Simulated trials of the reproduced figures: bottles to complete, tables with glass, containers with another element."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
