"""Which points of a contour are foam, and which readings can be trusted."""

from ....core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
