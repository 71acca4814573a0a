"""Chains of edges between the nodes of a graph that are not passed through, and nodes of adjacent junction cells.

Half-edges are numbered in the order of their nodes (CSR form): those of node n are ``start[n]`` to ``start[n + 1]``.
"""

from __future__ import annotations

import numpy as np

from ....core.kernels import kernel


@kernel(error_model="numpy")
def find_chains(
    start: np.ndarray, target: np.ndarray, other: np.ndarray, stop: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Half-edges along all chains between two nodes where chains stop, each once: from its smaller node; CSR form.

    Parameters
    ----------
    start
        First half-edge of each node, (n + 1,).
    target, other
        Node at the end of each half-edge, and the half-edge in the opposite direction, (2 m,).
    stop
        Whether chains end at a node (n,); all others have two half-edges.
    """
    chain_start = np.zeros(len(target) // 2 + 1, np.int64)
    halves = np.empty(len(target) // 2, np.int64)
    seen = np.zeros(len(target), np.bool_)
    chains, size = 0, 0
    for node in range(len(stop)):
        if not stop[node]:
            continue
        for first in range(start[node], start[node + 1]):
            if seen[first]:
                continue
            half = first
            while True:
                halves[size] = half
                size += 1
                seen[half] = seen[other[half]] = True
                here = target[half]
                if stop[here]:
                    break
                half = 2 * start[here] + 1 - other[half]  # the other one of two
            chains += 1
            chain_start[chains] = size
    return chain_start[: chains + 1].copy(), halves[:size].copy()


@kernel(error_model="numpy")
def gather_junctions(
    start: np.ndarray, target: np.ndarray, places: np.ndarray, widest: np.ndarray, reach: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Adjacent junction cells become one node: the leader of each cell, the next cell on the way to it (or -1), the steps.

    The cell with the largest clearance leads those within its reach, from cell to cell.

    Parameters
    ----------
    start, target
        Links between the cells of the skeleton, see :func:`find_chains`.
    places
        Row and column of each cell, (n, 2).
    widest
        Junction cells by descending clearance.
    reach
        Maximum distance from a leader to its cells [cells], (n,).
    """
    leader = np.arange(len(reach))
    parent = np.full(len(reach), -1, np.int64)
    steps = np.zeros(len(reach), np.int64)
    queue = np.empty(len(widest), np.int64)
    for cell in widest:
        leader[cell] = -1
    for first in widest:
        if leader[first] >= 0:
            continue
        leader[first] = queue[0] = first
        head, tail = 0, 1
        while head < tail:
            here = queue[head]
            head += 1
            for half in range(start[here], start[here + 1]):
                cell = target[half]
                down, across = places[cell, 0] - places[first, 0], places[cell, 1] - places[first, 1]
                if leader[cell] >= 0 or down * down + across * across > reach[first] ** 2:
                    continue
                leader[cell], parent[cell], steps[cell] = first, here, steps[here] + 1
                queue[tail] = cell
                tail += 1
    return leader, parent, steps
