"""Everything that is a file or a wire format; nothing else parses."""

from ..core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
