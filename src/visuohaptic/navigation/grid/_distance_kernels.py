"""Exact Euclidean distance in two passes, and the fixed-point cost of a step, row by row."""

from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel

#: No obstacle in this column.
FAR = np.uint16(65535)
#: Maximum reach of the sweep [cells]: (2 reach + 3)^2 + (2 reach - 1)^2, the largest sum of two squares, has 16 bits.
SWEPT_REACH = 90


@kernel(error_model="numpy")
def vertical_cells(cells: np.ndarray, threshold: int, unknown_blocks: bool, vertical: np.ndarray) -> None:
    """Rows to the nearest obstacle of the same column, at most 65534; ``FAR`` without an obstacle.

    ``cells`` (rows, columns) int8; a cell is an obstacle if its value is at least ``threshold``, or
    negative with ``unknown_blocks``; then the unknown rows before the first and after the last are
    obstacles, too. ``vertical`` (rows, columns) uint16 is filled.

    Parameters
    ----------
    cells
        Occupancy, (rows, columns) int8.
    threshold
        Minimum occupancy of an obstacle.
    unknown_blocks
        Whether unknown cells are obstacles.
    vertical
        Rows to the nearest obstacle of the column, (rows, columns) uint16.
    """
    rows, columns = cells.shape
    low = np.int8(-1) if unknown_blocks else np.int8(-128)
    high = np.int8(threshold)
    # Saturating additions in 32 bits, so that the loops over columns are vectorized.
    beyond = np.int32(0) if unknown_blocks else np.int32(65535)
    before = np.full(columns, beyond, np.int32)
    for row in range(rows):
        for column in range(columns):
            value = cells[row, column]
            counted = min(before[column] + np.int32(1), np.int32(65535))
            counted = np.int32(0) if (value >= high) | (value == low) else counted
            before[column] = counted
            vertical[row, column] = np.uint16(counted)
    if unknown_blocks:
        for column in range(columns):
            vertical[rows - 1, column] = min(vertical[rows - 1, column], np.uint16(1))
    for row in range(rows - 2, -1, -1):
        for column in range(columns):
            below = np.int32(vertical[row + 1, column]) + np.int32(1)
            vertical[row, column] = np.uint16(min(np.int32(vertical[row, column]), below))


@kernel(error_model="numpy")
def _envelope(
    line: np.ndarray,
    column: int,
    end: int,
    vertex: np.ndarray,
    height: np.ndarray,
    border: np.ndarray,
    outside_blocks: bool,
) -> int:
    """Lower envelope over a run of cells ``column..end - 1`` between two obstacles of a row; returns its number of pieces.

    An obstacle is a closed square. Its nearest point to the centre of a cell in another column is
    on the side that faces the cell: the sources are the sides ``column..end`` between columns, side k
    left of column k, each with the nearer obstacle of its two columns.
    Piece k is the parabola of source ``vertex[k]`` with minimum ``height[k] - vertex[k]^2``
    [cells^2, multiples of a quarter], for cells from ``border[k]`` on. With ``outside_blocks`` there are
    obstacles before the first and after the last column.
    """
    columns = len(line)
    beyond = np.int64(0) if outside_blocks else np.int64(FAR)
    count = 0
    right = np.int64(line[column - 1]) if column > 0 else beyond
    for u in range(column, end + 1):
        left, right = right, np.int64(line[u]) if u < columns else beyond
        away = min(left, right)
        if away >= FAR:
            continue
        value = max(float(away) - 0.5, 0.0)
        top = value * value + float(u) * float(u)
        here = column
        while count > 0:
            crossing = (top - height[count - 1]) / (2.0 * (u - vertex[count - 1]))
            here = int(math.floor(crossing + 0.5))  # the first cell whose centre is not before it
            if here > border[count - 1]:
                break
            count -= 1
            here = column
        if here < end:
            vertex[count] = u
            height[count] = top
            border[count] = here
            count += 1
    return count


