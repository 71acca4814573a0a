"""The foam strip in the image: geometry, optics, zero reference and its configuration file."""

from ....core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
