"""Haptic recognition: classification trees, a Bayesian planner of touches, contents, refinement (Alt 2016, Sec. 6.3)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
