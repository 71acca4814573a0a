"""Where an edit of the map is felt: the window of distances, the cells to thin again, the potentials that fall."""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel
from ._region_kernels import UNREACHED, diagonal
from ._sweep_kernels import TILE, touch
from .tracing._path_kernels import longer
from .tracing._skeleton_kernels import COLUMN_STEP, ROW_STEP

__all__ = [
    "differences",
    "distance_window",
    "forget",
    "on_skeleton",
    "queue_near",
    "release",
    "with_neighbours",
]

_QUEUED = np.uint8(2)
_FORGOTTEN = np.uint8(8)


@kernel(error_model="numpy", boundscheck=False)
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
    # 0.75 cells: the centre of an obstacle is at most half a diagonal farther than its border.
    reach = float(distance[row, column]) / resolution_m + 2.25
    return float(down * down + across * across) <= reach * reach


@kernel(error_model="numpy", boundscheck=False)
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

    Parameters
    ----------
    distance
        Clearance of each cell before the edit [m].
    resolution_m
        Edge length of a cell [m].
    first_row, last_row, first_column, last_column
        Box of the edit, both ends included.
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


@kernel(error_model="numpy", boundscheck=False)
def queue_near(changed: np.ndarray, mark: np.ndarray) -> np.ndarray:
    """Queue cells (flat) and their neighbours for thinning; returns them, each once.

    Parameters
    ----------
    changed
        Cells (flat).
    mark
        Marks of the skeleton, (rows, columns) uint8.
    """
    rows, columns = mark.shape
    flat = mark.ravel()
    near = np.empty(9 * len(changed), np.int32)
    total = 0
    for cell in changed:
        row = cell // columns
        column = cell - row * columns
        left, right = max(column - 1, 0), min(column + 1, columns - 1)
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            for other in range(r * columns + left, r * columns + right + 1):
                if not flat[other] & _QUEUED:
                    flat[other] |= _QUEUED
                    near[total] = other
                    total += 1
    return near[:total].copy()


