"""Potential and nearest node of every cell, worked out from all nodes at once.

A cell's value is the pair (potential, seed): the smallest cost of a path from a seed, in whole units,
and of equal ones the smallest seed. Every cell on a path costs its ``step``, times sqrt(2)
where it is entered diagonally. Such pairs have one solution, whatever the order of the work.

The work goes in bands of potential not wider than the cheapest step: no path leads from a cell to another of the
same band, so all cells of a band are final once the bands below are done (Denardo and Fox 1979).
"""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel
from .tracing._path_kernels import longer
from .tracing._skeleton_kernels import COLUMN_STEP, ROW_STEP

__all__ = ["UNREACHED", "descend", "diagonal", "spread"]

#: Potential of cells that no node is reached from.
UNREACHED = np.int32(2**31 - 1)

#: Potential and cell in one number, which is sorted.
_SHIFT = 31
_CELL = np.int64(2**31 - 1)


@kernel(error_model="numpy", boundscheck=False, inline="always")
def diagonal(step: int) -> int:
    """A diagonal step [units]: sqrt(2) of a straight one, rounded.

    Parameters
    ----------
    step
        Cost of a straight step [units].
    """
    return (step * 92682 + 32768) >> 16


@kernel(error_model="numpy", boundscheck=False)
def _sort(values: np.ndarray, count: int) -> None:
    """Sort the first ``count`` values in place; a heap, because numba's own sort costs a second to compile."""
    begin, end = count // 2, count
    while end > 1:
        if begin > 0:
            begin -= 1
            value = values[begin]
        else:
            end -= 1
            value = values[end]
            values[end] = values[0]
        here = begin
        child = 2 * here + 1
        while child < end:
            if child + 1 < end and values[child + 1] > values[child]:
                child += 1
            if values[child] <= value:
                break
            values[here] = values[child]
            here = child
            child = 2 * here + 1
        values[here] = value


