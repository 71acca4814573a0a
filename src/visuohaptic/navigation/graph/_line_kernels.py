"""From skeleton cells to lines between the cells where lines meet or end; lines that no edit has touched stay.

Cells where lines meet or end ("ends") live in slots that keep their numbers from edit to edit:
``cell`` (slots,) int32, -1 for a free slot; ``masks`` uint8, linked neighbours; ``keys`` float32, distance;
``links`` (slots, 8) int32, what a neighbour leads to: ``2 * line`` where a line begins there,
``2 * line + 1`` where it stops, ``-2 - slot`` for another end, -1 for nothing. With these at hand
nobody has to ask the map, which is large and far away, about what no edit has touched.

``place`` (rows, columns) int32 tells of every cell: 0, the number of its line + 1, or -1 - slot.
``table`` (lines, 5): first and last cell, where in ``path`` a line begins and stops, slot of the last
cell; the first is -1 for a ring, -2 for a line that is gone. ``measured`` (lines, 3): length [m], cost [s], clearance [m].
"""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel
from ._path_kernels import longer, measure
from ._skeleton_kernels import ADJACENT, COLUMN_STEP, ROW_STEP

__all__ = ["BITS", "find_ends", "find_lines", "forget_lines", "gather_paths"]

_ADJACENT = ADJACENT
_DEAD = np.int32(-2)
#: Number of set bits of a mask.
BITS = np.array([bin(mask).count("1") for mask in range(256)], np.uint8)


@kernel(error_model="numpy", boundscheck=False)
def _linked(mark: np.ndarray, row: int, column: int) -> int:
    """Mask of the neighbours that a skeleton cell is linked to."""
    rows, columns = mark.shape
    mask = 0
    for k in range(8):
        r, c = row + ROW_STEP[k], column + COLUMN_STEP[k]
        if 0 <= r < rows and 0 <= c < columns and mark[r, c] & 1:
            mask |= 1 << k
    return _ADJACENT[mask]


@kernel(error_model="numpy", boundscheck=False)
def forget_lines(
    mark: np.ndarray,
    place: np.ndarray,
    cell: np.ndarray,
    table: np.ndarray,
    path: np.ndarray,
    touched: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, int]:
    """Forget ends that are touched, and lines that touched cells (flat) are on or at the end of.

    Returns cells that may be on new lines, cells of ends whose links have to be looked at (both some
    twice), and how many path cells the lines had that are gone.

    Parameters
    ----------
    mark
        Marks of the skeleton, (rows, columns) uint8; bit 0 is set on it.
    place
        Line or slot of each cell, (rows, columns) int32.
    cell
        Flat cell of each slot.
    table
        The lines, see the module.
    path
        Cells (flat) of all lines, one after the other.
    touched
        Cells (flat) that an edit has touched.
    """
    rows, columns = place.shape
    flat = place.ravel()
    flat_mark = mark.ravel()
    found = np.empty(len(touched) + 1024, np.int32)
    near = np.empty(1024, np.int32)
    count, beside, lost = 0, 0, 0
    for here in touched:
        if count == len(found):
            found = longer(found)
        if flat_mark[here] & 1:
            found[count] = here
            count += 1
        value = flat[here]
        if value == 0:
            continue
        row = here // columns
        column = here - row * columns
        # A cell where lines meet is part of all of them.
        for k in range(9):
            other = here
            if k < 8:
                if value > 0:
                    continue
                r, c = row + ROW_STEP[k], column + COLUMN_STEP[k]
                if r < 0 or r >= rows or c < 0 or c >= columns:
                    continue
                other = r * columns + c
            if beside + 3 > len(near):
                near = longer(near)
            line = flat[other] - 1
            if line < 0:
                if line < -1:
                    near[beside] = other
                    beside += 1
                continue
            for position in range(table[line, 2], table[line, 3]):
                part = path[position]
                if flat[part] == line + 1:
                    flat[part] = 0
                    if count == len(found):
                        found = longer(found)
                    found[count] = part
                    count += 1
            if table[line, 0] >= 0:
                near[beside] = table[line, 0]
                near[beside + 1] = table[line, 1]
                beside += 2
            lost += table[line, 3] - table[line, 2]
            table[line, 0] = _DEAD
        if value < 0:
            cell[-1 - value] = -1
            flat[here] = 0
    return found[:count], near[:beside], lost


