"""Shortest paths on the cells of a costmap: A* on the 8-neighbour grid, and string pulling of its path."""

from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel
from .tracing._path_kernels import longer
from .tracing._skeleton_kernels import COLUMN_STEP, ROW_STEP

__all__ = ["grid_search", "straighten"]


@kernel(error_model="numpy", boundscheck=False)
def _move(a: int, b: int, crossing: bool) -> int:
    """Cost of a move between neighbours with steps ``a`` and ``b`` [half units]: their mean times the length."""
    both = int(np.int64(a) + np.int64(b))  # unsigned numbers would become floating ones
    return (both * 92682 + 32768) >> 16 if crossing else both


@kernel(error_model="numpy", boundscheck=False)
def grid_search(
    step: np.ndarray,
    source: int,
    goal: int,
    fastest: int,
    slowest: int,
    seed: np.ndarray,
    allowed: np.ndarray,
) -> tuple[np.ndarray, int, int]:
    """Cheapest path over the cells (flat), its cost [half units], -1 if there is none, and the number of cells expanded.

    A* whose heuristic is the path on an empty grid; the queue has bands of estimated cost, inside
    which cells may be improved more than once, so the result is exact. With a table
    ``allowed`` that is not empty only cells whose ``seed`` it allows are entered.

    Parameters
    ----------
    step
        Cost of a straight step onto each cell [units], (rows, columns) uint16; 0 where the robot does not fit.
    source
        Node, or flat cell, to start from.
    goal
        Node, or flat cell, to reach.
    fastest, slowest
        Smallest and largest step of the reachable cells [units].
    seed
        Flat cell of the node that each cell belongs to, (rows, columns).
    allowed
        By flat cell of a node, whether its region may be entered; empty for all.
    """
    rows, columns = step.shape
    flat = step.ravel()
    flat_seed = seed.ravel()
    narrowed = len(allowed) > 0
    goal_row, goal_column = goal // columns, goal % columns
    straight = 2 * fastest
    crossing = _move(fastest, fastest, True)
    # Cost plus one; 0 = not reached: pages that are never touched cost nothing.
    cost = np.zeros(rows * columns, np.int64)
    came = np.zeros(rows * columns, np.uint8)
    band = max(fastest, 1)
    bands = (2 * _move(slowest, slowest, True)) // band + 4
    head = np.full(bands, -1, np.int32)
    capacity = 4096
    item = np.empty(capacity, np.int32)
    following = np.empty(capacity, np.int32)
    value = np.empty(capacity, np.int64)
    free = -1
    used = 1
    item[0] = source
    following[0] = -1
    value[0] = 1
    waiting = 1
    cost[source] = 1
    far = abs(source // columns - goal_row), abs(source % columns - goal_column)
    now = (straight * abs(far[0] - far[1]) + crossing * min(far[0], far[1])) // band
    head[now % bands] = 0
    looked = 0
    while waiting > 0:
        slot = now % bands
        if head[slot] < 0:
            if cost[goal] > 0 and (cost[goal] - 1) // band <= now:
                break
            now += 1
            continue
        place = head[slot]
        cell = item[place]
        reached = value[place]
        head[slot] = following[place]
        following[place] = free
        free = place
        waiting -= 1
        if cost[cell] != reached:
            continue
        looked += 1
        row, column = cell // columns, cell % columns
        here = flat[cell]
        for k in range(8):
            r, c = row + ROW_STEP[k], column + COLUMN_STEP[k]
            if r < 0 or r >= rows or c < 0 or c >= columns:
                continue
            other = r * columns + c
            there = flat[other]
            if there == 0 or (narrowed and allowed[flat_seed[other]] == 0):
                continue
            total = reached + _move(here, there, k & 1 == 1)
            old = cost[other]
            if old != 0 and old <= total:
                continue
            down, across = abs(r - goal_row), abs(c - goal_column)
            left = straight * abs(down - across) + crossing * min(down, across)
            target = (total - 1 + left) // band
            if cost[goal] > 0 and total + left > cost[goal]:
                continue
            cost[other] = total
            came[other] = k
            # Rounding of diagonals may set the bound one unit too high: never into a band that is done.
            target = max(target, now)
            if free >= 0:
                entry = free
                free = following[entry]
            else:
                if used == capacity:
                    capacity *= 2
                    item = longer(item)
                    following = longer(following)
                    value = longer(value)
                entry = used
                used += 1
            item[entry] = other
            value[entry] = total
            following[entry] = head[target % bands]
            head[target % bands] = entry
            waiting += 1
    if cost[goal] == 0:
        return np.empty(0, np.int32), -1, looked
    count = 1
    cell = goal
    while cell != source:
        k = came[cell]
        cell = cell - ROW_STEP[k] * columns - COLUMN_STEP[k]
        count += 1
    path = np.empty(count, np.int32)
    cell = goal
    for position in range(count - 1, -1, -1):
        path[position] = cell
        k = came[cell]
        cell = cell - ROW_STEP[k] * columns - COLUMN_STEP[k]
    return path, cost[goal] - 1, looked


@kernel(error_model="numpy", boundscheck=False)
def _line_cost(step: np.ndarray, row0: int, column0: int, row1: int, column1: int) -> float:
    """Cost [half units] of the straight line between two cell centres, infinite where it is blocked.

    Split where the line leaves a cell; each piece costs the cell that it is in. A corner that is
    touched belongs to both cells beside it: they have to be free.
    """
    down, across = row1 - row0, column1 - column0
    length = math.hypot(down, across)
    row, column = row0, column0
    row_way = 1 if down > 0 else -1
    column_way = 1 if across > 0 else -1
    row_gap = 1.0 / abs(down) if down != 0 else np.inf
    column_gap = 1.0 / abs(across) if across != 0 else np.inf
    next_row, next_column = 0.5 * row_gap, 0.5 * column_gap
    done = 0.0
    cost = 0.0
    while True:
        here = step[row, column]
        if here == 0:
            return np.inf
        leave = min(next_row, next_column, 1.0)
        cost += (leave - done) * length * 2.0 * here
        done = leave
        if row == row1 and column == column1:
            return cost
        if abs(next_row - next_column) < 1e-12:
            blocked = step[row + row_way, column] == 0 or step[row, column + column_way] == 0
            # A path of cells passes between two blocked corners; a line may too when it is that step.
            if blocked and (abs(down) != 1 or abs(across) != 1):
                return np.inf
            row += row_way
            column += column_way
            next_row += row_gap
            next_column += column_gap
        elif next_row < next_column:
            row += row_way
            next_row += row_gap
        else:
            column += column_way
            next_column += column_gap


@kernel(error_model="numpy", boundscheck=False)
def straighten(step: np.ndarray, path: np.ndarray) -> tuple[np.ndarray, float]:
    """String pulling: positions of the path's cells that stay when straight lines replace what they do not cost more than.

    Returns them and the cost of the lines [half units]. Dynamic programming over the positions,
    looking back as long as the line is free, at most 200 cells.

    Parameters
    ----------
    step
        Cost of a straight step onto each cell [units], (rows, columns) uint16; 0 where the robot does not fit.
    path
        Cells (flat).
    """
    columns = step.shape[1]
    count = len(path)
    best = np.full(count, np.inf)
    came = np.zeros(count, np.int32)
    best[0] = 0.0
    # The cost of a path step in the same measure as lines: each half in its own cell.
    for k in range(1, count):
        blocked = 0
        row1, column1 = path[k] // columns, path[k] % columns
        for back in range(1, min(k, 200) + 1):
            j = k - back
            cost = _line_cost(step, path[j] // columns, path[j] % columns, row1, column1)
            if not cost < np.inf:
                blocked += 1
                if blocked > 8:
                    break
                continue
            blocked = 0
            if best[j] + cost < best[k] - 1e-9:
                best[k] = best[j] + cost
                came[k] = j
    kept = np.empty(count, np.int64)
    first = count - 1
    k = count - 1
    while k > 0:
        kept[first] = k
        first -= 1
        k = came[k]
    kept[first] = 0
    return kept[first:].copy(), best[count - 1]