@kernel(error_model="numpy")
def distance_rows(
    vertical: np.ndarray,
    resolution_m: float,
    steps: np.ndarray,
    outside_blocks: bool,
    distance: np.ndarray,
    step: np.ndarray,
) -> None:
    """Distances [m] between cell centres and the border of the nearest obstacle's cell, and steps, of all rows.

    Lower envelope of parabolas (Felzenszwalb and Huttenlocher 2012) about the sides of the obstacles' squares
    over each run of cells between two obstacles of a row: whatever is behind an obstacle is never
    nearer than the obstacle. 0 in an obstacle, half a cell next to one.

    ``steps`` (d2,) uint16, cost of a straight step by squared distance [cells^2 / 4], the last for all
    larger ones; ``distance`` float32 and ``step`` uint16, (rows, columns), are filled. ``outside_blocks`` as
    ``unknown_blocks`` of :func:`vertical_cells`.

    Parameters
    ----------
    vertical
        Rows to the nearest obstacle of the column, (rows, columns) uint16.
    resolution_m
        Edge length of a cell [m].
    steps
        Cost of a straight step by squared distance [cells^2 / 4], uint16.
    outside_blocks
        Whether everything outside the map is an obstacle.
    distance
        Clearance of each cell [m], (rows, columns) float32; filled.
    step
        Cost of a straight step onto each cell [units], (rows, columns) uint16; filled.
    """
    exact_distance(vertical, outside_blocks, distance)
    last = len(steps) - 1
    for row in range(distance.shape[0]):
        for column in range(distance.shape[1]):
            quarters = 4.0 * float(distance[row, column]) ** 2
            # An integer, exact in single precision within the range of the table.
            step[row, column] = steps[int(quarters + 0.5) if quarters < last else last]
            distance[row, column] *= resolution_m


@kernel(error_model="numpy")
def swept_distance(vertical: np.ndarray, reach: float, outside_blocks: bool, distance: np.ndarray) -> None:
    """The distances of :func:`exact_distance`, clipped to a reach of at most ``SWEPT_REACH``, faster.

    Columns are compared in order of their distance, a whole row at a time, until no cell of the row can become nearer.

    Parameters
    ----------
    vertical, outside_blocks, distance
        See :func:`exact_distance`.
    reach
        Maximum distance that matters [cells].
    """
    rows, columns = vertical.shape
    wide = int(math.ceil(reach)) + 1
    # Four times the squared distances from the obstacle of each column, beyond the ends of the row as well.
    high = np.full(columns + 2 * wide, np.uint16(0 if outside_blocks else (2 * wide + 1) ** 2), np.uint16)
    own = high[wide : wide + columns]
    squared = np.empty(columns, np.uint16)
    for row in range(rows):
        line, out = vertical[row], distance[row]
        most = np.uint16(0)
        for x in range(columns):
            away = np.uint16(2 * max(min(line[x], np.uint16(wide + 1)), np.uint16(1)) - 1)
            four = np.uint16(away * away) if line[x] > 0 else np.uint16(0)
            own[x] = four
            squared[x] = four
            most = max(most, four)
        for across in range(1, wide):
            aside = np.uint16((2 * across - 1) ** 2)
            if aside >= most:
                break
            left = high[wide - across : wide + columns - across]
            right = high[wide + across : wide + columns + across]
            most = np.uint16(0)
            for x in range(columns):
                four = min(np.uint16(min(left[x], right[x]) + aside), squared[x])
                squared[x] = four
                most = max(most, four)
        for x in range(columns):
            out[x] = min(np.float32(math.sqrt(np.float32(squared[x]))) * np.float32(0.5), np.float32(reach))


@kernel(error_model="numpy")
def exact_distance(vertical: np.ndarray, outside_blocks: bool, distance: np.ndarray) -> None:
    """The distances of :func:`distance_rows` [cells].

    Parameters
    ----------
    vertical
        Rows to the nearest obstacle of the column, (rows, columns) uint16.
    outside_blocks
        Whether everything outside the map is an obstacle.
    distance
        Clearance of each cell [cells], (rows, columns) float32; filled.
    """
    rows, columns = vertical.shape
    vertex = np.zeros(columns + 2, np.int32)
    height = np.zeros(columns + 2, np.float64)
    border = np.zeros(columns + 2, np.int32)
    for row in range(rows):
        line, out = vertical[row], distance[row]
        out[:] = np.inf
        column = 0
        while column < columns:
            if line[column] == 0:
                out[column] = 0.0
                column += 1
                continue
            end = column
            while end < columns and line[end] != 0:
                end += 1
            count = _envelope(line, column, end, vertex, height, border, outside_blocks)
            for k in range(count):
                high = border[k + 1] if k + 1 < count else end
                # Four times the squared distance, an integer, from the source or from the obstacle in the cell's own column.
                aside = 4.0 * (height[k] - float(vertex[k]) ** 2)
                for x in range(border[k], high):
                    across, own = 2.0 * (x - vertex[k]) + 1.0, 2.0 * float(line[x]) - 1.0
                    out[x] = np.float32(math.sqrt(min(across * across + aside, own * own)) * 0.5)
            column = end
