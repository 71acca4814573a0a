"""Camera poses of a depth sequence from its images alone."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
