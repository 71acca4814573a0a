"""Alignment of a template with an image: second-order minimisation, blur estimation, and block-wise fit."""

from ....core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
