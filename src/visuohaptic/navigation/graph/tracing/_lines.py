"""From a skeleton to lines between nodes, without stubs (Alt 2016, Sec. 4.2 d-e).

The links between the cells of the skeleton and, later, the lines between its junctions are edges of a graph; both are
joined to chains through nodes with two of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Int32

from ...grid.cost_grid import GridLayers
from ._line_kernels import find_chains, gather_junctions
from ._skeleton_kernels import ADJACENT, COLUMN_STEP, ROW_STEP


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Nodes, and the lines of cells between them; cells are flat (row * columns + column)."""

    cells: Int[np.ndarray, "n"]  #: of the nodes, ascending
    ends: Int[np.ndarray, "m 2"]  #: nodes of each line
    start: Int[np.ndarray, "m+1"]  #: start index of each line in ``path``
    path: Int[np.ndarray, "p"]  #: cells of all lines, including both nodes


def skeleton_lines(layers: GridLayers, kept: Bool[np.ndarray, "rows columns"]) -> Lines:
    """Lines between all junctions and ends of the skeleton; rings have one node.

    Parameters
    ----------
    layers
        Costmap: clearance and cost of each cell.
    kept
        Cells of the skeleton, from :func:`~visuohaptic.navigation.graph.tracing.skeletonize.skeleton`.
    """
    padded, wide = np.pad(kept, 1).ravel(), kept.shape[1] + 2
    found = np.flatnonzero(padded).astype(np.int32)
    near = found[:, None] + (ROW_STEP * np.int32(wide) + COLUMN_STEP)
    links = ADJACENT[np.packbits(padded[near], axis=1, bitorder="little")]
    linked = np.unpackbits(links, axis=1, bitorder="little").view(np.bool_)
    places = np.column_stack(np.divmod(found, wide)) - 1
    cells = places[:, 0] * kept.shape[1] + places[:, 1]
    clearance_m = layers.distance_m.ravel()[cells]
    start = _starts(linked.sum(axis=1))
    target = np.searchsorted(found, near[linked])
    number = np.cumsum(linked).reshape(linked.shape) - 1
    other = number[target, np.nonzero(linked)[1] ^ 4]
    stop, chain_start, halves, ends = _chains(start, target, other, clearance_m)

    widest = np.flatnonzero(np.diff(start) > 2)
    widest = widest[np.argsort(-clearance_m[widest], kind="stable")]
    reach = np.maximum(clearance_m.astype(np.float64) / layers.map.resolution_m, 1.5)
    leader, parent, steps = gather_junctions(start, target, places, widest, reach)
    count = np.diff(chain_start)
    # Links on the way from a cell to its leader are part of the node.
    line = (count > 1) | (parent[ends] != ends[:, ::-1]).all(axis=1)
    halves, count, (first, last) = halves[np.repeat(line, count)], count[line], ends[line].T
    path_start = _starts(count + 1 + steps[first] + steps[last])
    path = np.empty(path_start[-1], np.int64)
    path[_ranges(path_start[:-1] + steps[first] + 1, count, np.ones_like(count))] = target[halves]
    ways = (first, path_start[:-1] + steps[first], -1), (last, path_start[1:] - 1 - steps[last], 1)
    for cell, place, sense in ways:
        while len(cell):
            path[place] = cell
            onward = parent[cell] >= 0
            cell, place = parent[cell[onward]], place[onward] + sense
    nodes = np.flatnonzero(stop & (leader == np.arange(len(leader))))
    return Lines(cells[nodes], np.searchsorted(nodes, leader[ends[line]]), path_start, cells[path])


def without_stubs(layers: GridLayers, lines: Lines, stub_length_m: float | None) -> Lines:
    """Remove stubs until none is left, and join lines through nodes with two of them.

    A line with two dead ends is measured from its narrower one, and becomes its widest node if it goes; a ring of nodes
    with two lines keeps its widest one. Lines run from the smaller node to the larger.

    Parameters
    ----------
    layers
        Costmap: clearance and cost of each cell.
    lines
        From :func:`skeleton_lines`.
    stub_length_m
        Shorter dead ends are stubs; None for those that extend less than the clearance of the junction beyond the
        circle of that clearance.
    """
    nodes = len(lines.cells)
    # Infinite without an obstacle.
    clearance_m = np.nan_to_num(layers.distance_m.ravel()[lines.cells])
    rank = _rank(clearance_m)
    length_m = measures(layers, lines)[:, 0]
    stays, left = np.ones(nodes, np.bool_), np.arange(len(lines.ends))
    while True:
        side = np.argsort(lines.ends[left].ravel(), kind="stable")
        place = np.argsort(side)
        degree = np.bincount(lines.ends[left].ravel(), minlength=nodes)
        target = lines.ends[left][:, ::-1].ravel()[side]
        stop, start, halves, ends = _chains(_starts(degree), target, place[side ^ 1], clearance_m)
        halves = 2 * left[side[halves] >> 1] + (side[halves] & 1)
        long_m = np.add.reduceat(length_m[halves >> 1], start[:-1])
        dead = degree[ends] == 1
        tip = np.argmin(np.where(dead, rank[ends], nodes), axis=1)[:, None]
        tip_m, node_m = (np.take_along_axis(clearance_m[ends], end, axis=1)[:, 0] for end in (tip, 1 - tip))
        if stub_length_m is None:
            stub = long_m - np.maximum(0.0, node_m - tip_m) < node_m
        else:
            stub = long_m < stub_length_m
        gone = halves[np.repeat(dead.any(axis=1) & stub, np.diff(start))] >> 1
        if not len(gone):
            break
        left = np.setdiff1d(left, gone)
        lost = lines.ends[gone]
        degree = np.bincount(lines.ends[left].ravel(), minlength=nodes)
        stays[lost] = degree[lost] > 0
        settled = degree > 0
        settled[np.setdiff1d(np.arange(nodes), lost)] = True
        stays[_widest(lost, settled, rank)] = True
    kept = np.flatnonzero(stop & stays)
    # The cells of each piece, backwards if it is passed from its second node; the common cell of two pieces once.
    back, piece = halves & 1, halves >> 1
    again = np.ones(len(halves), np.int64)
    again[start[:-1]] = 0
    sense, size = 1 - 2 * back, np.diff(lines.start)[piece] - again
    begin = np.where(back, lines.start[piece + 1] - 1, lines.start[piece]) + sense * again
    path = lines.path[_ranges(begin, size, sense)]
    return Lines(lines.cells[kept], np.searchsorted(kept, ends), _starts(size)[start], path)


