"""Shared foundation: measurements, objects, errors, files, geometry and the protocols of robots."""

from .front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
