"""Detection of transparent objects from missing and inconsistent depth (Alt 2016, Sec. 5.2)."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
