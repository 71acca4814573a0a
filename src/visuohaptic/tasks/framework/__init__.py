"""Task state machines, their replayable traces, safety supervision, and conformance tests of robot drivers."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
