"""Potentials and nearest nodes by passes over rows: most paths from a node are straight enough for two.

The pair (potential, seed) of ``_region_kernels`` is one whole number here, potential * 2^31 + seed, so that
one minimum compares both and the loop over a row becomes vector code. A pass downwards and one
upwards follow every path that does not turn back twice; a third looks for cells that are not
final yet. From those ``_region_kernels.spread`` goes on.

Where to work is said by tiles of the map: an edit takes back regions, which fill little of the box round them.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel
from ._region_kernels import UNREACHED
from .tracing._path_kernels import longer, longer_rows

__all__ = ["TILE", "sweep", "touch"]

#: Edge of the tiles by which places of the map are noted where potentials have to be found [cells].
TILE = 16

_SHIFT = 31
_SEED = np.int64(2**31 - 1)
#: Pair of a cell that no node is reached from.
_FAR = (np.int64(UNREACHED) << _SHIFT) | _SEED


@kernel(error_model="numpy", boundscheck=False)
def touch(tiles: np.ndarray, cells: np.ndarray, columns: int, around: int) -> None:
    """Note the tiles of cells (flat), and those up to ``around`` tiles away.

    Parameters
    ----------
    tiles
        One uint8 per tile of ``TILE`` x ``TILE`` cells, 1 where noted.
    cells
        Flat indices.
    columns
        Number of columns of the map.
    around
        How many tiles around are noted too.
    """
    high, wide = tiles.shape
    for cell in cells:
        row = cell // columns
        r, c = row // TILE, (cell - row * columns) // TILE
        if around == 0:
            tiles[r, c] = 1
        else:
            tiles[
                max(r - around, 0) : min(r + around + 1, high), max(c - around, 0) : min(c + around + 1, wide)
            ] = 1


@kernel(error_model="numpy", boundscheck=False)
def _noted(tiles: np.ndarray) -> np.ndarray:
    """Whether each row of tiles has noted ones; 0 beside the first and the last."""
    found = np.zeros(tiles.shape[0] + 2, np.uint8)
    for row in range(tiles.shape[0]):
        line = tiles[row]
        here = np.uint8(0)
        for column in range(len(line)):
            here |= line[column]
        found[row + 1] = here
    return found


@kernel(error_model="numpy", boundscheck=False)
def _spans(tiles: np.ndarray, row: int, ring: int, columns: int, spans: np.ndarray) -> int:
    """Columns (first, stop) of a row of cells that are in noted tiles, or on the ring round them; how many."""
    high, wide = tiles.shape
    own = row // TILE
    beside = own
    if ring and row % TILE == 0 and own > 0:
        beside = own - 1
    elif ring and row % TILE == TILE - 1 and own + 1 < high:
        beside = own + 1
    here, other = tiles[own], tiles[beside]
    count = 0
    before = np.uint8(0)
    for tile in range(wide):
        noted = here[tile] | other[tile]
        if noted != before:
            if noted:
                spans[count, 0] = max(tile * TILE - ring, 0)
            else:
                spans[count, 1] = min(tile * TILE + ring, columns)
                count += 1
            before = noted
    if before:
        spans[count, 1] = columns
        count += 1
    return count


@kernel(error_model="numpy", boundscheck=False)
def _runs(
    step: np.ndarray, tiles: np.ndarray, noted: np.ndarray, ring: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows with cells to work on, where the runs of each begin, and the runs: (first, stop) columns.

    Runs are of reachable cells in noted tiles, with ``ring`` = 1 also on the ring of cells round them.
    """
    rows, columns = step.shape
    used = np.empty(rows, np.int32)
    start = np.zeros(rows + 1, np.int32)
    runs = np.empty((max(columns, 1024), 2), np.int32)
    change = np.empty(columns + 2, np.int32)
    spans = np.empty((tiles.shape[1] + 1, 2), np.int32)
    count, lines = 0, 0
    for own in range(tiles.shape[0]):
        above, here, below = noted[own], noted[own + 1], noted[own + 2]
        if not (here or (ring and (above or below))):
            continue
        known = 0
        for row in range(own * TILE, min((own + 1) * TILE, rows)):
            # Rows inside a row of tiles have the same spans.
            if row % TILE < 2 or row % TILE == TILE - 1:
                known = _spans(tiles, row, ring, columns, spans)
            before_row = count
            for span in range(known):
                first, stop = spans[span, 0], spans[span, 1]
                line = step[row, first:stop]
                # No branch: where runs begin and end cannot be guessed.
                changes = np.uint32(0)
                before = False
                for k in range(len(line)):
                    reachable = line[k] != 0
                    change[changes] = k
                    changes += np.uint32(reachable != before)
                    before = reachable
                change[changes] = len(line)
                if count + len(line) > len(runs):
                    runs = longer_rows(runs)
                for k in range(0, np.int64(changes), 2):
                    runs[count, 0] = first + change[k]
                    runs[count, 1] = first + change[k + 1]
                    count += 1
            if count > before_row:
                used[lines] = row
                lines += 1
                start[lines] = count
    return used[:lines], start, runs


