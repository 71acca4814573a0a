"""Worlds, robots and cameras that make the truth of tests and demo; never what is tested."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