@kernel(error_model="numpy", boundscheck=False)
def find_ends(
    distance: np.ndarray,
    mark: np.ndarray,
    place: np.ndarray,
    cell: np.ndarray,
    masks: np.ndarray,
    keys: np.ndarray,
    links: np.ndarray,
    order: np.ndarray,
    maybe: np.ndarray,
    near: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Cells of ``maybe`` where lines meet or end get a slot.

    ``order`` are the slots in use by ascending cell. Returns the slots' four arrays (longer, where there
    was no room), the new ``order``, and the slots whose links have to be looked at, by ascending cell.

    Parameters
    ----------
    distance
        Clearance of each cell [m], (rows, columns) float32.
    mark
        Marks of the skeleton, (rows, columns) uint8; bit 0 is set on it.
    place
        Line or slot of each cell, (rows, columns) int32.
    cell, masks, keys, links
        The slots: flat cell, linked neighbours, clearance and links; see the module.
    order
        Slots in use by ascending cell.
    maybe
        Cells (flat) that may have become ends or parts of lines.
    near
        Cells (flat) of ends whose links have to be updated.
    """
    columns = place.shape[1]
    flat = place.ravel()
    flat_mark = mark.ravel()
    flat_distance = distance.ravel()
    new = np.empty(1024, np.int32)
    count = 0
    for here in maybe:
        if flat_mark[here] & 1 and flat[here] == 0:
            row = here // columns
            if BITS[_linked(mark, row, here - row * columns)] != 2:
                if count == len(new):
                    new = longer(new)
                new[count] = here
                count += 1
                flat[here] = -1
    new = np.sort(new[:count])
    slots = np.empty(count, np.int32)
    slot = 0
    for k in range(count):
        while slot < len(cell) and cell[slot] >= 0:
            slot += 1
        if slot == len(cell):
            before = len(cell)
            cell, masks, keys = longer(cell), longer(masks), longer(keys)
            cell[before:] = -1
            larger = np.empty((len(cell), 8), np.int32)
            larger[:before] = links
            links = larger
        slots[k] = slot
        slot += 1
    # Slots that were given up are in the order still: out with them before they are used again.
    out = np.empty(len(order) + count, np.int32)
    total, j = 0, 0
    for i in range(len(order) + 1):
        here = -1
        if i < len(order):
            here = cell[order[i]]
            if here < 0:
                continue
        while j < count and (here < 0 or new[j] < here):
            out[total] = slots[j]
            total += 1
            j += 1
        if here >= 0:
            out[total] = order[i]
            total += 1
    for k in range(count):
        here, slot = new[k], slots[k]
        row = here // columns
        cell[slot] = here
        masks[slot] = _linked(mark, row, here - row * columns)
        keys[slot] = flat_distance[here]
        flat[here] = -1 - slot
    cells = np.empty(count + len(near), np.int32)
    cells[:count] = new
    some = count
    for here in near:
        if flat[here] < 0:
            cells[some] = here
            some += 1
    cells = np.sort(cells[:some])
    look = np.empty(some, np.int32)
    some = 0
    for k in range(len(cells)):
        if k == 0 or cells[k] != cells[k - 1]:
            look[some] = -1 - flat[cells[k]]
            some += 1
    return cell, masks, keys, links, out[:total].copy(), look[:some]


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
        mask = _linked(mark, row, here - row * columns)
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
            mask = _linked(mark, row, here - row * columns)
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
            while line < used and table[line, 0] != _DEAD:
                line += 1
            if line == used:
                if used == len(table):
                    larger_table = np.empty((2 * used, 5), np.int32)
                    larger_table[:used] = table
                    table = larger_table
                    larger_measured = np.empty((2 * used, 3))
                    larger_measured[:used] = measured
                    measured = larger_measured
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
        if table[line, 0] == _DEAD:
            continue
        begin, stop = table[line, 2], table[line, 3]
        table[line, 2] = total
        for position in range(begin, stop):
            out[total] = path[position]
            total += 1
        table[line, 3] = total
    return out, total
