"""From lines to decisions: remove stubs, merge edges at nodes that are not decisions."""

from __future__ import annotations

import numpy as np

from ....core.kernels import kernel


@kernel(error_model="numpy")
def _onward(node: int, came: int, start: np.ndarray, half: np.ndarray, alive: np.ndarray) -> int:
    """The half-edge by which a line continues through a node of degree 2; ``came`` arrives there."""
    for k in range(start[node], start[node + 1]):
        if alive[half[k] >> 1] and half[k] != came:
            return half[k]
    return -1


@kernel(error_model="numpy")
def prune(
    clearance: np.ndarray, ends: np.ndarray, lengths: np.ndarray, stub_length_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Remove stubs, round by round; returns the remaining edges and nodes, and the nodes' degree.

    A dead end (chain of edges through nodes of degree 2) is removed if it is shorter than ``stub_length_m``;
    where that is negative, if it extends less than the clearance of its other end beyond the disc of that
    clearance, with its own ends taken as discs too. All stubs of a round are removed
    at once, so that the result does not depend on their order.

    Parameters
    ----------
    clearance
        Clearance of the nodes (n,) [m].
    ends
        Nodes of each edge, (m, 2).
    lengths
        Lengths of the edges [m].
    stub_length_m
        Minimum length of a dead end [m]; negative for the rule by clearance.
    """
    count = len(clearance)
    start, half = half_edges(count, ends)
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
    root = np.empty(count, np.int32)
    while tip_count > 0:
        gone = 0
        for k in range(tip_count):
            tip = tips[k]
            begin = gone
            length = 0.0
            half_edge = _onward(tip, -1, start, half, alive)
            while True:
                edge = half_edge >> 1
                going[gone] = edge
                gone += 1
                length += lengths[edge]
                came = half_edge ^ 1
                node = ends[edge, came & 1]
                if degree[node] != 2:
                    break
                half_edge = _onward(node, came, start, half, alive)
            if degree[node] == 1 and (clearance[tip], -tip) > (clearance[node], -node):
                gone = begin  # a line with two dead ends is measured from its narrower one
                continue
            if stub_length_m >= 0.0:
                stub = length < stub_length_m
            else:
                stub = length - max(0.0, clearance[node] - clearance[tip]) < clearance[node]
            if not stub:
                gone = begin
        if gone == 0:
            break
        # Ends that lost a line may be tips now; tips that remain may belong to longer lines.
        for k in range(gone):
            edge = going[k]
            if alive[edge]:
                alive[edge] = False
                for side in range(2):
                    node = ends[edge, side]
                    degree[node] -= 1
                    stays[node] = degree[node] > 0
        kept = 0
        for k in range(tip_count):
            if degree[tips[k]] == 1:
                tips[kept] = tips[k]
                kept += 1
        tip_count = kept
        for k in range(gone):
            for side in range(2):
                node = ends[going[k], side]
                if degree[node] == 1:
                    known = False
                    for j in range(kept, tip_count):
                        known |= tips[j] == node
                    if not known:
                        tips[tip_count] = node
                        tip_count += 1
        _keep_one(going[:gone], ends, clearance, degree, stays, root)
    return alive, stays, degree


@kernel(error_model="numpy")
def _keep_one(
    gone: np.ndarray,
    ends: np.ndarray,
    clearance: np.ndarray,
    degree: np.ndarray,
    stays: np.ndarray,
    root: np.ndarray,
) -> None:
    """If a round removes a whole tree, keep its inner end, which the stubs of one junction have in common.

    ``root`` (n,) int32 is a work array.
    """
    # Isolated nodes linked by edges of this round: keep the widest of each component if none has edges left.
    for edge in gone:
        for side in range(2):
            root[ends[edge, side]] = ends[edge, side]
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


@kernel(error_model="numpy")
def keep_edges(
    cells: np.ndarray,
    clearance: np.ndarray,
    ends: np.ndarray,
    measures: np.ndarray,
    alive: np.ndarray,
    stays: np.ndarray,
    degree: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, int, int]:
    """The remaining graph, with lines merged through nodes of degree 2.

    A ring of such nodes keeps its widest one. Edges run from the smaller node to the larger. Returns cells of the
    nodes, ends and measures of the edges, and the half-edges of the raw graph that each edge consists of (CSR form);
    last the numbers of edges and half-edges: the arrays are longer.

    Parameters
    ----------
    cells
        Cells of the nodes (n,), flat.
    clearance
        Clearance of the nodes (n,) [m].
    ends
        Nodes of each edge, (m, 2).
    measures
        Length [m], cost [s] and clearance [m] of each edge, (m, 3).
    alive, stays, degree
        The remaining edges and nodes, and the degree of each node; from :func:`prune`.
    """
    count = len(cells)
    start, half = half_edges(count, ends)
    number = np.full(count, -1, np.int32)
    for node in range(count):
        if stays[node] and degree[node] != 2:
            number[node] = 0
    seen = np.zeros(len(ends), np.bool_)
    # Rings first, so that all nodes are known before they are numbered.
    for node in range(count):
        if number[node] == 0:
            for k in range(start[node], start[node + 1]):
                half_edge = half[k]
                if not alive[half_edge >> 1]:
                    continue
                while True:
                    seen[half_edge >> 1] = True
                    came = half_edge ^ 1
                    other = ends[half_edge >> 1, came & 1]
                    if number[other] == 0:
                        break
                    half_edge = _onward(other, came, start, half, alive)
    for edge in range(len(ends)):
        if not alive[edge] or seen[edge]:
            continue
        half_edge = 2 * edge
        widest = ends[edge, 0]
        while not seen[half_edge >> 1]:
            seen[half_edge >> 1] = True
            came = half_edge ^ 1
            other = ends[half_edge >> 1, came & 1]
            if (clearance[other], -other) > (clearance[widest], -widest):
                widest = other
            half_edge = _onward(other, came, start, half, alive)
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
    edge_ways = np.zeros(len(ends) + 1, np.int32)
    halves = np.empty(len(ends), np.int32)
    edges = 0
    size = 0
    for node in range(count):
        if number[node] < 0:
            continue
        for k in range(start[node], start[node + 1]):
            half_edge = half[k]
            if not alive[half_edge >> 1] or seen[half_edge >> 1]:
                continue
            length, cost, width = 0.0, 0.0, np.inf
            while True:
                edge = half_edge >> 1
                seen[edge] = True
                length += measures[edge, 0]
                cost += measures[edge, 1]
                width = min(width, measures[edge, 2])
                halves[size] = half_edge
                size += 1
                came = half_edge ^ 1
                other = ends[edge, came & 1]
                if number[other] >= 0:
                    break
                half_edge = _onward(other, came, start, half, alive)
            out_ends[edges, 0] = number[node]
            out_ends[edges, 1] = number[other]
            out_measures[edges, 0] = length
            out_measures[edges, 1] = cost
            out_measures[edges, 2] = width
            edges += 1
            edge_ways[edges] = size
    return out_cells, out_ends, out_measures, edge_ways, halves, edges, size


@kernel(error_model="numpy")
def half_edges(count: int, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Half-edges of each node in CSR form: 2 e leaves the first end of edge e, 2 e + 1 the second.

    Parameters
    ----------
    count
        Number of nodes.
    ends
        Nodes of each edge, (m, 2).
    """
    start = np.zeros(count + 1, np.int32)
    for edge in range(len(ends)):
        start[ends[edge, 0] + 1] += 1
        start[ends[edge, 1] + 1] += 1
    for node in range(count):
        start[node + 1] += start[node]
    place = np.empty(count, np.int32)
    for node in range(count):
        place[node] = start[node]
    half = np.empty(2 * len(ends), np.int32)
    for edge in range(len(ends)):
        for side in range(2):
            node = ends[edge, side]
            half[place[node]] = 2 * edge + side
            place[node] += 1
    return start, half
