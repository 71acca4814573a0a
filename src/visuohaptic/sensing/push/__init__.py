"""One push: contact events, phases, breakaway, contact primitives and the haptic tag (Alt 2016, Sec. 4.1)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
