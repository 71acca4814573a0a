"""Houses with furniture and with objects in the way: the fixed office, and drawn ones."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
