"""Sensors as a program runs them: a frame in, a reading out, written to a sink on its way."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