def measures(layers: GridLayers, lines: Lines) -> Float[np.ndarray, "m 3"]:
    """Length [m], cost [s] (trapezoidal rule over the cells) and clearance [m] of each line.

    Parameters
    ----------
    layers
        Costmap: clearance and cost of each cell.
    lines
        Lines between nodes.
    """
    distance_m = layers.distance_m.ravel()[lines.path]
    # The robot fits on every cell of a line, whatever the rounding of the distance.
    cost = layers.limits.cost_s_per_m(np.maximum(distance_m, layers.radius_m))
    row, column = np.divmod(lines.path, layers.shape[1])
    step_m = np.hypot(np.diff(row, append=0), np.diff(column, append=0)) * layers.map.resolution_m
    step_m[lines.start[1:] - 1] = 0.0
    cost_s = 0.5 * step_m * (cost + np.roll(cost, -1))
    length_m, time_s = (np.add.reduceat(of, lines.start[:-1]) for of in (step_m, cost_s))
    return np.column_stack([length_m, time_s, np.minimum.reduceat(distance_m, lines.start[:-1])])


def _chains(
    start: Int[np.ndarray, "n+1"],
    target: Int[np.ndarray, "h"],
    other: Int[np.ndarray, "h"],
    clearance_m: Float32[np.ndarray, "n"],
) -> tuple[Bool[np.ndarray, "n"], Int[np.ndarray, "c+1"], Int[np.ndarray, "s"], Int[np.ndarray, "c 2"]]:
    """Nodes where chains stop (none of two edges, and the widest of each ring), the chains' half-edges, their ends."""
    degree = np.diff(start)
    source = np.repeat(np.arange(len(degree)), degree)
    stop = degree != 2
    chain_start, halves = find_chains(start, target, other, stop)
    if 2 * len(halves) < len(target):  # all others are in rings
        stop[_widest(np.column_stack([source, target]), stop, _rank(clearance_m))] = True
        chain_start, halves = find_chains(start, target, other, stop)
    ends = np.column_stack([source[halves[chain_start[:-1]]], target[halves[chain_start[1:] - 1]]])
    return stop, chain_start, halves, ends


def _widest(
    ends: Int[np.ndarray, "m 2"], settled: Bool[np.ndarray, "n"], rank: Int[np.ndarray, "n"]
) -> Int[np.ndarray, "c"]:
    """The node of the highest rank of each component without a settled node."""
    component, count = components_of(len(settled), ends)
    highest = np.full(count, -1)
    np.maximum.at(highest, component, np.where(settled, len(rank), rank))
    return np.argsort(rank)[highest[highest < len(rank)]]


def _rank(clearance_m: Float32[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
    """Rank of each node by its clearance, and by its cell from the last to the first."""
    return np.argsort(np.lexsort((-np.arange(len(clearance_m)), clearance_m)))


def _starts(count: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n+1"]:
    return np.concatenate([[0], np.cumsum(count)])


def _ranges(
    first: Int[np.ndarray, "n"], count: Int[np.ndarray, "n"], sense: Int[np.ndarray, "n"]
) -> Int[np.ndarray, "sum"]:
    """The concatenated numbers ``first``, ``first + sense``, ...: ``count`` of each."""
    steps = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return np.repeat(first, count) + np.repeat(sense, count) * steps


def components_of(nodes: int, edges: Int[np.ndarray, "m 2"]) -> tuple[Int32[np.ndarray, "n"], int]:
    """Connected component of each node, numbered by the smallest nodes, and the number of components.

    Parameters
    ----------
    nodes
        Number of nodes.
    edges
        Nodes of each edge.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(edges), dtype=bool), edges.T), shape=(nodes, nodes))
    count, component = connected_components(graph, directed=False)
    return component.astype(np.int32), int(count)
