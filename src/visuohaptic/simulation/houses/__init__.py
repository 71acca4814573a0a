"""Houses with furniture and obstacles: a fixed office, and randomly generated ones."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
