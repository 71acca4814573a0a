"""Potentials and nearest nodes by passes over rows (fast sweeping): for most paths two passes are enough.

A cell's value is the pair (potential, seed): the minimum cost of a path from a seed, in integer units, and among equal
costs the smallest seed. Every cell on a path costs its ``step``, times sqrt(2) where it is entered diagonally. The pairs
are unique, independent of the order of the computation. Each pair is one integer, potential * 2^31 + seed, so that
one minimum compares both and the loop over a row can be vectorized. One downward and one upward
pass cover every path that does not reverse its vertical direction twice.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel

#: Potential of cells that are not reachable from any node.
UNREACHED = np.int32(2**31 - 1)
_SHIFT = 31
_SEED = np.int64(2**31 - 1)
#: Pair of a cell that is not reachable from any node.
_FAR = (np.int64(UNREACHED) << _SHIFT) | _SEED


@kernel(error_model="numpy")
def _load(potential: np.ndarray, seed: np.ndarray, row: int, first: int, stop: int, pair: np.ndarray) -> None:
    """Pairs of columns ``first - 1`` to ``stop``, including those outside the map."""
    rows, columns = potential.shape
    if row < 0 or row >= rows:
        pair[: stop - first + 2] = _FAR
        return
    low, high = max(first - 1, 0), min(stop + 1, columns)
    here, origin = potential[row, low:high], seed[row, low:high]
    out = pair[low - first + 1 :]
    for k in range(high - low):
        out[k] = (np.int64(here[k]) << _SHIFT) | (np.int64(origin[k]) & _SEED)
    if first == 0:
        pair[0] = _FAR
    if stop == columns:
        pair[stop - first + 1] = _FAR


@kernel(error_model="numpy")
def _enter(line: np.ndarray, here: np.ndarray, beside: np.ndarray, cost: np.ndarray) -> None:
    """Paths onto a run of cells from the neighbouring row; fills ``cost`` of straight steps."""
    own, left, middle, right = here[1:], beside, beside[1:], beside[2:]
    for k in range(len(line)):
        step = np.int64(line[k])
        straight = step << _SHIFT
        crooked = ((step * 92682 + 32768) >> 16) << _SHIFT
        cost[k] = straight
        best = min(own[k], middle[k] + straight)
        own[k] = min(best, min(left[k], right[k]) + crooked)


@kernel(error_model="numpy")
def _along(here: np.ndarray, cost: np.ndarray, potential: np.ndarray, seed: np.ndarray) -> int:
    """Paths along a run of cells, to the right and to the left; writes the result to the map. Returns the improved cells."""
    count = len(potential)
    value = here[0]
    own = here[1:]
    for k in range(count):
        value = min(own[k], value + cost[k])
        own[k] = value
    value = own[count]
    for k in range(count):
        place = np.uint32(count - 1 - k)
        value = min(own[place], value + cost[place])
        own[place] = value
    improved = 0
    for k in range(count):
        # Without a node the seed's bits are all ones: -1 once the sign is restored.
        origin = own[k] & _SEED
        nearest = np.int32(origin) if origin != _SEED else np.int32(-1)
        reached = np.int32(own[k] >> _SHIFT)
        improved += (reached != potential[k]) | (nearest != seed[k])
        potential[k], seed[k] = reached, nearest
    return improved


@kernel(error_model="numpy")
def sweep(
    step: np.ndarray, start: np.ndarray, runs: np.ndarray, potential: np.ndarray, seed: np.ndarray
) -> None:
    """Propagate all values until convergence.

    Parameters
    ----------
    step
        Cost of a straight step onto each cell [units], (rows, columns) uint16; 0 where the robot does not fit.
    start, runs
        Runs of cells where it fits: start index of each row's, (rows + 1,), and first column and end of each, (runs, 2).
    potential
        Cost from each cell to its node [units], (rows, columns) int32.
    seed
        Flat cell of the node that each cell belongs to, (rows, columns) int32.
    """
    rows, columns = step.shape
    here = np.empty(columns + 2, np.int64)
    beside = np.empty(columns + 2, np.int64)
    cost = np.empty(columns + 2, np.int64)
    improved = 1
    while improved > 0:
        improved = 0
        for sense in (1, -1):
            for number in range(rows):
                row = number if sense == 1 else rows - 1 - number
                for run in range(start[row], start[row + 1]):
                    first, stop = runs[run, 0], runs[run, 1]
                    _load(potential, seed, row - sense, first, stop, beside)
                    _load(potential, seed, row, first, stop, here)
                    _enter(step[row, first:stop], here, beside, cost)
                    improved += _along(here, cost, potential[row, first:stop], seed[row, first:stop])
