"""Shortest paths on the half-edges of a graph: A* with landmarks, and Dijkstra."""

from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel

__all__ = ["all_costs", "graph_search", "half_edges"]


@kernel(error_model="numpy", boundscheck=False)
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
    place = start[:-1].copy()
    half = np.empty(2 * len(ends), np.int32)
    for edge in range(len(ends)):
        for side in range(2):
            node = ends[edge, side]
            half[place[node]] = 2 * edge + side
            place[node] += 1
    return start, half


@kernel(error_model="numpy", boundscheck=False)
def _push(keys: np.ndarray, items: np.ndarray, size: int, key: float, item: int) -> None:
    """Into a heap of four children per place, which is flatter than one of two."""
    place = size
    while place > 0:
        above = (place - 1) >> 2
        if keys[above] <= key:
            break
        keys[place] = keys[above]
        items[place] = items[above]
        place = above
    keys[place] = key
    items[place] = item


@kernel(error_model="numpy", boundscheck=False)
def _pop(keys: np.ndarray, items: np.ndarray, size: int) -> None:
    """Take the top away; ``size`` counts it still."""
    last = size - 1
    key, item = keys[last], items[last]
    place = 0
    while True:
        child = 4 * place + 1
        if child >= last:
            break
        best = child
        for k in range(child + 1, min(child + 4, last)):
            if keys[k] < keys[best]:
                best = k
        if keys[best] >= key:
            break
        keys[place] = keys[best]
        items[place] = items[best]
        place = best
    keys[place] = key
    items[place] = item


@kernel(error_model="numpy", boundscheck=False)
def graph_search(
    start: np.ndarray,
    half: np.ndarray,
    ends: np.ndarray,
    costs: np.ndarray,
    place_m: np.ndarray,
    pace: float,
    marks: np.ndarray,
    source: int,
    goal: int,
) -> tuple[np.ndarray, float]:
    """Cheapest path from ``source`` to ``goal`` by A*: its half-edges and its cost, infinite if there is none.

    The heuristic is admissible: at least the straight distance times ``pace``, and at least the
    difference of the costs to any landmark.

    Parameters
    ----------
    start, half
        Half-edges of each node in CSR form, from :func:`half_edges`.
    ends
        Nodes of each edge, (m, 2).
    costs
        Of the edges [s].
    place_m
        Of the nodes, (n, 2) [m].
    pace
        Minimum cost per distance [s/m].
    marks
        Costs from landmarks to every node, (landmarks, nodes) [s].
    source
        Node, or flat cell, to start from.
    goal
        Node, or flat cell, to reach.
    """
    count = len(start) - 1
    cost = np.full(count, np.inf)
    came = np.full(count, -1, np.int32)
    done = np.zeros(count, np.bool_)
    keys = np.empty(len(half) + 2)
    items = np.empty(len(half) + 2, np.int32)
    size = 1
    keys[0] = 0.0
    items[0] = source
    cost[source] = 0.0
    landmarks = len(marks)
    while size > 0:
        node = items[0]
        _pop(keys, items, size)
        size -= 1
        if done[node]:
            continue
        done[node] = True
        if node == goal:
            break
        for k in range(start[node], start[node + 1]):
            half_edge = half[k]
            other = ends[half_edge >> 1, 1 - (half_edge & 1)]
            reached = cost[node] + costs[half_edge >> 1]
            if done[other] or not reached < cost[other]:
                continue
            cost[other] = reached
            came[other] = half_edge
            left = pace * math.hypot(
                place_m[other, 0] - place_m[goal, 0], place_m[other, 1] - place_m[goal, 1]
            )
            for mark in range(landmarks):
                # Infinite costs (other components) have no difference; NaN loses every comparison.
                difference = abs(marks[mark, other] - marks[mark, goal])
                if difference > left:
                    left = difference
            _push(keys, items, size, reached + left, other)
            size += 1
    if not cost[goal] < np.inf:
        return np.empty(0, np.int32), np.inf
    steps = 0
    node = goal
    while node != source:
        node = ends[came[node] >> 1, came[node] & 1]
        steps += 1
    halves = np.empty(steps, np.int32)
    node = goal
    for k in range(steps - 1, -1, -1):
        halves[k] = came[node]
        node = ends[came[node] >> 1, came[node] & 1]
    return halves, cost[goal]


@kernel(error_model="numpy", boundscheck=False)
def all_costs(
    start: np.ndarray, half: np.ndarray, ends: np.ndarray, costs: np.ndarray, source: int
) -> np.ndarray:
    """Cost of the cheapest path from ``source`` to every node, by Dijkstra [s].

    Parameters
    ----------
    start, half
        Half-edges of each node in CSR form, from :func:`half_edges`.
    ends
        Nodes of each edge, (m, 2).
    costs
        Of the edges [s].
    source
        Node, or flat cell, to start from.
    """
    count = len(start) - 1
    cost = np.full(count, np.inf)
    done = np.zeros(count, np.bool_)
    keys = np.empty(len(half) + 2)
    items = np.empty(len(half) + 2, np.int32)
    keys[0] = 0.0
    items[0] = source
    size = 1
    cost[source] = 0.0
    while size > 0:
        node = items[0]
        _pop(keys, items, size)
        size -= 1
        if done[node]:
            continue
        done[node] = True
        for k in range(start[node], start[node + 1]):
            half_edge = half[k]
            other = ends[half_edge >> 1, 1 - (half_edge & 1)]
            reached = cost[node] + costs[half_edge >> 1]
            if reached < cost[other]:
                cost[other] = reached
                _push(keys, items, size, reached, other)
                size += 1
    return cost
