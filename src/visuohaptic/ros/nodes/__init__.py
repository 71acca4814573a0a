"""Nodes for a robot's launch file: parameters, lifecycle, diagnostics and services, on topics of any transport."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
