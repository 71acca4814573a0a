"""Image tracking: contours along lines, templates and tags, point flow, homographies (Alt 2016, Sec. 2.3)."""

from ..core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