@kernel(error_model="numpy", boundscheck=False)
def spread(
    step: np.ndarray,
    potential: np.ndarray,
    seed: np.ndarray,
    cells: np.ndarray,
    slowest: int,
    fastest: int,
    side: int,
    queued: np.ndarray,
) -> int:
    """Spread the values of ``cells`` (flat indices) as far as they improve others; returns cells settled.

    ``step`` (rows, columns) uint16; ``potential`` and ``seed`` int32 hold the values before and after;
    ``slowest`` and ``fastest`` bound the steps of reachable cells. The map is worked on in squares of
    ``side`` cells, which stay in the cache; what crosses a border waits until its square's turn.
    ``queued`` (rows * columns,) uint8 is used in between: all 0 before and after.

    Parameters
    ----------
    step
        Cost of a straight step onto each cell [units], (rows, columns) uint16; 0 where the robot does not fit.
    potential
        Cost from each cell to its node [units], (rows, columns) int32.
    seed
        Flat cell of the node that each cell belongs to, (rows, columns) int32.
    cells
        To start from (flat).
    slowest, fastest
        Largest and smallest step of the reachable cells [units].
    side
        Edge length of the squares that are worked on [cells].
    queued
        Buffer (rows * columns,) uint8, all 0 before and after.
    """
    rows, columns = step.shape
    flat_step = step.ravel()
    flat_potential = potential.ravel()
    flat_seed = seed.ravel()
    # A power of two, so that bands are found by shifting.
    shift = 0
    while (2 << shift) <= fastest:
        shift += 1
    ring = 1
    while ring < (diagonal(slowest) >> shift) + 3:
        ring *= 2
    ring -= 1
    head = np.full(ring + 1, -1, np.int32)
    item = np.empty(4096, np.int32)
    following = np.empty(4096, np.int32)

    across = (columns + side - 1) // side
    squares = across * ((rows + side - 1) // side)
    # Cells that wait for their square, and squares that wait for their turn, each once.
    first = np.full(squares, -1, np.int32)
    waiting = np.zeros(squares, np.bool_)
    turn = np.empty(squares + 1, np.int32)
    turn_head, turn_tail = 0, 0
    cell_room = max(1024, 2 * len(cells))
    late = np.empty(cell_room, np.int32)
    late_next = np.empty(cell_room, np.int32)
    late_free = -1
    late_used = 0
    for cell in cells:
        square = (cell // columns) // side * across + (cell % columns) // side
        late[late_used] = cell
        late_next[late_used] = first[square]
        first[square] = late_used
        late_used += 1
        if not waiting[square]:
            waiting[square] = True
            turn[turn_tail] = square
            turn_tail += 1
    offsets = np.empty(8, np.int32)
    for k in range(8):
        offsets[k] = ROW_STEP[k] * columns + COLUMN_STEP[k]
    settled = 0
    sources = np.empty(1024, np.int64)
    while turn_head != turn_tail:
        square = turn[turn_head]
        turn_head = turn_head + 1 if turn_head < squares else 0
        waiting[square] = False
        row0, column0 = square // across * side, square % across * side
        row1, column1 = min(row0 + side, rows) - 1, min(column0 + side, columns) - 1
        count = 0
        place = first[square]
        first[square] = -1
        while place >= 0:
            if count == len(sources):
                sources = longer(sources)
            sources[count] = (np.int64(flat_potential[late[place]]) << _SHIFT) | late[place]
            count += 1
            rest = late_next[place]
            late_next[place] = late_free
            late_free = place
            place = rest
        # Sources have any potential: sorted, they enter as the bands reach them.
        _sort(sources, count)
        position = 0
        entries = 0
        free = -1
        used = 0
        now = 0
        while entries > 0 or position < count:
            if entries == 0:
                now = flat_potential[sources[position] & _CELL] >> shift
            while position < count and flat_potential[sources[position] & _CELL] >> shift <= now:
                cell = sources[position] & _CELL
                position += 1
                if flat_potential[cell] >> shift < now:
                    continue  # improved since, and done then
                if free < 0:
                    if used == len(item):
                        item, following = longer(item), longer(following)
                    free = used
                    following[free] = -1
                    used += 1
                entry = free
                free = following[entry]
                item[entry] = cell
                queued[cell] = 1
                following[entry] = head[now & ring]
                head[now & ring] = entry
                entries += 1
            place = head[now & ring]
            head[now & ring] = -1
            while place >= 0:
                cell = item[place]
                value = flat_potential[cell]
                rest = following[place]
                following[place] = free
                free = place
                place = rest
                entries -= 1
                if value >> shift != now or queued[cell] == 0:
                    continue  # reached by a cheaper path in the meantime
                queued[cell] = 0
                settled += 1
                origin = flat_seed[cell]
                row = cell // columns
                column = cell - row * columns
                inside = row0 < row < row1 and column0 < column < column1
                for k in range(8):
                    if not inside:
                        r, c = row + ROW_STEP[k], column + COLUMN_STEP[k]
                        if r < 0 or r >= rows or c < 0 or c >= columns:
                            continue
                    other = cell + offsets[k]
                    old = flat_potential[other]
                    if old <= value:
                        continue  # about half of them: where the path came from
                    cost = np.int64(flat_step[other])
                    if cost == 0:
                        continue
                    if k & 1:
                        cost = diagonal(cost)
                    reached = value + cost
                    if reached > old or (reached == old and origin >= flat_seed[other]):
                        continue
                    flat_potential[other] = reached
                    flat_seed[other] = origin
                    if queued[other] != 0 and old >> shift == reached >> shift:
                        continue  # it waits in that band already
                    if not inside and (r < row0 or r > row1 or c < column0 or c > column1):
                        if late_free < 0:
                            if late_used == len(late):
                                late, late_next = longer(late), longer(late_next)
                            late_free = late_used
                            late_next[late_free] = -1
                            late_used += 1
                        entry = late_free
                        late_free = late_next[entry]
                        beside = r // side * across + c // side
                        late[entry] = other
                        late_next[entry] = first[beside]
                        first[beside] = entry
                        if not waiting[beside]:
                            waiting[beside] = True
                            turn[turn_tail] = beside
                            turn_tail = turn_tail + 1 if turn_tail < squares else 0
                        continue
                    if free < 0:
                        if used == len(item):
                            item, following = longer(item), longer(following)
                        free = used
                        following[free] = -1
                        used += 1
                    entry = free
                    free = following[entry]
                    target = (reached >> shift) & ring
                    item[entry] = other
                    queued[other] = 1
                    following[entry] = head[target]
                    head[target] = entry
                    entries += 1
            now += 1
    return settled


@kernel(error_model="numpy", boundscheck=False)
def descend(step: np.ndarray, potential: np.ndarray, seed: np.ndarray, cell: int) -> np.ndarray:
    """Cells (flat) from ``cell`` to its node, each the next of the cheapest path; ties by the smallest index.

    Parameters
    ----------
    step
        Cost of a straight step onto each cell [units], (rows, columns) uint16; 0 where the robot does not fit.
    potential
        Cost from each cell to its node [units], (rows, columns) int32.
    seed
        Flat cell of the node that each cell belongs to, (rows, columns) int32.
    cell
        Flat index.
    """
    rows, columns = step.shape
    flat_potential = potential.ravel()
    flat_seed = seed.ravel()
    flat_step = step.ravel()
    path = np.empty(256, np.int32)
    path[0] = cell
    count = 1
    while flat_potential[cell] > 0:
        row, column = cell // columns, cell % columns
        found = -1
        for k in range(8):
            r, c = row + ROW_STEP[k], column + COLUMN_STEP[k]
            if r < 0 or r >= rows or c < 0 or c >= columns:
                continue
            other = r * columns + c
            if flat_step[other] == 0 or flat_seed[other] != flat_seed[cell]:
                continue
            cost = np.int64(flat_step[cell])
            cost = cost if k & 1 == 0 else diagonal(cost)
            if flat_potential[other] + cost == flat_potential[cell] and (found < 0 or other < found):
                found = other
        if found < 0:
            break
        cell = found
        if count == len(path):
            path = longer(path)
        path[count] = cell
        count += 1
    return path[:count].copy()
