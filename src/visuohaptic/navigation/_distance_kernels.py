"""Exact Euclidean distance in two passes, and the fixed-point cost of a step, row by row."""

from __future__ import annotations

import math

import numpy as np

from ..kernels import kernel

__all__ = ["FAR", "distance_rows", "distance_update", "vertical_cells", "vertical_update"]

#: No obstacle in this column.
FAR = np.uint16(65535)


@kernel(error_model="numpy", boundscheck=False)
def vertical_cells(cells: np.ndarray, threshold: int, unknown_blocks: bool, vertical: np.ndarray) -> None:
    """Rows to the nearest obstacle of the same column, at most 65534; ``FAR`` where there is none.

    ``cells`` (rows, columns) int8; a cell is an obstacle from ``threshold`` on, and where it is
    negative if ``unknown_blocks``; then so are the rows before the first and after the last, which
    are unknown, too. ``vertical`` (rows, columns) uint16 is filled.
    """
    rows, columns = cells.shape
    low = np.int8(-1) if unknown_blocks else np.int8(-128)
    high = np.int8(threshold)
    # Saturating additions in 32 bits, so that the loops over columns become vector code.
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


@kernel(error_model="numpy", boundscheck=False)
def vertical_update(
    cells: np.ndarray,
    threshold: int,
    unknown_blocks: bool,
    vertical: np.ndarray,
    first_row: int,
    last_row: int,
    first_column: int,
    last_column: int,
) -> None:
    """Bring ``vertical`` up to date after cells of a window (both ends included) have changed."""
    rows = cells.shape[0]
    low = np.int8(-1) if unknown_blocks else np.int8(-128)
    high = np.int8(threshold)
    for column in range(first_column, last_column + 1):
        # The nearest obstacle above and below the window, from what is known of the rows beside it.
        top = last_row + 1
        while top < rows and not (cells[top, column] >= high or cells[top, column] == low):
            top += 1
        bottom = first_row - 1
        while bottom >= 0 and not (cells[bottom, column] >= high or cells[bottom, column] == low):
            bottom -= 1
        start = max(bottom, 0)
        stop = min(top, rows - 1)
        counted = 0 if unknown_blocks and bottom < 0 else 65535
        for row in range(start, stop + 1):
            blocked = cells[row, column] >= high or cells[row, column] == low
            counted = 0 if blocked else min(counted + 1, 65535)
            vertical[row, column] = counted
        counted = 0 if unknown_blocks and top == rows else 65535
        for row in range(stop, start - 1, -1):
            counted = min(counted + 1, 65535)
            if vertical[row, column] < counted:
                counted = vertical[row, column]
            vertical[row, column] = counted


@kernel(error_model="numpy", boundscheck=False)
def _envelope(
    line: np.ndarray,
    column: int,
    end: int,
    vertex: np.ndarray,
    height: np.ndarray,
    border: np.ndarray,
    outside_blocks: bool,
) -> int:
    """Lower envelope over a run of cells ``column..end - 1`` between two obstacles of a row; returns its pieces.

    Piece k is the parabola of source ``vertex[k]``, whose least value is ``height[k] - vertex[k]^2``,
    from ``border[k]`` on. With ``outside_blocks`` there are obstacles before the first and after the last column.
    """
    columns = len(line)
    begin = column - 1 if column > 0 or outside_blocks else 0
    stop = end if end < columns or outside_blocks else columns - 1  # last column that can be a source
    count = 0
    for u in range(begin, stop + 1):
        away = np.uint16(0) if u < 0 or u >= columns else line[u]
        if away == FAR:
            continue
        # Not above the cone of an obstacle that bounds the run: it would never be the lowest.
        value = float(away) * float(away)
        top = value + float(u) * float(u)
        here = 0
        while count > 0:
            v = vertex[count - 1]
            crossing = math.floor((top - height[count - 1]) / (2.0 * (u - v)))
            here = int(crossing) + 1
            if here <= border[count - 1] and count > 1:
                count -= 1
                continue
            if here <= begin:
                count -= 1
                here = 0
                continue
            break
        if count == 0:
            here = begin
        if here <= stop:
            vertex[count] = u
            height[count] = top
            border[count] = here
            count += 1
    return count


