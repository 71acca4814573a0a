"""Ends of skeleton lines: cells where lines meet or end; see :mod:`._line_kernels` for the arrays."""

from __future__ import annotations

import numpy as np

from ....core.kernels import kernel
from ._path_kernels import longer, longer_rows
from ._skeleton_kernels import ADJACENT, COLUMN_STEP, ROW_STEP

__all__ = ["BITS", "find_ends", "forget_lines"]

_ADJACENT = ADJACENT
DEAD = np.int32(-2)
#: Number of set bits of a mask.
BITS = np.array([bin(mask).count("1") for mask in range(256)], np.uint8)


@kernel(error_model="numpy", boundscheck=False)
def linked(mark: np.ndarray, row: int, column: int) -> int:
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
            table[line, 0] = DEAD
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
        Cells (flat) that may have become ends or parts of lines, ascending.
    near
        Cells (flat) of ends whose links have to be updated, ascending.
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
            if BITS[linked(mark, row, here - row * columns)] != 2:
                if count == len(new):
                    new = longer(new)
                new[count] = here
                count += 1
                flat[here] = -1
    slots = np.empty(count, np.int32)
    slot = 0
    for k in range(count):
        while slot < len(cell) and cell[slot] >= 0:
            slot += 1
        if slot == len(cell):
            before = len(cell)
            cell, masks, keys, links = longer(cell), longer(masks), longer(keys), longer_rows(links)
            cell[before:] = -1
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
        masks[slot] = linked(mark, row, here - row * columns)
        keys[slot] = flat_distance[here]
        flat[here] = -1 - slot
    look = np.empty(count + len(near), np.int32)
    some, i, j = 0, 0, 0
    before = -1
    while i < count or j < len(near):
        if j == len(near) or (i < count and new[i] < near[j]):
            here = new[i]
            i += 1
        else:
            here = near[j]
            j += 1
        if here != before and flat[here] < 0:
            look[some] = -1 - flat[here]
            some += 1
            before = here
    return cell, masks, keys, links, out[:total].copy(), look[:some]
