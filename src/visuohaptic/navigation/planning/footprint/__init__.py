"""Drives of a robot with a polygonal footprint: paths over places and headings, checked by swept outlines."""

from ....core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