@kernel(error_model="numpy", boundscheck=False)
def differences(old: np.ndarray, new: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What is in ``old`` only and what is in ``new`` only; both ascending.

    Parameters
    ----------
    old, new
        Ascending numbers.
    """
    removed, added = np.empty_like(old), np.empty_like(new)
    gone, come, i, j = 0, 0, 0, 0
    while i < len(old) or j < len(new):
        if j == len(new) or (i < len(old) and old[i] < new[j]):
            removed[gone] = old[i]
            gone += 1
            i += 1
        elif i == len(old) or new[j] < old[i]:
            added[come] = new[j]
            come += 1
            j += 1
        else:
            i += 1
            j += 1
    return removed[:gone].copy(), added[:come].copy()


@kernel(error_model="numpy", boundscheck=False)
def _holds(seed: np.ndarray, node: int, window: tuple[int, int, int, int]) -> bool:
    """Whether a cell of a window belongs to a node."""
    first_row, last_row, first_column, last_column = window
    for row in range(first_row, last_row + 1):
        line = seed[row, first_column : last_column + 1]
        found = 0
        for k in range(len(line)):
            found += line[k] == node
        if found > 0:
            return True
    return False


@kernel(error_model="numpy", boundscheck=False)
def release(potential: np.ndarray, seed: np.ndarray, nodes: np.ndarray, tiles: np.ndarray) -> None:
    """Take back the values of all cells that belong to ``nodes`` (flat cells), and note their tiles.

    A region hangs together: its window is complete when no strip beside it has a cell of it.

    Parameters
    ----------
    potential
        Cost from each cell to its node [units], (rows, columns) int32.
    seed
        Flat cell of the node that each cell belongs to, (rows, columns) int32.
    nodes
        Flat cells of the nodes.
    tiles
        One uint8 per tile of ``TILE`` x ``TILE`` cells, 1 where noted.
    """
    rows, columns = seed.shape
    for node in nodes:
        bottom, left = node // columns // TILE * TILE, node % columns // TILE * TILE
        top, right = min(bottom + TILE, rows) - 1, min(left + TILE, columns) - 1
        growing = True
        while growing:
            growing = False
            a, b = max(left - TILE, 0), min(right + TILE, columns - 1)
            if top < rows - 1:
                target = min(top + TILE, rows - 1)
                if _holds(seed, node, (top + 1, target, a, b)):
                    top, growing = target, True
            if bottom > 0 and _holds(seed, node, (bottom - TILE, bottom - 1, a, b)):
                bottom, growing = bottom - TILE, True
            a, b = max(bottom - TILE, 0), min(top + TILE, rows - 1)
            if right < columns - 1:
                target = min(right + TILE, columns - 1)
                if _holds(seed, node, (a, b, right + 1, target)):
                    right, growing = target, True
            if left > 0 and _holds(seed, node, (a, b, left - TILE, left - 1)):
                left, growing = left - TILE, True
        for row in range(bottom, top + 1):
            for place in range(left, right + 1, TILE):
                here = seed[row, place : min(place + TILE, right + 1)]
                value = potential[row, place : min(place + TILE, right + 1)]
                found = 0
                for k in range(len(here)):
                    own = here[k] == node
                    found += own
                    value[k] = UNREACHED if own else value[k]
                    here[k] = -1 if own else here[k]
                if found > 0:
                    tiles[row // TILE, place // TILE] = 1


@kernel(error_model="numpy", boundscheck=False)
def forget(
    step: np.ndarray,
    mark: np.ndarray,
    potential: np.ndarray,
    seed: np.ndarray,
    roots: np.ndarray,
    tiles: np.ndarray,
    limit: int,
) -> bool:
    """Take back the values of ``roots`` and of all cells that may have got theirs through them.

    Their tiles are noted; ``mark`` is used in between. Returns whether there were at most
    ``limit``; if not, nothing is changed.

    Parameters
    ----------
    step
        Cost of a straight step onto each cell [units], (rows, columns) uint16; 0 where the robot does not fit.
    mark
        Marks of the skeleton, (rows, columns) uint8.
    potential
        Cost from each cell to its node [units], (rows, columns) int32.
    seed
        Flat cell of the node that each cell belongs to, (rows, columns) int32.
    roots
        Cells (flat).
    tiles
        One uint8 per tile of ``TILE`` x ``TILE`` cells, 1 where noted.
    limit
        Maximum number of cells.
    """
    rows, columns = step.shape
    flat_step = step.ravel()
    flat_mark = mark.ravel()
    flat_potential = potential.ravel()
    flat_seed = seed.ravel()
    offsets = np.empty(8, np.int32)
    for k in range(8):
        offsets[k] = ROW_STEP[k] * columns + COLUMN_STEP[k]
    gone = np.empty(max(1024, 2 * len(roots)), np.int32)
    count = 0
    for cell in roots:
        if not flat_mark[cell] & _FORGOTTEN:
            flat_mark[cell] |= _FORGOTTEN
            gone[count] = cell
            count += 1
    head = 0
    while head < count:
        if count > limit:
            for place in range(count):
                flat_mark[gone[place]] &= np.uint8(7)
            return False
        cell = gone[head]
        head += 1
        origin = flat_seed[cell]
        if origin < 0:
            continue
        value = np.int64(flat_potential[cell])
        row = cell // columns
        column = cell - row * columns
        inside = 0 < row < rows - 1 and 0 < column < columns - 1
        if count + 8 > len(gone):
            gone = longer(gone)
        for k in range(8):
            if not inside:
                r, c = row + ROW_STEP[k], column + COLUMN_STEP[k]
                if r < 0 or r >= rows or c < 0 or c >= columns:
                    continue
            other = cell + offsets[k]
            more = flat_potential[other] - value
            # Whoever got its value here costs more and is of the same node.
            if more <= 0 or flat_seed[other] != origin:
                continue
            cost = np.int64(flat_step[other])
            if more == (diagonal(cost) if k & 1 else cost) and not flat_mark[other] & _FORGOTTEN:
                flat_mark[other] |= _FORGOTTEN
                gone[count] = other
                count += 1
    for place in range(count):
        flat_potential[gone[place]] = UNREACHED
        flat_seed[gone[place]] = -1
    for place in range(count):
        flat_mark[gone[place]] &= np.uint8(7)
    touch(tiles, gone[:count], columns, 0)
    return True


@kernel(error_model="numpy", boundscheck=False)
def on_skeleton(cells: np.ndarray, mark: np.ndarray) -> np.ndarray:
    """Those of some cells (flat) that are on the skeleton.

    Parameters
    ----------
    cells
        Flat indices.
    mark
        Marks of the skeleton, (rows, columns) uint8.
    """
    flat = mark.ravel()
    found = np.empty(len(cells), np.int32)
    count = 0
    for cell in cells:
        if flat[cell] & 1:
            found[count] = cell
            count += 1
    return found[:count].copy()


@kernel(error_model="numpy", boundscheck=False)
def with_neighbours(cells: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Cells (flat) and their eight neighbours, some more than once.

    Parameters
    ----------
    cells
        Flat indices.
    rows, columns
        Shape of the map.
    """
    found = np.empty(9 * len(cells), np.int32)
    count = 0
    for cell in cells:
        row = cell // columns
        column = cell - row * columns
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            for c in range(max(column - 1, 0), min(column + 2, columns)):
                found[count] = r * columns + c
                count += 1
    return found[:count]
