"""From skeleton cells to lines between the cells where lines meet or end; lines that no edit has touched stay.

Cells where lines meet or end ("ends") live in slots that keep their numbers from edit to edit:
``cell`` (slots,) int32, -1 for a free slot; ``masks`` uint8, linked neighbours; ``keys`` float32, distance;
``links`` (slots, 8) int32, what a neighbour leads to: ``2 * line`` where a line begins there,
``2 * line + 1`` where it stops, ``-2 - slot`` for another end, -1 for nothing. With these at hand
the map, which is large and not in the cache, is not read for what no edit has touched.

``place`` (rows, columns) int32 tells of every cell: 0, the number of its line + 1, or -1 - slot.
``table`` (lines, 5): first and last cell, where in ``path`` a line begins and stops, slot of the last
cell; the first is -1 for a ring, -2 for a line that is gone. ``measured`` (lines, 3): length [m], cost [s], clearance [m].
"""

from __future__ import annotations

import numpy as np

from ....core.kernels import kernel
from ._line_end_kernels import DEAD, linked
from ._path_kernels import longer, longer_rows, measure
from ._skeleton_kernels import COLUMN_STEP, ROW_STEP

__all__ = ["find_lines", "gather_paths"]


@kernel(error_model="numpy", boundscheck=False)
def _walk(
    mark: np.ndarray, place: np.ndarray, before: int, here: int, line: int, path: np.ndarray, size: int
) -> tuple[np.ndarray, int]:
    """Cells of a line from ``before``, where lines meet, through ``here`` to where they meet again."""
    columns = mark.shape[1]
    flat = place.ravel()
    path[size] = before
    size += 1
    while flat[here] >= 0:
        if size + 2 >= len(path):
            path = longer(path)
        path[size] = here
        size += 1
        flat[here] = line + 1
        row = here // columns
        mask = linked(mark, row, here - row * columns)
        following = -1
        for j in range(8):
            if mask >> j & 1:
                other = here + ROW_STEP[j] * columns + COLUMN_STEP[j]
                if other != before:
                    following = other
        before = here
        here = following
    path[size] = here
    return path, size + 1


@kernel(error_model="numpy", boundscheck=False)
def _walk_ring(
    mark: np.ndarray,
    place: np.ndarray,
    distance: np.ndarray,
    here: int,
    line: int,
    path: np.ndarray,
    size: int,
) -> tuple[np.ndarray, int]:
    """Cells of a ring, from the widest round to it again."""
    columns = mark.shape[1]
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
            row = here // columns
            mask = linked(mark, row, here - row * columns)
            following = -1
            for j in range(8):
                if mask >> j & 1:
                    other = here + ROW_STEP[j] * columns + COLUMN_STEP[j]
                    if other != before and (before != -1 or following == -1):
                        following = other
            before = here
            here = following
            if here == start:
                break
        if turn == 1:
            path[size] = start
            size += 1
    return path, size


@kernel(error_model="numpy", boundscheck=False)
def find_lines(
    distance: np.ndarray,
    mark: np.ndarray,
    place: np.ndarray,
    cell: np.ndarray,
    masks: np.ndarray,
    links: np.ndarray,
    look: np.ndarray,
    maybe: np.ndarray,
    table: np.ndarray,
    measured: np.ndarray,
    path: np.ndarray,
    used: int,
    size: int,
    resolution_m: float,
    speeds: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int, int]:
    """Walk the lines that are not known and link the ends ``look`` (slots by ascending cell).

    ``maybe`` (flat) are cells that may be on a new ring. Returns ``table``, ``measured``, ``path``, how
    many lines and how many path cells are used. Lines that are gone leave their number to new ones.

    Parameters
    ----------
    distance
        Clearance of each cell [m], (rows, columns) float32.
    mark
        Marks of the skeleton, (rows, columns) uint8; bit 0 is set on it.
    place
        Line or slot of each cell, (rows, columns) int32.
    cell, masks, links
        The slots, see the module.
    look
        Slots whose links have to be updated, by ascending cell.
    maybe
        Cells (flat) that may have become ends or parts of lines.
    table
        The lines, see the module.
    table, measured
        The lines: first and last cell and place in ``path``; length, cost and clearance.
    path
        Cells (flat) of all lines, one after the other.
    used
        Number of lines in ``table``.
    size
        Number of cells in ``path`` that are used.
    resolution_m
        Edge length of a cell [m].
    speeds
        Radius [m], 1 / v_min and 1 / v_max [s/m], as in Eq. (4.1).
    """
    columns = mark.shape[1]
    flat = place.ravel()
    flat_mark = mark.ravel()
    line = 0
    for k in range(len(look) + len(maybe)):
        for j in range(8 if k < len(look) else 1):
            if k < len(look):
                if not masks[look[k]] >> j & 1:
                    continue
                here = cell[look[k]] + ROW_STEP[j] * columns + COLUMN_STEP[j]
            else:
                here = maybe[k - len(look)]
            if flat[here] != 0 or not flat_mark[here] & 1:
                continue
            while line < used and table[line, 0] != DEAD:
                line += 1
            if line == used:
                if used == len(table):
                    table, measured = longer_rows(table), longer_rows(measured)
                used += 1
            if size + 4 >= len(path):
                path = longer(path)
            table[line, 2] = size
            if k < len(look):
                path, size = _walk(mark, place, cell[look[k]], here, line, path, size)
                table[line, 0], table[line, 1] = cell[look[k]], path[size - 1]
                table[line, 4] = -1 - flat[path[size - 1]]
            else:
                path, size = _walk_ring(mark, place, distance, here, line, path, size)
                table[line, 0], table[line, 1] = -1, path[size - 1]
            table[line, 3] = size
            length, seconds, clearance = measure(path, table[line, 2], size, distance, resolution_m, speeds)
            measured[line, 0], measured[line, 1], measured[line, 2] = length, seconds, clearance
    for slot in look:
        for j in range(8):
            if not masks[slot] >> j & 1:
                links[slot, j] = -1
                continue
            here = cell[slot] + ROW_STEP[j] * columns + COLUMN_STEP[j]
            value = flat[here]
            if value < 0:
                links[slot, j] = -2 - (-1 - value)
            else:
                begins = table[value - 1, 0] == cell[slot] and path[table[value - 1, 2] + 1] == here
                links[slot, j] = 2 * (value - 1) + (0 if begins else 1)
    return table, measured, path, used, size


@kernel(error_model="numpy", boundscheck=False)
def gather_paths(table: np.ndarray, path: np.ndarray, used: int, size: int) -> tuple[np.ndarray, int]:
    """A new array with the paths of the lines that are left; graphs of before keep the old one.

    Parameters
    ----------
    table
        The lines, see the module.
    path
        Cells (flat) of all lines, one after the other.
    used
        Number of lines in ``table``.
    size
        Number of cells of the lines that are left.
    """
    out = np.empty(2 * size + 4096, np.int32)
    total = 0
    for line in range(used):
        if table[line, 0] == DEAD:
            continue
        begin, stop = table[line, 2], table[line, 3]
        table[line, 2] = total
        for position in range(begin, stop):
            out[total] = path[position]
            total += 1
        table[line, 3] = total
    return out, total
