"""From a costmap to a raw graph: thinning to a skeleton, its lines and junctions, pruning (Alt 2016, Sec. 4.2 d)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
