"""The navigation graph: one node per decision, one edge per path between them (Alt 2016, Sec. 4.2 e)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int, Int32

from ...core.ranges import NON_NEGATIVE, check_numbers
from ..grid.cost_grid import GridLayers
from .tracing._lines import skeleton_lines, speeds
from .tracing._path_kernels import measure
from .tracing._prune_kernels import keep_edges, prune
from .tracing.skeletonize import skeleton_marks


@dataclass(frozen=True, slots=True, eq=False)
class NavigationGraph:
    """Decision points of the robot, and the paths between them.

    Symbols: n nodes in the order of their cells, m edges, p cells of all paths. Parallel edges
    and edges from a node to itself are included: each is a loop around a hole.
    """

    node_cells: Int32[np.ndarray, "n 2"]  #: (row, column)
    node_m: Float[np.ndarray, "n 2"]  #: (x, y) in the map frame [m]
    edges: Int32[np.ndarray, "m 2"]  #: nodes of an edge, the smaller first
    edge_cost_s: Float[np.ndarray, "m"]  #: time along the path at the speed of Eq. (4.1)
    edge_length_m: Float[np.ndarray, "m"]  #: length of the path
    edge_clearance_m: Float[np.ndarray, "m"]  #: minimum distance from an obstacle on the path
    path_start: Int32[np.ndarray, "m+1"]  #: start index of an edge's cells in ``path_cells``
    path_cells: Int32[
        np.ndarray, "p 2"
    ]  #: (row, column) of each edge's cells, from its first node to its second
    component: Int32[np.ndarray, "n"]  #: connected component of a node, numbered by the smallest node
    components: int  #: number of connected components

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return len(self.node_cells)

    @property
    def loops(self) -> int:
        """Independent loops: edges - nodes + components, one per hole of the reachable area."""
        return len(self.edges) - len(self.node_cells) + self.components

    @property
    def degree(self) -> Int[np.ndarray, "n"]:
        """Number of edge ends at each node; an edge from a node to itself counts twice."""
        return np.bincount(self.edges.ravel(), minlength=self.nodes)

    def edge_path(self, edge: int) -> Int32[np.ndarray, "k 2"]:
        """Cells (row, column) of an edge, from its first node to its second.

        Parameters
        ----------
        edge
            Index of the edge.
        """
        return self.path_cells[self.path_start[edge] : self.path_start[edge + 1]]


def build_graph(
    layers: GridLayers, *, stub_length_m: float | None = None, spacing_m: float | None = None
) -> NavigationGraph:
    """Skeleton to graph: trace, remove stubs, merge connection nodes (Alt 2016, Sec. 4.2 d-e).

    Adjacent junction cells become one node, at the cell with the largest clearance. Components and independent
    loops are exactly those of the reachable cells (8-connected, holes 4-connected).

    Parameters
    ----------
    layers
        From :func:`visuohaptic.navigation.grid.cost_grid.grid_layers`.
    stub_length_m
        Shorter dead ends are removed. By default those are removed that extend less than the clearance
        of the junction beyond the circle of that clearance: the corners of a room are removed, a corridor is kept.
    spacing_m
        Keep connection nodes at approximately this spacing; by default none.

    Examples
    --------
    >>> import numpy as np
    >>> from visuohaptic.io.maps import OccupancyMap
    >>> from visuohaptic.navigation.grid import SpeedLimits, grid_layers
    >>> walls = np.zeros((30, 60), dtype=bool)  # two rooms with a door
    >>> walls[[0, -1]] = walls[:, [0, -1]] = walls[:11, 30] = walls[19:, 30] = True
    >>> layers = grid_layers(OccupancyMap(walls, 0.1), SpeedLimits(0.15, 0.3, 0.05))
    >>> graph = build_graph(layers)
    >>> graph.nodes > 0, graph.edges.shape[1]
    (True, 2)
    """
    check_numbers("build_graph", NON_NEGATIVE, stub_length_m=stub_length_m, spacing_m=spacing_m)
    raw = skeleton_lines(layers, skeleton_marks(layers))
    stub = -1.0 if stub_length_m is None else stub_length_m
    left = prune(raw.clearance_m, raw.ends, raw.measures[:, 0].copy(), stub)
    nodes, ends, measures, edge_start, halves, edges, size = keep_edges(
        raw.cells, raw.clearance_m, raw.ends, raw.measures, *left
    )
    ways = raw.paths(edge_start[: edges + 1].copy(), halves[:size].copy())
    found = nodes, ends[:edges].copy(), measures[:edges].copy(), *ways
    if spacing_m:
        found = _spaced(layers, *found, spacing_m)
    nodes, ends, measures, start, path = found
    component, components = components_of(len(nodes), ends)
    node_cells = np.column_stack(np.divmod(nodes, layers.shape[1])).astype(np.int32)
    return NavigationGraph(
        node_cells,
        layers.map.world_from_cell(node_cells),
        ends,
        measures[:, 1].copy(),
        measures[:, 0].copy(),
        measures[:, 2].copy(),
        start,
        np.column_stack(np.divmod(path, layers.shape[1])).astype(np.int32),
        component,
        components,
    )


def _spaced(
    layers: GridLayers,
    nodes: Int32[np.ndarray, "n"],
    ends: Int32[np.ndarray, "m 2"],
    measures: Float[np.ndarray, "m 3"],
    path_start: Int32[np.ndarray, "m+1"],
    path: Int32[np.ndarray, "p"],
    spacing_m: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Divide long edges into pieces of equal length, as near to ``spacing_m`` as an integer number of pieces allows."""

    columns = layers.shape[1]
    taken = set(nodes.tolist())
    pieces = []
    for edge in range(len(ends)):
        cells = path[path_start[edge] : path_start[edge + 1]]
        # At most one piece per cell, which bounds the work for tiny spacings.
        most, length_m = len(cells) - 1, float(measures[edge, 0])
        count = most if length_m >= most * spacing_m else round(length_m / spacing_m)
        cuts = [0]
        if count > 1:
            rows, cols = np.divmod(cells, columns)
            steps = np.hypot(np.diff(rows), np.diff(cols))
            along = np.concatenate([[0.0], np.cumsum(steps)])
            for k in range(1, count):
                cut = int(np.searchsorted(along, along[-1] * k / count))
                # Paths with common cells inside a junction have no common node there.
                if cuts[-1] < cut < len(cells) - 1 and int(cells[cut]) not in taken:
                    taken.add(int(cells[cut]))
                    cuts.append(cut)
        cuts.append(len(cells) - 1)
        pieces += [cells[a : b + 1] for a, b in pairwise(cuts)]
    found = np.array(sorted(taken), dtype=np.int32)
    turned = [piece if piece[0] <= piece[-1] else piece[::-1] for piece in pieces]
    joined = np.array([(piece[0], piece[-1]) for piece in turned], dtype=np.int32).reshape(-1, 2)
    order = np.lexsort((joined[:, 1], joined[:, 0]))
    lengths = np.array([len(turned[k]) for k in order], dtype=np.int32)
    start = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
    flat = np.concatenate([turned[k] for k in order]) if len(order) else path
    scale = layers.distance_m, layers.map.resolution_m, speeds(layers)
    measured = np.array([measure(flat, a, b, *scale) for a, b in pairwise(start.tolist())]).reshape(-1, 3)
    return found, np.searchsorted(found, joined[order]).astype(np.int32), measured, start, flat


def components_of(nodes: int, edges: Int32[np.ndarray, "m 2"]) -> tuple[Int32[np.ndarray, "n"], int]:
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
