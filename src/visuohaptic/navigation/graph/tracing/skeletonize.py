"""The skeleton: one path through the middle of every passage (Alt 2016, Sec. 4.2 d)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from ...grid.cost_grid import GridLayers
from ._skeleton_kernels import refine, survey


def skeleton(layers: GridLayers) -> Bool[np.ndarray, "rows columns"]:
    """Thin the reachable cells, those near to obstacles first (Alt 2016, Sec. 4.2 d).

    Cells are deleted in the order of their distance, equal ones in that of their index, if that
    changes neither the components (8-connected) nor the holes (4-connected) and they are not
    the end of a line. The result has exactly the components and loops of the reachable cells.

    Parameters
    ----------
    layers
        Costmap: clearance and cost of each cell.
    """
    mark = np.zeros(layers.shape, np.uint8)
    survey(layers.distance_m, layers.step, mark)
    refine(layers.distance_m, layers.step, mark, np.flatnonzero(mark.view(np.bool_)))
    return mark.view(np.bool_)
