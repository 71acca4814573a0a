"""Simulated set-ups wired to the library's sensors, for examples, demo and reproduced figures."""

from ..core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
