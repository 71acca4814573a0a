"""State machines of a task, and the trace from which a run is replayed."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
