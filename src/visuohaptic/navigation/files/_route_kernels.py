"""Straight lines between cells: their clearance, and splitting of a path to keep a clearance."""

from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel
from ..graph.tracing._path_kernels import longer_rows
from ..pushing._outline_kernels import segment_distance, square_gap


@kernel(error_model="numpy")
def chord_clearance(
    distance: np.ndarray, y0: int, x0: int, y1: int, x1: int, limit: float, outside_blocks: bool
) -> float:
    """Distance [cells] of the segment between two cell centres from the nearest obstacle's square, at most ``limit``.

    ``distance`` (rows, columns) [cells] from the border of the obstacles' squares, 0 inside them; squares are only
    evaluated where it allows an obstacle nearer than the nearest known one.

    Parameters
    ----------
    distance
        Clearance of each cell [cells], from the border of the obstacles' squares.
    y0, x0, y1, x1
        Row and column of both ends.
    limit
        Maximum distance that is evaluated [cells].
    outside_blocks
        Whether everything outside the map is an obstacle.
    """
    rows, columns = distance.shape
    count = max(1, int(math.ceil(math.hypot(y1 - y0, x1 - x0))))
    half = 0.5 * math.hypot(y1 - y0, x1 - x0) / count
    best, square = limit, np.zeros((4, 2))
    for k in range(count):
        y, x = y0 + (k + 0.5) / count * (y1 - y0), x0 + (k + 0.5) / count * (x1 - x0)
        row, column = int(math.floor(y + 0.5)), int(math.floor(x + 0.5))
        off = math.hypot(y - row, x - column) + half
        if float(distance[row, column]) - off >= best:
            continue
        reach = int(math.ceil(best + off + 0.5))
        for r in range(row - reach, row + reach + 1):
            for c in range(column - reach, column + reach + 1):
                if r < 0 or c < 0 or r >= rows or c >= columns:
                    if not outside_blocks:
                        continue
                elif distance[r, c] > 0.0:
                    continue
                best = min(best, square_gap(x0 + 0.5, y0 + 0.5, x1 + 0.5, y1 + 0.5, c, r, 0.0, square))
    return best


@kernel(error_model="numpy")
def split_path(distance: np.ndarray, path: np.ndarray, radius: float, outside_blocks: bool) -> np.ndarray:
    """Mask of the cells of a path, including first and last, between which straight lines keep a clearance.

    Parameters
    ----------
    distance
        Clearance of each cell [cells], from the border of the obstacles' squares.
    path
        Cells (row, column), (k, 2).
    radius
        Clearance to keep [cells].
    outside_blocks
        Whether everything outside the map is an obstacle.
    """
    count = len(path)
    cut = np.zeros(count, np.bool_)
    cut[0] = cut[count - 1] = True
    stack = np.empty((count + 1, 2), np.int64)
    stack[0, 0], stack[0, 1] = 0, count - 1
    waiting = 1
    while waiting > 0:
        waiting -= 1
        begin, end = stack[waiting, 0], stack[waiting, 1]
        if end - begin < 2:
            continue
        y0, x0, y1, x1 = path[begin, 0], path[begin, 1], path[end, 0], path[end, 1]
        if chord_clearance(distance, y0, x0, y1, x1, radius, outside_blocks) >= radius:
            continue
        # Split in the middle if all cells lie on the line.
        middle, farthest = (begin + end) // 2, 1e-9
        for k in range(begin + 1, end):
            away = segment_distance(path[k, 1], path[k, 0], x0, y0, x1, y1)
            if away > farthest:
                middle, farthest = k, away
        cut[middle] = True
        stack[waiting, 0], stack[waiting, 1] = begin, middle
        stack[waiting + 1, 0], stack[waiting + 1, 1] = middle, end
        waiting += 2
    return cut


@kernel(error_model="numpy")
def onward(potential: np.ndarray, seed: np.ndarray, row: int, column: int) -> np.ndarray:
    """Cells (row, column) from a cell to the node of its region, (k, 2): steepest descent of the potential inside the region.

    Parameters
    ----------
    potential, seed
        Cost from the node and flat cell of the node, (rows, columns).
    row, column
        First cell, in a region.
    """
    path = np.empty((64, 2), np.int64)
    count = 0
    while True:
        if count == len(path):
            path = longer_rows(path)
        path[count, 0], path[count, 1] = row, column
        count += 1
        here, own = potential[row, column], seed[row, column]
        steepest, to_row, to_column = 0.0, row, column
        for r in range(max(row - 1, 0), min(row + 2, potential.shape[0])):
            for c in range(max(column - 1, 0), min(column + 2, potential.shape[1])):
                if seed[r, c] == own and potential[r, c] < here:
                    slope = float(here - potential[r, c]) / math.hypot(r - row, c - column)
                    if slope > steepest:
                        steepest, to_row, to_column = slope, r, c
        if steepest <= 0.0:
            return path[:count]
        row, column = to_row, to_column


@kernel(error_model="numpy")
def _cost(distance: float, speeds: np.ndarray) -> float:
    """Cost per length [s/m] at a distance from obstacles; ``speeds`` = (radius, 1 / v_min, 1 / v_max)."""
    fraction = min(max((distance / speeds[0] - 1.0) / 2.0, 0.0), 1.0)
    return speeds[1] + fraction * (speeds[2] - speeds[1])


@kernel(error_model="numpy")
def chord_measures(
    distance: np.ndarray, corners: np.ndarray, speeds: np.ndarray, outside_blocks: bool
) -> np.ndarray:
    """Cost [s cells/m], length and clearance [cells] of the straight lines between cells (k, 2), (k - 1, 3).

    ``speeds`` as in Eq. (4.1): (radius [cells], 1 / v_min, 1 / v_max); the cost is summed over steps of at most
    one cell, with the distance of the cell that contains the middle of the step.

    Parameters
    ----------
    distance
        Clearance of each cell [cells], from the border of the obstacles' squares.
    corners
        Cells (row, column), (k, 2).
    speeds
        Radius [cells], 1 / v_min and 1 / v_max [s/m].
    outside_blocks
        Whether everything outside the map is an obstacle.
    """
    measures = np.empty((len(corners) - 1, 3))
    for k in range(len(corners) - 1):
        y0, x0, y1, x1 = corners[k, 0], corners[k, 1], corners[k + 1, 0], corners[k + 1, 1]
        length = math.hypot(y1 - y0, x1 - x0)
        count = max(1, int(math.ceil(length)))
        total = 0.0
        for i in range(count):
            y, x = y0 + (i + 0.5) / count * (y1 - y0), x0 + (i + 0.5) / count * (x1 - x0)
            total += _cost(float(distance[int(math.floor(y + 0.5)), int(math.floor(x + 0.5))]), speeds)
        measures[k, 0] = total * length / count
        measures[k, 1] = length
        measures[k, 2] = chord_clearance(distance, y0, x0, y1, x1, 3.0 * speeds[0], outside_blocks)
    return measures