@kernel(error_model="numpy", boundscheck=False)
def _load(potential: np.ndarray, seed: np.ndarray, row: int, first: int, stop: int, pair: np.ndarray) -> None:
    """Pairs of columns ``first - 1`` to ``stop``, those beside the map too."""
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


@kernel(error_model="numpy", boundscheck=False)
def _enter(line: np.ndarray, here: np.ndarray, beside: np.ndarray, cost: np.ndarray) -> None:
    """Ways onto a run of cells from the row beside it; fills ``cost`` of straight steps."""
    own, left, middle, right = here[1:], beside, beside[1:], beside[2:]
    for k in range(len(line)):
        step = np.int64(line[k])
        straight = step << _SHIFT
        crooked = ((step * 92682 + 32768) >> 16) << _SHIFT
        cost[k] = straight
        best = min(own[k], middle[k] + straight)
        own[k] = min(best, min(left[k], right[k]) + crooked)


@kernel(error_model="numpy", boundscheck=False)
def _along(here: np.ndarray, cost: np.ndarray, potential: np.ndarray, seed: np.ndarray) -> None:
    """Ways along a run of cells, to the right and to the left; the result goes back to the map."""
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
    for k in range(count):
        potential[k] = np.int32(own[k] >> _SHIFT)
        # Where there is no node the seed's bits are all ones: -1 once the sign is put back.
        origin = own[k] & _SEED
        seed[k] = np.int32(origin) if origin != _SEED else np.int32(-1)


@kernel(error_model="numpy", boundscheck=False)
def _better(
    line: np.ndarray, here: np.ndarray, below: np.ndarray, above: np.ndarray, best: np.ndarray
) -> int:
    """Best paths onto a run of cells from all eight sides; returns on how many cells that is news."""
    own, right = here[1:], here[2:]
    below1, below2, above1, above2 = below[1:], below[2:], above[1:], above[2:]
    news = 0
    for k in range(len(line)):
        step = np.int64(line[k])
        straight = step << _SHIFT
        crooked = ((step * 92682 + 32768) >> 16) << _SHIFT
        side = min(min(below1[k], above1[k]), min(here[k], right[k]))
        corner = min(min(below[k], below2[k]), min(above[k], above2[k]))
        value = min(side + straight, corner + crooked)
        best[k] = value
        news += value < own[k]
    return news


@kernel(error_model="numpy", boundscheck=False)
def sweep(step: np.ndarray, potential: np.ndarray, seed: np.ndarray, tiles: np.ndarray) -> np.ndarray:
    """Improve the values in noted tiles from each other and from the cells round them.

    ``step`` (rows, columns) uint16; ``potential`` and ``seed`` int32, as for ``spread``; ``tiles`` uint8,
    one per ``TILE`` x ``TILE`` cells, 1 where noted, all 0 afterwards. Returns the cells (flat) of the tiles
    and of the ring round them whose paths onward have to be looked at still.

    Parameters
    ----------
    step
        Cost of a straight step onto each cell [units], (rows, columns) uint16; 0 where the robot does not fit.
    potential
        Cost from each cell to its node [units], (rows, columns) int32.
    seed
        Flat cell of the node that each cell belongs to, (rows, columns) int32.
    tiles
        One uint8 per tile of ``TILE`` x ``TILE`` cells, 1 where noted.
    """
    columns = step.shape[1]
    here = np.empty(columns + 2, np.int64)
    below = np.empty(columns + 2, np.int64)
    above = np.empty(columns + 2, np.int64)
    best = np.empty(columns + 2, np.int64)
    noted = _noted(tiles)
    used, start, runs = _runs(step, tiles, noted, 0)
    for sense in (1, -1):
        for line in range(len(used)):
            number = line if sense == 1 else len(used) - 1 - line
            row = used[number]
            for run in range(start[number], start[number + 1]):
                first, stop = runs[run, 0], runs[run, 1]
                _load(potential, seed, row - sense, first, stop, below)
                _load(potential, seed, row, first, stop, here)
                _enter(step[row, first:stop], here, below, best)
                _along(here, best, potential[row, first:stop], seed[row, first:stop])
    # The ring is looked at as well: the tiles' new values may lead there.
    used, start, runs = _runs(step, tiles, noted, 1)
    tiles[:] = 0
    found = np.empty(1024, np.int32)
    count = 0
    for number in range(len(used)):
        row = used[number]
        for run in range(start[number], start[number + 1]):
            first, stop = runs[run, 0], runs[run, 1]
            _load(potential, seed, row - 1, first, stop, below)
            _load(potential, seed, row, first, stop, here)
            _load(potential, seed, row + 1, first, stop, above)
            better = _better(step[row, first:stop], here, below, above, best)
            if better == 0:
                continue
            while count + better > len(found):
                found = longer(found)
            for k in range(stop - first):
                if best[k] < here[k + 1]:
                    potential[row, first + k] = np.int32(best[k] >> _SHIFT)
                    seed[row, first + k] = np.int32(best[k] & _SEED)
                    found[count] = row * columns + first + k
                    count += 1
    return found[:count].copy()
