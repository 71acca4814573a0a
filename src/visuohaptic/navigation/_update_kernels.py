"""Where an edit of the map is felt: the window of distances, the cells to thin again, the potentials that fall."""

from __future__ import annotations

import numpy as np
from numba import njit

from ._region_kernels import UNREACHED, diagonal
from ._skeleton_kernels import COLUMN_STEP, ROW_STEP

__all__ = ["cells_near_changes", "distance_window", "footprint", "forget"]

_QUEUED = np.uint8(2)
_FORGOTTEN = np.uint8(8)


@njit(cache=True, error_model="numpy", boundscheck=False)
def footprint(
    polygon: np.ndarray, first_row: int, last_row: int, first_column: int, last_column: int
) -> np.ndarray:
    """Which cells of a window a polygon touches; ``polygon`` (k, 2) in cells (x along columns, y along rows)."""
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
                    way = (x1 - x0) if axis == 0 else (y1 - y0)
                    edge = float(column) if axis == 0 else float(row)
                    if way == 0.0:
                        if a <= edge or a >= edge + 1.0:
                            high = -1.0
                    else:
                        near, far = (edge - a) / way, (edge + 1.0 - a) / way
                        low = max(low, min(near, far))
                        high = min(high, max(near, far))
                if low < high:
                    inside = True
                    break
            found[row - first_row, column - first_column] = inside
    return found


@njit(cache=True, error_model="numpy", boundscheck=False)
def _felt(
    distance: np.ndarray,
    row: int,
    column: int,
    first_row: int,
    last_row: int,
    first_column: int,
    last_column: int,
    resolution_m: float,
) -> bool:
    """Whether an edit inside a box may reach a cell: not farther than its nearest obstacle was."""
    down = max(first_row - row, row - last_row, 0)
    across = max(first_column - column, column - last_column, 0)
    # 1.5 cells: a straight line between cells passes their neighbours at most so much too far.
    reach = float(distance[row, column]) / resolution_m + 1.5
    return float(down * down + across * across) <= reach * reach


@njit(cache=True, error_model="numpy", boundscheck=False)
def distance_window(
    distance: np.ndarray,
    resolution_m: float,
    first_row: int,
    last_row: int,
    first_column: int,
    last_column: int,
) -> tuple[int, int, int, int]:
    """Window outside which no distance changes when obstacles in a box come or go.

    Distances are those before the edit. On the straight line from a cell that feels the
    edit to where it was made all cells feel it, so the window may grow ring by ring.
    """
    rows, columns = distance.shape
    top, bottom, right, left = last_row, first_row, last_column, first_column
    growing = True
    while growing:
        growing = False
        if top + 1 < rows:
            for column in range(max(left - 1, 0), min(right + 1, columns - 1) + 1):
                if _felt(
                    distance, top + 1, column, first_row, last_row, first_column, last_column, resolution_m
                ):
                    top += 1
                    growing = True
                    break
        if bottom > 0:
            for column in range(max(left - 1, 0), min(right + 1, columns - 1) + 1):
                if _felt(
                    distance, bottom - 1, column, first_row, last_row, first_column, last_column, resolution_m
                ):
                    bottom -= 1
                    growing = True
                    break
        if right + 1 < columns:
            for row in range(max(bottom - 1, 0), min(top + 1, rows - 1) + 1):
                if _felt(
                    distance, row, right + 1, first_row, last_row, first_column, last_column, resolution_m
                ):
                    right += 1
                    growing = True
                    break
        if left > 0:
            for row in range(max(bottom - 1, 0), min(top + 1, rows - 1) + 1):
                if _felt(
                    distance, row, left - 1, first_row, last_row, first_column, last_column, resolution_m
                ):
                    left -= 1
                    growing = True
                    break
    return bottom, top, left, right


