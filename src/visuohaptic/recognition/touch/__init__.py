"""Bayesian recognition by touch: posterior over classes, unknown class, state and refinement."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
