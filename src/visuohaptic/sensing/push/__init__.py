"""Evaluation of one push: contact events, phases, static friction, contact primitives, haptic tag (Alt 2016, Sec. 4.1)."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
