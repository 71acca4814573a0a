"""Kernels of objects on a grid: cells covered by an outline, and clearing of these cells in a window."""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel
from ..pushing._outline_kernels import extent, inside_polygon, polygon_distance, segment_distance, square_gap

#: Distance from an object's outline within which spurious components are searched [cells].
SPURIOUS_REACH_CELLS = 1.25


@kernel
def cell_meets_polygon(row: int, column: int, polygon: np.ndarray) -> bool:
    """Whether a cell's square overlaps the interior of a polygon."""
    x, y = column + 0.5, row + 0.5
    if inside_polygon(x, y, polygon):
        return True
    n, square = len(polygon), np.zeros((4, 2))
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        ax, ay, bx, by = polygon[i, 0], polygon[i, 1], polygon[j, 0], polygon[j, 1]
        if segment_distance(x, y, ax, ay, bx, by) >= 0.7072:
            continue
        # A slightly smaller square: contact alone does not count.
        if square_gap(ax, ay, bx, by, column, row, 1e-6, square) <= 0.0:
            return True
    return False


@kernel
def free_object(occupied: np.ndarray, polygon: np.ndarray, row0: int, column0: int) -> None:
    """Free an object's cells in a window that starts at (row0, column0).

    These are the cells covered by its outline, and adjacent spurious components: connected components that
    lie completely within ``SPURIOUS_REACH_CELLS`` and are not part of a wall.
    """
    rows, columns = occupied.shape
    near = np.zeros((rows, columns), np.bool_)
    # Cells whose centre is farther than this from the outline's bounding box are neither covered nor near.
    reach = SPURIOUS_REACH_CELLS + 1.0
    x_min, x_max, y_min, y_max = extent(polygon)
    top = max(0, int(y_min - reach) - row0)
    bottom = min(rows, int(y_max + reach) + 1 - row0)
    left = max(0, int(x_min - reach) - column0)
    right = min(columns, int(x_max + reach) + 1 - column0)
    for r in range(top, bottom):
        for c in range(left, right):
            if not occupied[r, c]:
                continue
            if cell_meets_polygon(r + row0, c + column0, polygon):
                occupied[r, c] = False
            else:
                near[r, c] = (
                    polygon_distance(c + column0 + 0.5, r + row0 + 0.5, polygon) <= SPURIOUS_REACH_CELLS
                )
    seen = np.zeros((rows, columns), np.bool_)
    stack = np.empty((rows * columns, 2), np.int32)
    for r in range(top, bottom):
        for c in range(left, right):
            if not near[r, c] or seen[r, c]:
                continue
            used, first = 1, 0
            stack[0, 0], stack[0, 1] = r, c
            seen[r, c] = True
            spurious_component = True
            while first < used:
                ur, uc = stack[first, 0], stack[first, 1]
                first += 1
                if ur == 0 or uc == 0 or ur == rows - 1 or uc == columns - 1:
                    spurious_component = False
                for vr in range(max(ur - 1, 0), min(ur + 2, rows)):
                    for vc in range(max(uc - 1, 0), min(uc + 2, columns)):
                        if occupied[vr, vc] and not near[vr, vc]:
                            spurious_component = False
                        elif occupied[vr, vc] and not seen[vr, vc]:
                            seen[vr, vc] = True
                            stack[used, 0], stack[used, 1] = vr, vc
                            used += 1
            if spurious_component:
                for i in range(used):
                    occupied[stack[i, 0], stack[i, 1]] = False
