"""From skeleton cells to lines and their graph; lines that no edit has touched are kept."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ._skeleton_kernels import ADJACENT, COLUMN_STEP, ROW_STEP

__all__ = ["compact_lines", "find_lines", "find_specials", "forget_lines", "join_lines", "measure_paths"]

_ADJACENT = ADJACENT
_DEAD = np.int32(-2)
_BITS = np.array([bin(mask).count("1") for mask in range(256)], np.uint8)


@njit(cache=True, error_model="numpy", boundscheck=False)
def _links(mark: np.ndarray, row: int, column: int) -> int:
    """Mask of the neighbours that a skeleton cell is linked to."""
    rows, columns = mark.shape
    mask = 0
    for k in range(8):
        r, c = row + ROW_STEP[k], column + COLUMN_STEP[k]
        if 0 <= r < rows and 0 <= c < columns and mark[r, c] & 1:
            mask |= 1 << k
    return _ADJACENT[mask]


@njit(cache=True, error_model="numpy", boundscheck=False)
def _cost(distance: float, speeds: np.ndarray) -> float:
    """Eq. (4.1) [s/m]; ``speeds`` = (radius, 1 / v_min, 1 / v_max)."""
    share = min(max((distance / speeds[0] - 1.0) / 2.0, 0.0), 1.0)
    return speeds[1] + share * (speeds[2] - speeds[1])


@njit(cache=True, error_model="numpy", boundscheck=False)
def _clusters(
    distance: np.ndarray, place: np.ndarray, special: np.ndarray, masks: np.ndarray, resolution_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Junction cells that are one decision: node (position in ``special``) and next cell towards it.

    From the cell with the largest key on, a node takes the junction cells that are linked to
    it through others, as far as its own clearance (at least the cells that touch it).
    """
    columns = distance.shape[1]
    flat = distance.ravel()
    flat_place = place.ravel()
    count = len(special)
    owner = np.empty(count, np.int32)
    parent = np.full(count, -1, np.int32)
    keys = np.empty(count, np.float32)
    joined = np.empty(count, np.int32)
    queue = np.empty(count, np.int32)
    several = 0
    for k in range(count):
        owner[k] = k
        if _BITS[masks[k]] < 3:
            continue
        for j in range(8):
            if masks[k] >> j & 1:
                other = -1 - flat_place[special[k] + ROW_STEP[j] * columns + COLUMN_STEP[j]]
                if other >= 0 and _BITS[masks[other]] >= 3:
                    owner[k] = -1  # it may belong to another
        if owner[k] < 0:
            joined[several] = k
            keys[several] = -flat[special[k]]
            several += 1
    # Stable: of equal distances the first cell leads.
    order = np.argsort(keys[:several], kind="mergesort")
    for position in range(several):
        leader = joined[order[position]]
        if owner[leader] >= 0:
            continue
        owner[leader] = leader
        row, column = special[leader] // columns, special[leader] % columns
        reach = max(float(flat[special[leader]]) / resolution_m, 1.5)
        queue[0] = leader
        head, tail = 0, 1
        while head < tail:
            here = queue[head]
            head += 1
            r0, c0 = special[here] // columns, special[here] % columns
            for k in range(8):
                if not masks[here] >> k & 1:
                    continue
                r, c = r0 + ROW_STEP[k], c0 + COLUMN_STEP[k]
                cell = r * columns + c
                other = -1 - flat_place[cell]
                if other < 0:
                    continue
                if owner[other] >= 0 or _BITS[masks[other]] < 3:
                    continue
                if (r - row) ** 2 + (c - column) ** 2 > reach * reach:
                    continue
                owner[other] = leader
                parent[other] = here
                queue[tail] = other
                tail += 1
    return owner, parent


@njit(cache=True, error_model="numpy", boundscheck=False)
def _measure(
    path: np.ndarray,
    begin: int,
    end: int,
    distance: np.ndarray,
    resolution_m: float,
    speeds: np.ndarray,
) -> tuple[float, float, float]:
    """Length [m], cost [s] and clearance [m] of path cells ``begin..end - 1``."""
    columns = distance.shape[1]
    flat = distance.ravel()
    straight, diagonal = 0, 0
    cost = 0.0
    before = _cost(flat[path[begin]], speeds)
    clearance = float(flat[path[begin]])
    for k in range(begin + 1, end):
        a, b = path[k - 1], path[k]
        here = _cost(flat[b], speeds)
        clearance = min(clearance, float(flat[b]))
        if a // columns != b // columns and a % columns != b % columns:
            diagonal += 1
            cost += math.sqrt(2.0) * (before + here)
        else:
            straight += 1
            cost += before + here
        before = here
    return (straight + math.sqrt(2.0) * diagonal) * resolution_m, 0.5 * cost * resolution_m, clearance


