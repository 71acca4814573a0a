"""Adapters of commercial robots to the protocols of the tasks."""

from ...core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
