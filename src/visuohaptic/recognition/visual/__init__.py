"""Visual prior of an object's class from visual words and shape."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
