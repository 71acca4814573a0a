"""Six axes of force and moment from templates on a bending rod (Alt 2016, Sec. 3.2 and 3.4)."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
