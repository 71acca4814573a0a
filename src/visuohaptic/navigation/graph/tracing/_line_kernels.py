"""From skeleton cells to lines between junctions and end points.

Junction and end cells ("ends") are slots by ascending cell: ``cell`` (slots,) int32; ``masks`` uint8, linked
neighbours; ``keys`` float32, distance; ``links`` (slots, 8) int32, what a neighbour leads to: ``2 * line`` where a
line starts there, ``2 * line + 1`` where it stops, ``-2 - slot`` for another end, -1 for nothing.

``place`` (rows, columns) int32 contains for every cell: 0, the number of its line + 1, or -1 - slot.
``table`` (lines, 5): first and last cell, start and stop index of the line in ``path``, slot of the last
cell; the first is -1 for a ring. ``measured`` (lines, 3): length [m], cost [s], clearance [m].
"""

from __future__ import annotations

import numpy as np

from ....core.kernels import kernel
from ._path_kernels import longer, longer_rows, measure
from ._skeleton_kernels import ADJACENT, COLUMN_STEP, ROW_STEP

_ADJACENT = ADJACENT
#: Number of set bits of a mask.
BITS = np.array([bin(mask).count("1") for mask in range(256)], np.uint8)


@kernel(error_model="numpy")
def linked(mark: np.ndarray, row: int, column: int) -> int:
    """Mask of the neighbours to which a skeleton cell is linked."""
    rows, columns = mark.shape
    mask = 0
    for k in range(8):
        r, c = row + ROW_STEP[k], column + COLUMN_STEP[k]
        if 0 <= r < rows and 0 <= c < columns and mark[r, c] & 1:
            mask |= 1 << k
    return _ADJACENT[mask]


@kernel(error_model="numpy")
def find_ends(mark: np.ndarray, cells: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Junction and end cells (flat), their linked neighbours, and their number; writes their slots to ``place``.

    Parameters
    ----------
    mark
        Marks of the skeleton, (rows, columns) uint8; bit 0 is set on it.
    cells
        All cells of the skeleton (flat), ascending.
    place
        Line or slot of each cell, (rows, columns) int32, all 0.
    """
    columns = place.shape[1]
    flat = place.ravel()
    cell = np.empty(len(cells), np.int32)
    masks = np.empty(len(cells), np.uint8)
    count = 0
    for here in cells:
        row = here // columns
        mask = linked(mark, row, here - row * columns)
        if BITS[mask] != 2:
            cell[count], masks[count] = here, mask
            count += 1
            flat[here] = -count
    return cell, masks, count


@kernel(error_model="numpy")
def _following(mark: np.ndarray, here: int, before: int) -> int:
    """The last neighbour of a cell of a line that is not the cell before it; the first one if that is -1."""
    columns = mark.shape[1]
    row = here // columns
    mask = linked(mark, row, here - row * columns)
    following = -1
    for j in range(8):
        if mask >> j & 1:
            other = here + ROW_STEP[j] * columns + COLUMN_STEP[j]
            if other != before and (before != -1 or following == -1):
                following = other
    return following


@kernel(error_model="numpy")
def _walk(
    mark: np.ndarray, place: np.ndarray, before: int, here: int, line: int, path: np.ndarray, size: int
) -> tuple[np.ndarray, int]:
    """Cells of a line from the end ``before`` through ``here`` to the next end."""
    flat = place.ravel()
    path[size] = before
    size += 1
    while flat[here] >= 0:
        if size + 2 >= len(path):
            path = longer(path)
        path[size] = here
        size += 1
        flat[here] = line + 1
        before, here = here, _following(mark, here, before)
    path[size] = here
    return path, size + 1


@kernel(error_model="numpy")
def _walk_ring(
    mark: np.ndarray,
    place: np.ndarray,
    distance: np.ndarray,
    here: int,
    line: int,
    path: np.ndarray,
    size: int,
) -> tuple[np.ndarray, int]:
    """Cells of a ring, starting and ending at its widest cell."""
    flat = place.ravel()
    flat_distance = distance.ravel()
    widest = here
    begin = size
    for turn in range(2):
        start = widest
        before, here = -1, start
        size = begin
        while True:
            if size + 2 >= len(path):
                path = longer(path)
            path[size] = here
            size += 1
            flat[here] = line + 1
            if flat_distance[here] > flat_distance[widest] or (
                flat_distance[here] == flat_distance[widest] and here < widest
            ):
                widest = here
            before, here = here, _following(mark, here, before)
            if here == start:
                break
        if turn == 1:
            path[size] = start
            size += 1
    return path, size


@kernel(error_model="numpy")
def find_lines(
    distance: np.ndarray,
    mark: np.ndarray,
    place: np.ndarray,
    cell: np.ndarray,
    masks: np.ndarray,
    cells: np.ndarray,
    resolution_m: float,
    speeds: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, int, int]:
    """Trace all lines and link the ends: ``table``, ``measured``, ``path`` and ``links``, see the module.

    Last are the numbers of lines and of cells in ``path``: the arrays are longer.

    Parameters
    ----------
    distance
        Clearance of each cell [m], (rows, columns) float32.
    mark
        Marks of the skeleton, (rows, columns) uint8; bit 0 is set on it.
    place
        Line or slot of each cell, (rows, columns) int32.
    cell, masks
        The slots, see the module.
    cells
        All cells of the skeleton (flat), ascending.
    resolution_m
        Edge length of a cell [m].
    speeds
        Radius [m], 1 / v_min and 1 / v_max [s/m], as in Eq. (4.1).
    """
    columns = mark.shape[1]
    flat = place.ravel()
    table = np.empty((1024, 5), np.int32)
    measured = np.empty((1024, 3))
    path = np.empty(4096, np.int32)
    line, size = 0, 0
    # From all ends, then from cells that no line has reached: rings.
    for k in range(len(cell) + len(cells)):
        for j in range(8 if k < len(cell) else 1):
            if k < len(cell):
                if not masks[k] >> j & 1:
                    continue
                here = cell[k] + ROW_STEP[j] * columns + COLUMN_STEP[j]
            else:
                here = cells[k - len(cell)]
            if flat[here] != 0:
                continue
            if line == len(table):
                table, measured = longer_rows(table), longer_rows(measured)
            if size + 4 >= len(path):
                path = longer(path)
            table[line, 2] = size
            if k < len(cell):
                path, size = _walk(mark, place, cell[k], here, line, path, size)
                table[line, 0], table[line, 1] = cell[k], path[size - 1]
                table[line, 4] = -1 - flat[path[size - 1]]
            else:
                path, size = _walk_ring(mark, place, distance, here, line, path, size)
                table[line, 0], table[line, 1] = -1, path[size - 1]
            table[line, 3] = size
            length, seconds, clearance = measure(path, table[line, 2], size, distance, resolution_m, speeds)
            measured[line, 0], measured[line, 1], measured[line, 2] = length, seconds, clearance
            line += 1
    links = np.empty((len(cell), 8), np.int32)
    for slot in range(len(cell)):
        for j in range(8):
            links[slot, j] = -1
            if not masks[slot] >> j & 1:
                continue
            here = cell[slot] + ROW_STEP[j] * columns + COLUMN_STEP[j]
            value = flat[here]
            if value < 0:
                links[slot, j] = -2 - (-1 - value)
            else:
                begins = table[value - 1, 0] == cell[slot] and path[table[value - 1, 2] + 1] == here
                links[slot, j] = 2 * (value - 1) + (0 if begins else 1)
    return table, measured, path, links, line, size
