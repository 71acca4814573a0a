"""Edges of a graph as straight, drivable pieces, for a route server without the paths."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int

from ..graph.navigation_graph import NavigationGraph
from ..grid.cost_grid import GridLayers
from ..planning.joint_graph import JointGraph
from ._route_kernels import chord_measures, onward, split_path


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

    paths = (
        (edge, first, second, graph.edge_path(edge))
        for edge, (first, second) in enumerate(graph.edges.tolist())
        if first != second
    )
    return _joined(_split(paths, graph.nodes, layers, _clearance(layers)))


def task_pieces(joint: JointGraph, nodes: int) -> RoutePieces:
    """The same for the drives to and from the added nodes of a joint graph, each with its own object taken away.

    Every drive leads from the added node through its region and on to the node of the neighbouring region; ``edge``
    is the index of the added node. Half of its task's time is part of each first piece.

    Parameters
    ----------
    joint
        The graph.
    nodes
        Number of nodes so far: cells where drives are split are numbered from there.
    """
    regions, clearance = joint.regions, _clearance(joint.regions.layers)
    found: list[RoutePieces] = []
    for index, node in enumerate(joint.added):
        paths = (
            (index, node.number, near, np.vstack([way[:-1], onward(regions.potential, regions.seed, *way[-1])]))
            for near, way in zip(node.neighbours.tolist(), node.ways, strict=True)
            if math.isfinite(node.task_s)
        )  # fmt: skip
        around = clearance[node.window]
        mapped = around.copy()
        around[:] = node.clearance
        for part in _split(paths, nodes, regions.layers, clearance):
            part.measures[0, 0] += 0.5 * node.task_s
            nodes += len(part.cells)
            found.append(part)
        around[:] = mapped
    return _joined(found)


def _joined(parts: Iterable[RoutePieces]) -> RoutePieces:
    none = np.zeros((0, 2), np.int64)
    found = [RoutePieces(none, none, none[:, 0], np.zeros((0, 3))), *parts]
    columns = ([getattr(part, name) for part in found] for name in RoutePieces.__slots__)
    return RoutePieces(*map(np.concatenate, columns))


def _clearance(layers: GridLayers) -> Float32[np.ndarray, "rows columns"]:
    """Clearance of each cell [cells], writable."""
    return layers.distance_m / np.float32(layers.map.resolution_m)


def _split(
    paths: Iterable[tuple[int, int, int, Int[np.ndarray, "n 2"]]],
    number: int,
    layers: GridLayers,
    distance: Float32[np.ndarray, "rows columns"],
) -> Iterator[RoutePieces]:
    """Split paths (edge, first node, last node, cells); cells of the cuts are numbered from ``number``."""
    resolution_m, limits, outside = layers.map.resolution_m, layers.limits, not layers.unknown_is_free
    radius = layers.radius_m / resolution_m
    speeds = np.array([radius, 1.0 / limits.v_min_m_s, 1.0 / limits.v_max_m_s])
    for edge, first, last, cells in paths:
        path = np.ascontiguousarray(cells, np.int32)
        # Tolerance for the single precision of the distances where the robot just fits.
        cuts = np.flatnonzero(split_path(distance, path, radius * (1.0 - 1e-6), outside))
        nodes = np.array([first, *range(number, number + len(cuts) - 2), last])
        number += len(cuts) - 2
        ends, edges = np.column_stack([nodes[:-1], nodes[1:]]), np.full(len(cuts) - 1, edge)
        measures = resolution_m * chord_measures(distance, path[cuts], speeds, outside)
        yield RoutePieces(path[cuts[1:-1]], ends, edges, measures)
