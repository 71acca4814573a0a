"""The end-to-end demo: a simulated robot observes, touches and stores objects."""

from ..core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
