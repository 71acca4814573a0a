"""Walls of an occupancy map as a small number of rectangles, for physics engines with boxes."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from ...io.maps.occupancy_map import OccupancyMap


def wall_boxes(map: OccupancyMap, *, depth_cells: int = 2) -> Float[np.ndarray, "n 4"]:
    """Occupied cells that can be touched, merged.

    Parameters
    ----------
    map
        Cells of 50 and more are walls.
    depth_cells
        Cells farther than this from every other cell are omitted: they cannot be reached.

    Returns
    -------
    (x0, y0, x1, y1) [m] in the frame of the grid: from the outer corner of cell
    (0, 0), along its rows and columns; transform by ``map.origin``.
    """
    from scipy.ndimage import binary_dilation

    wall = map.cells >= 50
    near = binary_dilation(~wall, iterations=depth_cells)
    return merged_rectangles(wall & near) * map.resolution_m


def merged_rectangles(cells: Bool[np.ndarray, "rows columns"]) -> Float[np.ndarray, "n 4"]:
    """Rectangles (x0, y0, x1, y1) [cells] that cover the true cells once each.

    Runs along the rows, joined with the run above where both have the same ends.

    Parameters
    ----------
    cells
        Mask (rows, columns) of the cells to cover.
    """
    padded = np.pad(cells, ((0, 0), (1, 1))).astype(np.int8)
    change = np.diff(padded, axis=1)
    found: list[tuple[int, int, int, int]] = []
    open_: dict[tuple[int, int], int] = {}
    for row in range(cells.shape[0] + 1):
        runs: set[tuple[int, int]] = set()
        if row < cells.shape[0]:
            begins, ends = np.flatnonzero(change[row] == 1), np.flatnonzero(change[row] == -1)
            runs = set(zip(begins.tolist(), ends.tolist(), strict=True))
        for run in [run for run in open_ if run not in runs]:
            found.append((run[0], open_.pop(run), run[1], row))
        for run in runs:
            open_.setdefault(run, row)
    return np.array(sorted(found), dtype=np.float64).reshape(-1, 4)
