"""Feature sets, readings and their noise, and the protocol of a touch."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
