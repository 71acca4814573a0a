"""Sensors as a program runs them: a frame in, a reading out, written to a sink on its way."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
