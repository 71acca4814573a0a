"""Object memory of robots: local and shared databases, search, merging and synchronisation (Alt 2016, Sec. 6.3.3)."""

from ..core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
