"""Point flow and homographies (Alt 2016, Sec. 2.3.2)."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
