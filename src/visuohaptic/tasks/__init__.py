"""Robot tasks as state machines with safety supervision, based on the interfaces of :mod:`visuohaptic.core.robots` only."""

from ..core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