@njit(cache=True, error_model="numpy", boundscheck=False)
def forget_lines(
    mark: np.ndarray, place: np.ndarray, table: np.ndarray, path: np.ndarray, touched: np.ndarray
) -> np.ndarray:
    """Forget lines that touched cells (flat) are on or at the end of; returns cells that may be in a ring.

    ``place`` (rows, columns) int32: 0, the number of a cell's line + 1, or -1 and less where lines meet or end.
    """
    rows, columns = place.shape
    flat = place.ravel()
    flat_mark = mark.ravel()
    found = np.empty(len(touched) + 1024, np.int32)
    count = 0
    for cell in touched:
        if count == len(found):
            found = _longer(found)
        if flat_mark[cell] & 1:
            found[count] = cell
            count += 1
        value = flat[cell]
        if value == 0:
            continue
        row = cell // columns
        column = cell - row * columns
        # A cell where lines meet is part of all of them.
        for k in range(9):
            other = cell
            if k < 8:
                if value > 0:
                    continue
                r, c = row + ROW_STEP[k], column + COLUMN_STEP[k]
                if r < 0 or r >= rows or c < 0 or c >= columns:
                    continue
                other = r * columns + c
            line = flat[other] - 1
            if line < 0:
                continue
            for position in range(table[line, 2], table[line, 3]):
                part = path[position]
                if flat[part] == line + 1:
                    flat[part] = 0
                    if count == len(found):
                        found = _longer(found)
                    found[count] = part
                    count += 1
            table[line, 0] = _DEAD
        if value < 0:
            flat[cell] = 0
    return found[:count]


