"""Foam under load, written apart from the sensor that reads it."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