@kernel(error_model="numpy", boundscheck=False)
def distance_rows(
    vertical: np.ndarray,
    resolution_m: float,
    steps: np.ndarray,
    outside_blocks: bool,
    distance: np.ndarray,
    step: np.ndarray,
) -> None:
    """Distances [m] and steps of all rows, from the vertical distances.

    Lower envelope of the parabolas ``(x - u)^2 + vertical(u)^2`` (Felzenszwalb and Huttenlocher
    2012) over each run of cells between two obstacles of a row: what lies behind an obstacle is
    never nearer than the obstacle.

    ``steps`` (d2,) uint16, cost of a straight step by squared distance [cells^2], the last for all
    above; ``distance`` float32 and ``step`` uint16, (rows, columns), are filled. ``outside_blocks`` as
    ``unknown_blocks`` of :func:`vertical_cells`.
    """
    rows, columns = vertical.shape
    vertex = np.zeros(columns + 2, np.int32)
    height = np.zeros(columns + 2, np.float64)
    border = np.zeros(columns + 2, np.int32)
    last = len(steps) - 1
    for row in range(rows):
        line = vertical[row]
        column = 0
        while column < columns:
            if line[column] == 0:
                distance[row, column] = 0.0
                step[row, column] = steps[0]
                column += 1
                continue
            end = column
            while end < columns and line[end] != 0:
                end += 1
            count = _envelope(line, column, end, vertex, height, border, outside_blocks)
            if count == 0:
                for x in range(column, end):
                    distance[row, x] = np.inf
                    step[row, x] = steps[last]
            for k in range(count):
                v = vertex[k]
                fall = np.int64(height[k]) - np.int64(v) * np.int64(v)
                low = max(border[k], column)
                high = border[k + 1] if k + 1 < count else end
                for x in range(low, min(high, end)):
                    squared = np.int64(x - v) * np.int64(x - v) + fall
                    distance[row, x] = np.float32(math.sqrt(float(squared)) * resolution_m)
                    step[row, x] = steps[min(squared, np.int64(last))]
            column = end


@kernel(error_model="numpy", boundscheck=False)
def distance_update(
    vertical: np.ndarray,
    first_row: int,
    last_row: int,
    first_column: int,
    last_column: int,
    resolution_m: float,
    steps: np.ndarray,
    outside_blocks: bool,
    distance: np.ndarray,
    step: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """As :func:`distance_rows` in a window (both ends included) outside which nothing has changed.

    Returns the cells (flat) whose distance is another now, and those of them whose step is.
    """
    columns = vertical.shape[1]
    vertex = np.zeros(columns + 2, np.int32)
    height = np.zeros(columns + 2, np.float64)
    border = np.zeros(columns + 2, np.int32)
    squares = np.empty(columns + 1, np.int64)  # [cells^2], -1 where there is no obstacle
    last = len(steps) - 1
    room = max(0, (last_row - first_row + 1) * (last_column - first_column + 1))
    changed = np.empty(room, np.int32)
    dearer = np.empty(room, np.int32)
    count, dear = 0, 0
    for row in range(first_row, last_row + 1):
        line = vertical[row]
        start = first_column
        while start > 0 and line[start] != 0:
            start -= 1
        column = start
        while column <= last_column:
            if line[column] == 0:
                squares[column] = 0
                column += 1
                continue
            end = column
            while end < columns and line[end] != 0:
                end += 1
            pieces = _envelope(line, column, end, vertex, height, border, outside_blocks)
            low_end, high_end = max(column, first_column), min(end, last_column + 1)
            if pieces == 0:
                squares[low_end:high_end] = -1
            for k in range(pieces):
                v = vertex[k]
                fall = np.int64(height[k]) - np.int64(v) * np.int64(v)
                low = max(border[k], low_end)
                high = min(border[k + 1] if k + 1 < pieces else end, high_end)
                for x in range(low, high):
                    squares[x] = np.int64(x - v) * np.int64(x - v) + fall
            column = end
        here = distance[row]
        for x in range(first_column, last_column + 1):
            squared = squares[x]
            fresh = (
                np.float32(np.inf) if squared < 0 else np.float32(math.sqrt(float(squared)) * resolution_m)
            )
            if fresh == here[x]:
                continue
            here[x] = fresh
            cell = row * columns + x
            changed[count] = cell
            count += 1
            new = steps[last if squared < 0 else min(squared, last)]
            if new != step[row, x]:
                step[row, x] = new
                dearer[dear] = cell
                dear += 1
    return changed[:count].copy(), dearer[:dear].copy()
