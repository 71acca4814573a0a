"""Flat panes of glass, which show at a shallow angle only."""

from ....core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
