"""Edges of a graph as straight, drivable pieces, for a route server without the paths."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from ..graph.navigation_graph import NavigationGraph
from ..grid.cost_grid import GridLayers
from ._route_kernels import chord_measures, split_path


@dataclass(frozen=True, slots=True, eq=False)
class RoutePieces:
    """Straight pieces in order along each edge; nodes are those of the graph, then the cells where edges are split."""

    cells: Int[np.ndarray, "k 2"]  #: (row, column) of the added nodes
    ends: Int[np.ndarray, "p 2"]  #: nodes of each piece
    edge: Int[np.ndarray, "p"]  #: edge of the graph that it is part of
    measures: Float[np.ndarray, "p 3"]  #: cost [s], length [m], clearance [m], at most three radii


def route_pieces(graph: NavigationGraph, layers: GridLayers) -> RoutePieces:
    """Split the edges of a graph until every straight piece keeps the robot's radius from the obstacles.

    A piece that does not is split at the cell of its path farthest from the straight line, down to
    neighbouring cells. Edges from a node to itself are omitted.

    Parameters
    ----------
    graph, layers
        The graph and the layers that it was built from.
    """

    resolution_m = layers.map.resolution_m
    distance = layers.distance_m / np.float32(resolution_m)
    outside = not layers.unknown_is_free
    # Tolerance for the single precision of the distances where the robot just fits.
    radius = layers.radius_m / resolution_m * (1.0 - 1e-6)
    limits = layers.limits
    speeds = np.array([layers.radius_m / resolution_m, 1.0 / limits.v_min_m_s, 1.0 / limits.v_max_m_s])
    added: list[np.ndarray] = []
    ends: list[tuple[int, int]] = []
    edges: list[int] = []
    measures: list[np.ndarray] = []
    number = graph.nodes
    for edge, (first, second) in enumerate(graph.edges.tolist()):
        if first == second:
            continue
        path = np.ascontiguousarray(graph.edge_path(edge))
        cuts = np.flatnonzero(split_path(distance, path, radius, outside))
        inner = list(range(number, number + len(cuts) - 2))
        number += len(inner)
        nodes = [first, *inner, second]
        added.append(path[cuts[1:-1]])
        ends += pairwise(nodes)
        edges += [edge] * (len(nodes) - 1)
        measures.append(chord_measures(distance, path[cuts], speeds, outside))
    scale = np.array([resolution_m, resolution_m, resolution_m])
    return RoutePieces(
        np.concatenate([np.zeros((0, 2), np.int64), *added]),
        np.array(ends, dtype=np.int64).reshape(-1, 2),
        np.array(edges, dtype=np.int64),
        np.concatenate([np.zeros((0, 3)), *measures]) * scale,
    )
