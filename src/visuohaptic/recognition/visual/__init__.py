"""What an object may be by sight: visual words, shape, and the prior that they give."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
