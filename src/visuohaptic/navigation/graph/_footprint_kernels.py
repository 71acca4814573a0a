"""Rasterises the footprint of an obstacle: every cell that its polygon touches."""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel

__all__ = ["footprint"]


@kernel(error_model="numpy", boundscheck=False)
def footprint(
    polygon: np.ndarray, first_row: int, last_row: int, first_column: int, last_column: int
) -> np.ndarray:
    """Which cells of a window a polygon touches.

    Parameters
    ----------
    polygon
        Corners (k, 2) [cells], x along columns, y along rows.
    first_row, last_row, first_column, last_column
        The window, both ends included.
    """
    found = np.zeros((last_row - first_row + 1, last_column - first_column + 1), np.bool_)
    corners = len(polygon)
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            inside = False
            x, y = column + 0.5, row + 0.5
            for k in range(corners):
                x0, y0 = polygon[k, 0], polygon[k, 1]
                x1, y1 = polygon[(k + 1) % corners, 0], polygon[(k + 1) % corners, 1]
                if (y0 > y) != (y1 > y) and x < (x1 - x0) * (y - y0) / (y1 - y0) + x0:
                    inside = not inside
                # Does the side cross the cell? Clip it to the square.
                low, high = 0.0, 1.0
                for axis in range(2):
                    a = x0 if axis == 0 else y0
                    extent = (x1 - x0) if axis == 0 else (y1 - y0)
                    edge = float(column) if axis == 0 else float(row)
                    if extent == 0.0:
                        if a <= edge or a >= edge + 1.0:
                            high = -1.0
                    else:
                        near, far = (edge - a) / extent, (edge + 1.0 - a) / extent
                        low = max(low, min(near, far))
                        high = min(high, max(near, far))
                if low < high:
                    inside = True
                    break
            found[row - first_row, column - first_column] = inside
    return found
