"""From a costmap to a raw graph: thinning to a skeleton, its lines and junctions, pruning (Alt 2016, Sec. 4.2 d)."""

from ....core.front_door import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
