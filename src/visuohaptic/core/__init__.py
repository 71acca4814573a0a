"""The language of the house: measurements, objects, errors, files, geometry and what a robot must offer."""

from .front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
