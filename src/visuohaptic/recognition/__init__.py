"""Haptic recognition: classification trees, a Bayesian planner of touches, contents, refinement (Alt 2016, Sec. 6.3)."""

from ..core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
