"""From skeleton cells to a graph: trace the lines, remove stubs, merge what is no decision."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ._skeleton_kernels import ADJACENT, COLUMN_STEP, ROW_STEP

__all__ = ["keep_edges", "link_masks", "prune", "trace"]

_ADJACENT = ADJACENT
_SEEN = np.uint8(4)
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
def link_masks(mark: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Masks of linked neighbours of skeleton cells (flat indices)."""
    columns = mark.shape[1]
    masks = np.zeros(len(cells), np.uint8)
    for k in range(len(cells)):
        masks[k] = _links(mark, cells[k] // columns, cells[k] % columns)
    return masks


@njit(cache=True, error_model="numpy", boundscheck=False)
def _find(cells: np.ndarray, cell: int) -> int:
    low, high = 0, len(cells)
    while low < high:
        middle = (low + high) >> 1
        if cells[middle] < cell:
            low = middle + 1
        else:
            high = middle
    return low


@njit(cache=True, error_model="numpy", boundscheck=False)
def _cost(distance: float, speeds: np.ndarray) -> float:
    """Eq. (4.1) [s/m]; ``speeds`` = (radius, 1 / v_min, 1 / v_max)."""
    share = min(max((distance / speeds[0] - 1.0) / 2.0, 0.0), 1.0)
    return speeds[1] + share * (speeds[2] - speeds[1])


@njit(cache=True, error_model="numpy", boundscheck=False)
def _clusters(
    distance: np.ndarray, special: np.ndarray, masks: np.ndarray, resolution_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Junction cells that are one decision: node (position in ``special``) and next cell towards it.

    From the cell with the largest key on, a node takes the junction cells that are linked to
    it through others, as far as its own clearance (at least the cells that touch it).
    """
    columns = distance.shape[1]
    flat = distance.ravel()
    count = len(special)
    owner = np.full(count, -1, np.int32)
    parent = np.full(count, -1, np.int32)
    keys = np.empty(count, np.float32)
    for k in range(count):
        keys[k] = -flat[special[k]]
    # Stable: of equal distances the first cell leads.
    order = np.argsort(keys, kind="mergesort")
    queue = np.empty(count, np.int32)
    for position in range(count):
        leader = order[position]
        if owner[leader] >= 0:
            continue
        owner[leader] = leader
        if _BITS[masks[leader]] < 3:
            continue
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
                other = _find(special, cell)
                if other == count or special[other] != cell:
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
def trace(
    distance: np.ndarray,
    mark: np.ndarray,
    cells: np.ndarray,
    masks: np.ndarray,
    resolution_m: float,
    speeds: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Graph of all lines of a skeleton.

    ``distance`` (rows, columns) float32 [m]; ``mark`` uint8, bit 0 = skeleton (given back as it was);
    ``cells`` its cells (flat, ascending); ``masks`` from :func:`link_masks`.

    Returns cells of the nodes (n,), ends of the edges (m, 2), their length, cost and
    clearance (m, 3), and their path cells from node to node in CSR form.
    """
    columns = distance.shape[1]
    flat_mark = mark.ravel()
    flat_distance = distance.ravel()
    count = 0
    links = 0
    for k in range(len(cells)):
        degree = _BITS[masks[k]]
        links += degree
        if degree != 2:
            count += 1
    special = np.empty(count, np.int32)
    special_masks = np.empty(count, np.uint8)
    count = 0
    for k in range(len(cells)):
        if _BITS[masks[k]] != 2:
            special[count] = cells[k]
            special_masks[count] = masks[k]
            count += 1
    owner, parent = _clusters(distance, special, special_masks, resolution_m)

    edge_room = links // 2 + 1
    ends = np.empty((edge_room, 2), np.int32)
    start = np.empty(edge_room + 1, np.int32)
    path = np.empty(2 * len(cells) + 1024, np.int32)
    start[0] = 0
    edges = 0
    size = 0
    for first in range(count):
        for k in range(8):
            if not special_masks[first] >> k & 1:
                continue
            row, column = special[first] // columns, special[first] % columns
            before = special[first]
            cell = before + ROW_STEP[k] * columns + COLUMN_STEP[k]
            if flat_mark[cell] & _SEEN:
                continue  # traced from its other end
            last = _find(special, cell)
            direct = last < count and special[last] == cell
            if direct and (cell < before or parent[last] == first or parent[first] == last):
                continue
            begin = size
            here = first
            while here != -1:
                if size + 1 >= len(path):
                    path = _longer(path)
                path[size] = special[here]
                size += 1
                here = parent[here]
            _reverse(path, begin, size)
            while not direct:
                if size + 1 >= len(path):
                    path = _longer(path)
                path[size] = cell
                size += 1
                flat_mark[cell] |= _SEEN
                row, column = cell // columns, cell % columns
                mask = _links(mark, row, column)
                following = -1
                for j in range(8):
                    if mask >> j & 1:
                        other = cell + ROW_STEP[j] * columns + COLUMN_STEP[j]
                        if other != before:
                            following = other
                before = cell
                cell = following
                last = _find(special, cell)
                direct = last < count and special[last] == cell
            here = last
            while here != -1:
                if size + 1 >= len(path):
                    path = _longer(path)
                path[size] = special[here]
                size += 1
                here = parent[here]
            ends[edges, 0] = special[owner[first]]
            ends[edges, 1] = special[owner[last]]
            edges += 1
            start[edges] = size

    # Rings that no special cell is on: one node each, where it is widest.
    rings = np.empty(len(cells) // 4 + 1, np.int32)
    ring_count = 0
    for k in range(len(cells)):
        if _BITS[masks[k]] != 2 or flat_mark[cells[k]] & _SEEN:
            continue
        widest = cells[k]
        before, cell = -1, cells[k]
        while not flat_mark[cell] & _SEEN:
            flat_mark[cell] |= _SEEN
            if flat_distance[cell] > flat_distance[widest] or (
                flat_distance[cell] == flat_distance[widest] and cell < widest
            ):
                widest = cell
            mask = _links(mark, cell // columns, cell % columns)
            following = -1
            for j in range(8):
                if mask >> j & 1:
                    other = cell + ROW_STEP[j] * columns + COLUMN_STEP[j]
                    if other != before and (before != -1 or following == -1):
                        following = other
            before = cell
            cell = following
        rings[ring_count] = widest
        ring_count += 1
        before, cell = -1, widest
        while True:
            if size + 2 >= len(path):
                path = _longer(path)
            path[size] = cell
            size += 1
            mask = _links(mark, cell // columns, cell % columns)
            following = -1
            for j in range(8):
                if mask >> j & 1:
                    other = cell + ROW_STEP[j] * columns + COLUMN_STEP[j]
                    if other != before and (before != -1 or following == -1):
                        following = other
            before = cell
            cell = following
            if cell == widest:
                break
        path[size] = widest
        size += 1
        ends[edges] = widest
        edges += 1
        start[edges] = size
    for k in range(len(cells)):
        flat_mark[cells[k]] &= np.uint8(3)

    nodes = np.empty(count + ring_count, np.int32)
    total = 0
    for k in range(count):
        if owner[k] == k:
            nodes[total] = special[k]
            total += 1
    for k in range(ring_count):
        nodes[total] = rings[k]
        total += 1
    nodes = np.sort(nodes[:total])
    measures = np.empty((edges, 3))
    for edge in range(edges):
        for side in range(2):
            ends[edge, side] = _find(nodes, ends[edge, side])
        length, cost, clearance = _measure(path, start[edge], start[edge + 1], distance, resolution_m, speeds)
        measures[edge, 0] = length
        measures[edge, 1] = cost
        measures[edge, 2] = clearance
    return nodes, ends[:edges].copy(), measures, start[: edges + 1].copy(), path[:size].copy()


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


@njit(cache=True, error_model="numpy", boundscheck=False)
def _incidence(count: int, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Half-edges of every node in CSR form; half-edge 2 e leaves the first end of e, 2 e + 1 the second."""
    start = np.zeros(count + 1, np.int32)
    for edge in range(len(ends)):
        start[ends[edge, 0] + 1] += 1
        start[ends[edge, 1] + 1] += 1
    for node in range(count):
        start[node + 1] += start[node]
    place = start[:-1].copy()
    half = np.empty(2 * len(ends), np.int32)
    for edge in range(len(ends)):
        for side in range(2):
            node = ends[edge, side]
            half[place[node]] = 2 * edge + side
            place[node] += 1
    return start, half


@njit(cache=True, error_model="numpy", boundscheck=False)
def _onward(node: int, came: int, start: np.ndarray, half: np.ndarray, alive: np.ndarray) -> int:
    """The half-edge by which a line goes on through a node of degree 2; ``came`` arrives there."""
    for k in range(start[node], start[node + 1]):
        if alive[half[k] >> 1] and half[k] != came:
            return half[k]
    return -1


@njit(cache=True, error_model="numpy", boundscheck=False)
def prune(
    clearance: np.ndarray, ends: np.ndarray, lengths: np.ndarray, stub_length_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Remove stubs, round by round; returns which edges and nodes are left, and the nodes' degree.

    ``clearance`` (n,) of the nodes. An edge (chain of edges through nodes of degree 2) that ends
    dead goes if it is shorter than ``stub_length_m``; where that is negative, if it reaches
    less than the clearance of its other end beyond the disc of that clearance, each of its
    own ends taken as a disc too. All stubs of a round go at once, so that no order is in the result.
    """
    count = len(clearance)
    start, half = _incidence(count, ends)
    alive = np.ones(len(ends), np.bool_)
    stays = np.ones(count, np.bool_)
    degree = np.zeros(count, np.int32)
    for node in range(count):
        degree[node] = start[node + 1] - start[node]
    going = np.empty(len(ends), np.int32)
    tips = np.empty(count, np.int32)
    tip_count = 0
    for node in range(count):
        if degree[node] == 1:
            tips[tip_count] = node
            tip_count += 1
    while tip_count > 0:
        gone = 0
        for k in range(tip_count):
            tip = tips[k]
            begin = gone
            length = 0.0
            way = _onward(tip, -1, start, half, alive)
            while True:
                edge = way >> 1
                going[gone] = edge
                gone += 1
                length += lengths[edge]
                came = way ^ 1
                node = ends[edge, came & 1]
                if degree[node] != 2:
                    break
                way = _onward(node, came, start, half, alive)
            if degree[node] == 1 and (clearance[tip], -tip) > (clearance[node], -node):
                gone = begin  # a line with two ends is judged from its narrower one
                continue
            if stub_length_m >= 0.0:
                stub = length < stub_length_m
            else:
                stub = length - max(0.0, clearance[node] - clearance[tip]) < clearance[node]
            if not stub:
                gone = begin
        if gone == 0:
            break
        # Ends that lost a line may be tips now; tips that stayed may belong to longer lines.
        for k in range(gone):
            edge = going[k]
            if alive[edge]:
                alive[edge] = False
                for side in range(2):
                    degree[ends[edge, side]] -= 1
        for k in range(gone):
            for side in range(2):
                node = ends[going[k], side]
                if degree[node] == 0:
                    stays[node] = False
        tip_count = 0
        for node in range(count):
            if degree[node] == 1:
                tips[tip_count] = node
                tip_count += 1
        _keep_one(going[:gone], ends, clearance, degree, stays)
    return alive, stays, degree


@njit(cache=True, error_model="numpy", boundscheck=False)
def _keep_one(
    gone: np.ndarray, ends: np.ndarray, clearance: np.ndarray, degree: np.ndarray, stays: np.ndarray
) -> None:
    """Where a round left nothing of a tree, its inner end stays: stubs of one junction share that."""
    seen = np.zeros(len(stays), np.uint8)
    for edge in gone:
        for side in range(2):
            node = ends[edge, side]
            seen[node] = min(seen[node] + 1, 2)
    # Isolated nodes linked by edges of this round: the component's widest stays, if none has edges left.
    root = np.arange(len(stays)).astype(np.int32)
    for edge in gone:
        a, b = ends[edge, 0], ends[edge, 1]
        while root[a] != a:
            a = root[a]
        while root[b] != b:
            b = root[b]
        if a == b:
            continue
        a_lives, b_lives = degree[a] > 0, degree[b] > 0
        if (a_lives, clearance[a], -a) >= (b_lives, clearance[b], -b):
            root[b] = a
        else:
            root[a] = b
    for edge in gone:
        for side in range(2):
            node = ends[edge, side]
            if root[node] == node and degree[node] == 0:
                stays[node] = True


@njit(cache=True, error_model="numpy", boundscheck=False)
def keep_edges(
    cells: np.ndarray,
    clearance: np.ndarray,
    ends: np.ndarray,
    measures: np.ndarray,
    path_start: np.ndarray,
    path: np.ndarray,
    alive: np.ndarray,
    stays: np.ndarray,
    degree: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The graph that is left, lines merged through nodes of degree 2; same form as :func:`trace`.

    A ring of such nodes keeps its widest. Edges run from the smaller node to the larger.
    """
    count = len(cells)
    start, half = _incidence(count, ends)
    number = np.full(count, -1, np.int32)
    for node in range(count):
        if stays[node] and degree[node] != 2:
            number[node] = 0
    seen = np.zeros(len(ends), np.bool_)
    # Rings first, to know all nodes before they are numbered.
    for node in range(count):
        if number[node] == 0:
            for k in range(start[node], start[node + 1]):
                way = half[k]
                if not alive[way >> 1]:
                    continue
                while True:
                    seen[way >> 1] = True
                    came = way ^ 1
                    other = ends[way >> 1, came & 1]
                    if number[other] == 0:
                        break
                    way = _onward(other, came, start, half, alive)
    for edge in range(len(ends)):
        if not alive[edge] or seen[edge]:
            continue
        way = 2 * edge
        widest = ends[edge, 0]
        while not seen[way >> 1]:
            seen[way >> 1] = True
            came = way ^ 1
            other = ends[way >> 1, came & 1]
            if (clearance[other], -other) > (clearance[widest], -widest):
                widest = other
            way = _onward(other, came, start, half, alive)
        number[widest] = 0
    total = 0
    for node in range(count):
        if number[node] == 0:
            number[node] = total
            total += 1
    out_cells = np.empty(total, np.int32)
    for node in range(count):
        if number[node] >= 0:
            out_cells[number[node]] = cells[node]

    seen[:] = False
    out_ends = np.empty((len(ends), 2), np.int32)
    out_measures = np.empty((len(ends), 3))
    out_start = np.zeros(len(ends) + 1, np.int32)
    out_path = np.empty(len(path), np.int32)
    edges = 0
    size = 0
    for node in range(count):
        if number[node] < 0:
            continue
        for k in range(start[node], start[node + 1]):
            way = half[k]
            if not alive[way >> 1] or seen[way >> 1]:
                continue
            length, cost, width = 0.0, 0.0, np.inf
            begin = size
            while True:
                edge = way >> 1
                seen[edge] = True
                length += measures[edge, 0]
                cost += measures[edge, 1]
                width = min(width, measures[edge, 2])
                low, high = path_start[edge], path_start[edge + 1]
                skip = 1 if size > begin else 0  # the cell that two edges share
                if way & 1 == 0:
                    for cell in range(low + skip, high):
                        out_path[size] = path[cell]
                        size += 1
                else:
                    for cell in range(high - 1 - skip, low - 1, -1):
                        out_path[size] = path[cell]
                        size += 1
                came = way ^ 1
                other = ends[edge, came & 1]
                if number[other] >= 0:
                    break
                way = _onward(other, came, start, half, alive)
            out_ends[edges, 0] = number[node]
            out_ends[edges, 1] = number[other]
            out_measures[edges, 0] = length
            out_measures[edges, 1] = cost
            out_measures[edges, 2] = width
            edges += 1
            out_start[edges] = size
    return (
        out_cells,
        out_ends[:edges].copy(),
        out_measures[:edges].copy(),
        out_start[: edges + 1].copy(),
        out_path[:size].copy(),
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
def label_components(count: int, ends: np.ndarray) -> tuple[np.ndarray, int]:
    """Component of each node, numbered by their smallest nodes, and how many there are."""
    root = np.arange(count).astype(np.int32)
    for edge in range(len(ends)):
        a, b = ends[edge, 0], ends[edge, 1]
        while root[a] != a:
            root[a] = root[root[a]]
            a = root[a]
        while root[b] != b:
            root[b] = root[root[b]]
            b = root[b]
        root[max(a, b)] = min(a, b)
    components = 0
    for node in range(count):
        if root[node] == node:
            root[node] = -1 - components
            components += 1
        else:
            root[node] = root[root[node]] if root[root[node]] < 0 else root[_top(root, node)]
    return -1 - root, components


@njit(cache=True, error_model="numpy", boundscheck=False)
def _top(root: np.ndarray, node: int) -> int:
    while root[node] >= 0:
        node = root[node]
    return node
