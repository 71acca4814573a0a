"""Grasp planning on deformable containers: contact points and grip force of two fingers (Alt 2016, Sec. 6.2)."""

from ..core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
