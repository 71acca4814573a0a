"""Simulated set-ups wired to the library's sensors, for examples, demo and reproduced figures."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
