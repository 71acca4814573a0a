"""Simulated set-ups with the library's sensors, for examples, the demo and reproduced figures."""

from ..core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
