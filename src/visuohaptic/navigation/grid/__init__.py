"""Costmaps: clearance (distance transform), travel cost and reachability of each cell, and footprints of obstacles."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
