"""The navigation graph: one node per decision, one edge per path between them (Alt 2016, Sec. 4.2 e)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int, Int32

from ...core.ranges import NON_NEGATIVE, check_numbers
from ..grid.cost_grid import GridLayers
from .tracing._lines import Lines, components_of, measures, skeleton_lines, without_stubs
from .tracing.skeletonize import skeleton


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
    #: (row, column) of each edge's cells, from its first node to its second
    path_cells: Int32[np.ndarray, "p 2"]
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
    lines = without_stubs(layers, skeleton_lines(layers, skeleton(layers)), stub_length_m)
    if spacing_m:
        lines = _spaced(layers, lines, spacing_m)
    measured = measures(layers, lines)
    component, components = components_of(len(lines.cells), lines.ends)
    node_cells, path_cells = (
        np.column_stack(np.divmod(cells, layers.shape[1])).astype(np.int32)
        for cells in (lines.cells, lines.path)
    )
    length_m, cost_s, clearance_m = np.ascontiguousarray(measured.T)
    return NavigationGraph(
        node_cells, layers.map.world_from_cell(node_cells), lines.ends.astype(np.int32), cost_s, length_m, clearance_m,
        lines.start.astype(np.int32), path_cells, component, components,
    )  # fmt: skip


def _spaced(layers: GridLayers, lines: Lines, spacing_m: float) -> Lines:
    """Divide long edges into pieces of equal length, as near to ``spacing_m`` as an integer number of pieces allows."""

    taken = set(lines.cells.tolist())
    pieces = []
    for edge, length_m in enumerate(measures(layers, lines)[:, 0].tolist()):
        cells = lines.path[lines.start[edge] : lines.start[edge + 1]]
        # At most one piece per cell, which bounds the work for tiny spacings.
        most = len(cells) - 1
        count = most if length_m >= most * spacing_m else round(length_m / spacing_m)
        cuts = [0]
        if count > 1:
            rows, columns = np.divmod(cells, layers.shape[1])
            along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(rows), np.diff(columns)))])
            for k in range(1, count):
                cut = int(np.searchsorted(along, along[-1] * k / count))
                # Paths with common cells inside a junction have no common node there.
                if cuts[-1] < cut < len(cells) - 1 and int(cells[cut]) not in taken:
                    taken.add(int(cells[cut]))
                    cuts.append(cut)
        cuts.append(len(cells) - 1)
        pieces += [cells[a : b + 1] for a, b in pairwise(cuts)]
    nodes = np.array(sorted(taken), dtype=np.int64)
    turned = [piece if piece[0] <= piece[-1] else piece[::-1] for piece in pieces]
    turned.sort(key=lambda piece: (piece[0], piece[-1]))
    ends = np.array([(piece[0], piece[-1]) for piece in turned], dtype=np.int64).reshape(-1, 2)
    start = np.cumsum([0, *map(len, turned)])
    return Lines(nodes, np.searchsorted(nodes, ends), start, np.concatenate([lines.path[:0], *turned]))
