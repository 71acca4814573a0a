"""Potential and nearest node of every cell, worked out from all nodes at once.

A cell's value is the pair (potential, seed): the smallest cost of a way from a seed, in whole units,
and of equal ones the smallest seed. Every cell on a way costs its ``step``, times sqrt(2)
where it is entered diagonally. Such pairs have one solution, whatever the order of the work.

The work goes in bands of potential one cheapest step wide: no way leads from a cell to another of the
same band, so all cells of a band are final once the bands below are done (Denardo and Fox 1979).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ._skeleton_kernels import COLUMN_STEP, ROW_STEP

__all__ = ["UNREACHED", "descend", "diagonal", "spread"]

#: Potential of cells that no node is reached from.
UNREACHED = np.int32(2**31 - 1)


@njit(cache=True, error_model="numpy", boundscheck=False, inline="always")
def diagonal(step: int) -> int:
    """A diagonal step [units]: sqrt(2) of a straight one, rounded."""
    return (step * 92682 + 32768) >> 16


@njit(cache=True, error_model="numpy", boundscheck=False)
def spread(
    step: np.ndarray,
    potential: np.ndarray,
    seed: np.ndarray,
    cells: np.ndarray,
    slowest: int,
    fastest: int,
    fresh: bool,
) -> int:
    """Spread the values of ``cells`` (flat indices) as far as they improve others; returns cells settled.

    ``step`` (rows, columns) uint16; ``potential`` and ``seed`` int32 hold the values before and after;
    ``slowest`` and ``fastest`` bound the steps of reachable cells; ``fresh``: only ``cells`` have values.
    """
    rows, columns = step.shape
    flat_step = step.ravel()
    flat_potential = potential.ravel()
    flat_seed = seed.ravel()
    band = max(fastest, 1)
    bands = diagonal(slowest) // band + 3
    head = np.full(bands, -1, np.int32)
    capacity = max(4096, 2 * len(cells))
    item = np.empty(capacity, np.int32)
    following = np.empty(capacity, np.int32)
    free = -1
    used = 0
    waiting = 0

    # Seeds may have any potential: sorted, they enter as the bands reach them.
    order = np.argsort(flat_potential[cells], kind="mergesort")
    position = 0
    settled = 0
    now = 0
    while waiting > 0 or position < len(cells):
        if waiting == 0:
            now = flat_potential[cells[order[position]]] // band
        while position < len(cells) and flat_potential[cells[order[position]]] // band <= now:
            if used == capacity and free < 0:
                item = _longer(item)
                following = _longer(following)
                capacity = len(item)
            if free >= 0:
                place = free
                free = following[place]
            else:
                place = used
                used += 1
            item[place] = cells[order[position]]
            following[place] = head[now % bands]
            head[now % bands] = place
            waiting += 1
            position += 1
        slot = now % bands
        place = head[slot]
        head[slot] = -1
        while place >= 0:
            cell = item[place]
            rest = following[place]
            following[place] = free
            free = place
            place = rest
            waiting -= 1
            value = flat_potential[cell]
            if value // band != now:
                continue  # reached by a cheaper way in the meantime
            settled += 1
            origin = flat_seed[cell]
            row, column = cell // columns, cell % columns
            for k in range(8):
                r, c = row + ROW_STEP[k], column + COLUMN_STEP[k]
                if r < 0 or r >= rows or c < 0 or c >= columns:
                    continue
                other = r * columns + c
                cost = np.int64(flat_step[other])
                if cost == 0:
                    continue
                reached = value + (cost if k & 1 == 0 else diagonal(cost))
                old = flat_potential[other]
                if reached > old or (reached == old and origin >= flat_seed[other]):
                    continue
                flat_potential[other] = reached
                flat_seed[other] = origin
                if fresh and old // band == reached // band:
                    continue  # it waits in that band already
                target = (reached // band) % bands
                if used == capacity and free < 0:
                    item = _longer(item)
                    following = _longer(following)
                    capacity = len(item)
                if free >= 0:
                    entry = free
                    free = following[entry]
                else:
                    entry = used
                    used += 1
                item[entry] = other
                following[entry] = head[target]
                head[target] = entry
                waiting += 1
        now += 1
    return settled


@njit(cache=True, error_model="numpy", boundscheck=False)
def _longer(array: np.ndarray) -> np.ndarray:
    larger = np.empty(2 * len(array), array.dtype)
    larger[: len(array)] = array
    return larger


@njit(cache=True, error_model="numpy", boundscheck=False)
def descend(step: np.ndarray, potential: np.ndarray, seed: np.ndarray, cell: int) -> np.ndarray:
    """Cells (flat) from ``cell`` to its node, each the cheapest way's next; ties by the smallest index."""
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
            path = _longer(path)
        path[count] = cell
        count += 1
    return path[:count].copy()
