"""Force, pressure and shape from camera images of a foam strip (Alt 2016, Sec. 3.2 and 3.3)."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
