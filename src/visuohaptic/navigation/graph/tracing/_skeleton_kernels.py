"""Distance-ordered homotopic thinning that depends only on the distance.

Every reachable cell has a key: its distance, then its index; the keys define a total order. A cell is
deleted if it is simple (its deletion changes neither components nor holes) and not the end of a
line, among its neighbours with larger keys and the retained ones with smaller keys. This
recursion runs from small keys to large ones and has a unique solution, independent of the order of
evaluation.

Neighbours are numbered around the cell, from +column through +row: (0, 1), (1, 1), (1, 0), (1, -1),
(0, -1), (-1, -1), (-1, 0), (-1, 1); bit k of a mask is neighbour k.
"""

from __future__ import annotations

import numpy as np

from ....core.kernels import kernel
from ._path_kernels import longer

#: Bit of the marks: the cell is on the skeleton.
KEPT = np.uint8(1)
_QUEUED = np.uint8(2)

ROW_STEP = np.array([0, 1, 1, 1, 0, -1, -1, -1], np.int32)
COLUMN_STEP = np.array([1, 1, 0, -1, -1, -1, 0, 1], np.int32)


def _deletable() -> np.ndarray:
    """Whether a cell with these neighbours is simple and not an end (8-connected cells, 4-connected holes)."""
    table = np.zeros(256, np.uint8)
    for mask in range(256):
        empty = [not mask >> k & 1 for k in range(8)] * 2
        # Hilditch's crossing number for 8-connected cells.
        crossings = sum(1 for k in (0, 2, 4, 6) if empty[k] and not (empty[k + 1] and empty[k + 2]))
        table[mask] = crossings == 1 and bin(mask).count("1") > 1
    return table


def _adjacent() -> np.ndarray:
    """Neighbours to which a skeleton cell is linked, without loops that enclose no hole.

    A diagonal link is omitted where a common neighbour makes the link in two steps, and of
    the four links around a full 2 x 2 block the one along its lower row. Then cells minus links is
    the Euler number of the 8-connected set, whether it is thin or not.
    """
    table = np.zeros(256, np.uint8)
    for mask in range(256):
        has = [bool(mask >> k & 1) for k in range(8)] * 2
        links = 0
        for k in (2, 6):
            links |= has[k] << k
        for k in (1, 3, 5, 7):
            links |= (has[k] and not has[k - 1] and not has[k + 1]) << k
        links |= has[0] and not (has[1] and has[2])
        links |= (has[4] and not (has[2] and has[3])) << 4
        table[mask] = links
    return table


_DELETABLE = _deletable()
#: Mask of neighbours on the skeleton -> mask of those that are linked.
ADJACENT = _adjacent()


@kernel(error_model="numpy")
def survey(distance: np.ndarray, step: np.ndarray, mark: np.ndarray) -> None:
    """Mark the cells that remain if all neighbours with smaller keys are deleted.

    ``distance`` (rows, columns) float32, ``step`` uint16 (0 = not reachable), ``mark`` uint8, filled.

    Parameters
    ----------
    distance
        Clearance of each cell, (rows, columns) float32.
    step
        Cost of a step, (rows, columns) uint16; 0 = not reachable.
    mark
        Marks, (rows, columns) uint8.
    """
    rows, columns = distance.shape
    masks = np.zeros(columns, np.uint8)
    one = np.uint8(1)
    for row in range(rows):
        inner = 0 < row < rows - 1
        for column in range(0, columns, max(columns - 1, 1) if inner else 1):
            masks[column] = _higher(distance, row, column)
        if inner:
            below, here, above = distance[row - 1], distance[row], distance[row + 1]
            for column in range(1, columns - 1):
                d = here[column]
                bits = np.uint8(here[column + 1] >= d) * one
                bits |= np.uint8(above[column + 1] >= d) << np.uint8(1)
                bits |= np.uint8(above[column] >= d) << np.uint8(2)
                bits |= np.uint8(above[column - 1] >= d) << np.uint8(3)
                bits |= np.uint8(here[column - 1] > d) << np.uint8(4)
                bits |= np.uint8(below[column - 1] > d) << np.uint8(5)
                bits |= np.uint8(below[column] > d) << np.uint8(6)
                bits |= np.uint8(below[column + 1] > d) << np.uint8(7)
                masks[column] = bits
        for column in range(columns):
            mark[row, column] = step[row, column] != 0 and _DELETABLE[masks[column]] == 0


@kernel(error_model="numpy")
def _higher(distance: np.ndarray, row: int, column: int) -> int:
    """Mask of the neighbours with larger keys; they are reachable if the cell is."""
    rows, columns = distance.shape
    d = distance[row, column]
    mask = 0
    for k in range(8):
        r, c = row + ROW_STEP[k], column + COLUMN_STEP[k]
        if 0 <= r < rows and 0 <= c < columns:
            other = distance[r, c]
            if other > d or (other == d and k < 4):
                mask |= 1 << k
    return mask


@kernel(error_model="numpy")
def refine(distance: np.ndarray, step: np.ndarray, mark: np.ndarray, kept: np.ndarray) -> None:
    """Evaluate the recursion after :func:`survey`, from the cells with a larger key than a remaining neighbour.

    Parameters
    ----------
    distance, step, mark
        See :func:`survey`.
    kept
        Remaining cells (flat), in any order.
    """
    rows, columns = distance.shape
    stack = np.empty(max(1024, 8 * len(kept)), np.int32)
    # In reverse order, so that the first cell is on top.
    count, remaining = 0, len(kept)
    while remaining + count > 0:
        if remaining > 0:
            remaining -= 1
            cell = kept[remaining]
            row, column = cell // columns, cell % columns
            higher = _higher(distance, row, column)
        else:
            count -= 1
            cell = np.int64(stack[count])
            row, column = cell // columns, cell % columns
            old = mark[row, column] & KEPT
            new = np.uint8(0)
            higher = 0
            if step[row, column] != 0:
                higher = _higher(distance, row, column)
                mask = higher
                for k in range(8):
                    r, c = row + ROW_STEP[k], column + COLUMN_STEP[k]
                    if 0 <= r < rows and 0 <= c < columns and mark[r, c] & KEPT:
                        mask |= 1 << k
                new = np.uint8(1) - _DELETABLE[mask]
            mark[row, column] = new
            if new == old:
                continue
        for k in range(7, -1, -1):
            if higher >> k & 1:
                r, c = row + ROW_STEP[k], column + COLUMN_STEP[k]
                if not mark[r, c] & _QUEUED:  # a higher neighbour is on the map
                    mark[r, c] |= _QUEUED
                    if count == len(stack):
                        stack = longer(stack)
                    stack[count] = r * columns + c
                    count += 1
