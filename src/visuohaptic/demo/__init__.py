"""The end-to-end demo: a simulated robot looks, touches and remembers."""

from ..core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
