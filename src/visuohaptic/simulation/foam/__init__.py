"""Simulation of foam under load, independent of the sensor's model."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