@njit(cache=True, error_model="numpy", boundscheck=False)
def cells_near_changes(
    before: np.ndarray, distance: np.ndarray, mark: np.ndarray, first_row: int, first_column: int
) -> tuple[np.ndarray, np.ndarray]:
    """Cells of a window whose distance changed, and those with their neighbours, which are queued for thinning."""
    rows, columns = distance.shape
    changed = np.empty(before.size, np.int32)
    count = 0
    for row in range(before.shape[0]):
        for column in range(before.shape[1]):
            if before[row, column] != distance[first_row + row, first_column + column]:
                changed[count] = (first_row + row) * columns + first_column + column
                count += 1
    near = np.empty(9 * count, np.int32)
    total = 0
    for place in range(count):
        cell = changed[place]
        row, column = cell // columns, cell % columns
        for k in range(9):
            r = row + ROW_STEP[k] if k < 8 else row
            c = column + COLUMN_STEP[k] if k < 8 else column
            if 0 <= r < rows and 0 <= c < columns and not mark[r, c] & _QUEUED:
                mark[r, c] |= _QUEUED
                near[total] = r * columns + c
                total += 1
    return changed[:count].copy(), near[:total].copy()


@njit(cache=True, error_model="numpy", boundscheck=False)
def forget(
    step: np.ndarray, mark: np.ndarray, potential: np.ndarray, seed: np.ndarray, roots: np.ndarray
) -> np.ndarray:
    """Take back the values of ``roots`` and of all cells that may have got theirs through them.

    Returns the cells beside them that keep a value, from which the gap is filled again.
    ``mark`` is used in between.
    """
    rows, columns = step.shape
    flat_step = step.ravel()
    flat_mark = mark.ravel()
    flat_potential = potential.ravel()
    flat_seed = seed.ravel()
    gone = np.empty(max(1024, 2 * len(roots)), np.int32)
    count = 0
    for cell in roots:
        if not flat_mark[cell] & _FORGOTTEN:
            flat_mark[cell] |= _FORGOTTEN
            gone[count] = cell
            count += 1
    head = 0
    while head < count:
        cell = gone[head]
        head += 1
        origin = flat_seed[cell]
        if origin < 0:
            continue
        value = np.int64(flat_potential[cell])
        row, column = cell // columns, cell % columns
        for k in range(8):
            r, c = row + ROW_STEP[k], column + COLUMN_STEP[k]
            if r < 0 or r >= rows or c < 0 or c >= columns:
                continue
            other = r * columns + c
            if flat_seed[other] != origin or flat_mark[other] & _FORGOTTEN:
                continue
            cost = np.int64(flat_step[other])
            cost = cost if k & 1 == 0 else diagonal(cost)
            if value + cost == flat_potential[other]:
                flat_mark[other] |= _FORGOTTEN
                if count == len(gone):
                    gone = _longer(gone)
                gone[count] = other
                count += 1
    for place in range(count):
        flat_potential[gone[place]] = UNREACHED
        flat_seed[gone[place]] = -1
    border = np.empty(1024, np.int32)
    total = 0
    for place in range(count):
        cell = gone[place]
        row, column = cell // columns, cell % columns
        for k in range(8):
            r, c = row + ROW_STEP[k], column + COLUMN_STEP[k]
            if r < 0 or r >= rows or c < 0 or c >= columns:
                continue
            other = r * columns + c
            if flat_seed[other] >= 0 and not flat_mark[other] & _FORGOTTEN:
                flat_mark[other] |= _FORGOTTEN
                if total == len(border):
                    border = _longer(border)
                border[total] = other
                total += 1
    for place in range(count):
        flat_mark[gone[place]] &= np.uint8(7)
    for place in range(total):
        flat_mark[border[place]] &= np.uint8(7)
    return border[:total].copy()


@njit(cache=True, error_model="numpy", boundscheck=False)
def _longer(array: np.ndarray) -> np.ndarray:
    larger = np.empty(2 * len(array), array.dtype)
    larger[: len(array)] = array
    return larger