@njit(cache=True, error_model="numpy", boundscheck=False)
def find_specials(
    mark: np.ndarray, place: np.ndarray, special: np.ndarray, masks: np.ndarray, touched: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Cells where lines meet or end, ascending, and their masks of linked neighbours.

    ``special`` and ``masks`` are those of before; only ``touched`` cells (some twice) are looked at, all of
    which :func:`forget_lines` has seen.
    """
    columns = place.shape[1]
    flat = place.ravel()
    flat_mark = mark.ravel()
    new = np.empty(1024, np.int32)
    count = 0
    for cell in touched:
        if flat_mark[cell] & 1 and flat[cell] == 0:
            row = cell // columns
            if _BITS[_links(mark, row, cell - row * columns)] != 2:
                if count == len(new):
                    new = _longer(new)
                new[count] = cell
                count += 1
                flat[cell] = -1
    new = np.sort(new[:count])
    for cell in new:
        flat[cell] = 0
    out = np.empty(len(special) + count, np.int32)
    out_masks = np.empty(len(special) + count, np.uint8)
    total = 0
    j = 0
    for i in range(len(special) + 1):
        while j < count and (i == len(special) or new[j] < special[i]):
            out[total] = new[j]
            row = new[j] // columns
            out_masks[total] = _links(mark, row, new[j] - row * columns)
            total += 1
            j += 1
        if i < len(special) and flat[special[i]] < 0:
            out[total] = special[i]
            out_masks[total] = masks[i]
            total += 1
    for k in range(total):
        flat[out[k]] = -1 - k
    return out[:total].copy(), out_masks[:total].copy()


@njit(cache=True, error_model="numpy", boundscheck=False)
def _walk(
    mark: np.ndarray, place: np.ndarray, before: int, cell: int, line: int, path: np.ndarray, size: int
) -> tuple[np.ndarray, int]:
    """Cells of a line from ``before``, where lines meet, through ``cell`` to where they meet again."""
    columns = mark.shape[1]
    flat = place.ravel()
    path[size] = before
    size += 1
    while flat[cell] >= 0:
        if size + 2 >= len(path):
            path = _longer(path)
        path[size] = cell
        size += 1
        flat[cell] = line + 1
        row = cell // columns
        mask = _links(mark, row, cell - row * columns)
        following = -1
        for j in range(8):
            if mask >> j & 1:
                other = cell + ROW_STEP[j] * columns + COLUMN_STEP[j]
                if other != before:
                    following = other
        before = cell
        cell = following
    path[size] = cell
    return path, size + 1


@njit(cache=True, error_model="numpy", boundscheck=False)
def _walk_ring(
    mark: np.ndarray,
    place: np.ndarray,
    distance: np.ndarray,
    cell: int,
    line: int,
    path: np.ndarray,
    size: int,
) -> tuple[np.ndarray, int]:
    """Cells of a ring, from the widest round to it again."""
    columns = mark.shape[1]
    flat = place.ravel()
    flat_distance = distance.ravel()
    widest = cell
    begin = size
    for turn in range(2):
        start = widest
        before, cell = -1, start
        size = begin
        while True:
            if size + 2 >= len(path):
                path = _longer(path)
            path[size] = cell
            size += 1
            flat[cell] = line + 1
            if flat_distance[cell] > flat_distance[widest] or (
                flat_distance[cell] == flat_distance[widest] and cell < widest
            ):
                widest = cell
            row = cell // columns
            mask = _links(mark, row, cell - row * columns)
            following = -1
            for j in range(8):
                if mask >> j & 1:
                    other = cell + ROW_STEP[j] * columns + COLUMN_STEP[j]
                    if other != before and (before != -1 or following == -1):
                        following = other
            before = cell
            cell = following
            if cell == start:
                break
        if turn == 1:
            path[size] = start
            size += 1
    return path, size


@njit(cache=True, error_model="numpy", boundscheck=False)
def find_lines(
    distance: np.ndarray,
    mark: np.ndarray,
    place: np.ndarray,
    special: np.ndarray,
    masks: np.ndarray,
    maybe: np.ndarray,
    table: np.ndarray,
    measured: np.ndarray,
    path: np.ndarray,
    used: int,
    size: int,
    resolution_m: float,
    speeds: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int, int]:
    """Walk the lines that are not known; the others are left as they are.

    ``table`` (lines, 4): first and last cell, where in ``path`` it begins and stops; the first
    is -1 for a ring, less for one that is gone. ``measured`` (lines, 3): length [m], cost [s], clearance [m].
    ``maybe`` (flat) are cells that may be in a new ring. Returns both, ``path``, and how much of them is used.
    """
    columns = mark.shape[1]
    flat = place.ravel()
    flat_mark = mark.ravel()
    for k in range(len(special) + len(maybe)):
        for j in range(8 if k < len(special) else 1):
            if k < len(special):
                if not masks[k] >> j & 1:
                    continue
                cell = special[k] + ROW_STEP[j] * columns + COLUMN_STEP[j]
            else:
                cell = maybe[k - len(special)]
            if flat[cell] != 0 or not flat_mark[cell] & 1:
                continue
            if used == len(table):
                larger_table = np.empty((2 * used, 4), np.int32)
                larger_table[:used] = table
                table = larger_table
                larger_measured = np.empty((2 * used, 3))
                larger_measured[:used] = measured
                measured = larger_measured
            if size + 4 >= len(path):
                path = _longer(path)
            table[used, 2] = size
            if k < len(special):
                path, size = _walk(mark, place, special[k], cell, used, path, size)
                table[used, 0], table[used, 1] = special[k], path[size - 1]
            else:
                path, size = _walk_ring(mark, place, distance, cell, used, path, size)
                table[used, 0], table[used, 1] = -1, path[size - 1]
            table[used, 3] = size
            length, cost, clearance = _measure(path, table[used, 2], size, distance, resolution_m, speeds)
            measured[used, 0], measured[used, 1], measured[used, 2] = length, cost, clearance
            used += 1
    return table, measured, path, used, size


@njit(cache=True, error_model="numpy", boundscheck=False)
def compact_lines(
    place: np.ndarray, table: np.ndarray, measured: np.ndarray, path: np.ndarray, used: int
) -> tuple[int, int]:
    """Close the gaps that forgotten lines have left; returns how many lines and path cells there are."""
    flat = place.ravel()
    lines, size = 0, 0
    for line in range(used):
        if table[line, 0] == _DEAD:
            continue
        begin, stop = table[line, 2], table[line, 3]
        table[lines, 0], table[lines, 1], table[lines, 2] = table[line, 0], table[line, 1], size
        for position in range(begin, stop):
            cell = path[position]
            path[size] = cell
            size += 1
            if flat[cell] > 0:
                flat[cell] = lines + 1
        table[lines, 3] = size
        for k in range(3):
            measured[lines, k] = measured[line, k]
        lines += 1
    return lines, size


@njit(cache=True, error_model="numpy", boundscheck=False)
def join_lines(
    distance: np.ndarray,
    place: np.ndarray,
    special: np.ndarray,
    masks: np.ndarray,
    table: np.ndarray,
    measured: np.ndarray,
    path: np.ndarray,
    used: int,
    size: int,
    resolution_m: float,
    speeds: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Graph of all lines: junction cells that touch become one node, lines are led on to it.

    Returns cells of the nodes (n,), ends of the edges (m, 2), their length, cost and
    clearance (m, 3), and their path cells from node to node in CSR form. The order does not
    depend on the numbers of the lines.
    """
    columns = place.shape[1]
    flat = place.ravel()
    count = len(special)
    owner, parent = _clusters(distance, place, special, masks, resolution_m)
    room = used + 4 * count + 1
    ends = np.empty((room, 2), np.int32)
    measures = np.empty((room, 3))
    start = np.empty(room + 1, np.int32)
    out = np.empty(size + 1024, np.int32)
    start[0] = 0
    edges = 0
    total = 0
    for first in range(count):
        for k in range(8):
            if not masks[first] >> k & 1:
                continue
            cell = special[first] + ROW_STEP[k] * columns + COLUMN_STEP[k]
            line = flat[cell] - 1
            if line >= 0:
                if table[line, 0] != special[first] or path[table[line, 2] + 1] != cell:
                    continue  # led on from its other end
                last = -1 - flat[table[line, 1]]
                inner = table[line, 3] - table[line, 2] - 2
            else:
                last = -1 - flat[cell]
                if last < first or parent[last] == first or parent[first] == last:
                    continue
                inner = 0
            begin = total
            here = first
            while here != -1:
                if total + inner + 4 >= len(out):
                    out = _longer(out)
                out[total] = special[here]
                total += 1
                here = parent[here]
            _reverse(out, begin, total)
            middle = total - 1
            for position in range(inner):
                out[total] = path[table[line, 2] + 1 + position]
                total += 1
            tail = total
            here = last
            while here != -1:
                if total + 4 >= len(out):
                    out = _longer(out)
                out[total] = special[here]
                total += 1
                here = parent[here]
            if line >= 0:
                length, cost, clearance = measured[line, 0], measured[line, 1], measured[line, 2]
            else:
                length, cost, clearance = _measure(out, middle, tail + 1, distance, resolution_m, speeds)
            for part in range(2):
                low, high = (begin, middle + 1) if part == 0 else (tail, total)
                if high - low > 1:
                    more, dearer, narrower = _measure(out, low, high, distance, resolution_m, speeds)
                    length += more
                    cost += dearer
                    clearance = min(clearance, narrower)
            measures[edges, 0], measures[edges, 1], measures[edges, 2] = length, cost, clearance
            ends[edges, 0], ends[edges, 1] = owner[first], owner[last]
            edges += 1
            start[edges] = total

    rings = np.empty(1024, np.int32)
    ring_count = 0
    for line in range(used):
        if table[line, 0] == -1:
            if ring_count == len(rings):
                rings = _longer(rings)
            rings[ring_count] = table[line, 1]
            ring_count += 1
    rings = np.sort(rings[:ring_count])
    # Nodes in the order of their cells; ``number`` says which one a leader has become.
    nodes = np.empty(count + ring_count, np.int32)
    number = np.empty(count, np.int32)
    n = 0
    k = 0
    for position in range(count + 1):
        if position < count and owner[position] != position:
            continue
        while k < ring_count and (position == count or rings[k] < special[position]):
            nodes[n] = rings[k]
            line = flat[rings[k]] - 1
            while total + table[line, 3] - table[line, 2] >= len(out):
                out = _longer(out)
            for place_in in range(table[line, 2], table[line, 3]):
                out[total] = path[place_in]
                total += 1
            for j in range(3):
                measures[edges, j] = measured[line, j]
            ends[edges, 0] = ends[edges, 1] = -1 - n
            edges += 1
            start[edges] = total
            n += 1
            k += 1
        if position < count:
            nodes[n] = special[position]
            number[position] = n
            n += 1
    for edge in range(edges):
        for side in range(2):
            value = ends[edge, side]
            ends[edge, side] = number[value] if value >= 0 else -1 - value
    return (
        nodes[:n].copy(),
        ends[:edges].copy(),
        measures[:edges].copy(),
        start[: edges + 1].copy(),
        out[:total],
    )


@njit(cache=True, error_model="numpy", boundscheck=False)
def measure_paths(
    path_start: np.ndarray, path: np.ndarray, distance: np.ndarray, resolution_m: float, speeds: np.ndarray
) -> np.ndarray:
    """Length [m], cost [s] and clearance [m] of each path, (m, 3)."""
    measures = np.empty((len(path_start) - 1, 3))
    for k in range(len(path_start) - 1):
        length, cost, clearance = _measure(
            path, path_start[k], path_start[k + 1], distance, resolution_m, speeds
        )
        measures[k, 0] = length
        measures[k, 1] = cost
        measures[k, 2] = clearance
    return measures


@njit(cache=True, error_model="numpy", boundscheck=False)
def _longer(path: np.ndarray) -> np.ndarray:
    larger = np.empty(2 * len(path), path.dtype)
    larger[: len(path)] = path
    return larger


@njit(cache=True, error_model="numpy", boundscheck=False)
def _reverse(path: np.ndarray, begin: int, end: int) -> None:
    low, high = begin, end - 1
    while low < high:
        path[low], path[high] = path[high], path[low]
        low += 1
        high -= 1
