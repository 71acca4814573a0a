"""The lines of a skeleton, and the graph that they form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int32, UInt8

from ...grid.cost_grid import GridLayers
from ._junction_kernels import edge_paths, gather_junctions, join_lines
from ._line_kernels import BITS, find_ends, find_lines


def speeds(layers: GridLayers) -> Float[np.ndarray, "3"]:
    """Radius [m], and the reciprocals of the minimum and maximum speed [s/m], in the format of the kernels.

    Parameters
    ----------
    layers
        Layers of the map.
    """
    limits = layers.limits
    return np.array([limits.radius_m, 1.0 / limits.v_min_m_s, 1.0 / limits.v_max_m_s])


@dataclass(frozen=True, slots=True, eq=False)
class RawGraph:
    """All lines of a skeleton, with adjacent junction cells merged into one node.

    Symbols: n nodes, m edges.
    """

    cells: Int32[np.ndarray, "n"]  #: of the nodes (row * columns + column), ascending
    clearance_m: Float32[np.ndarray, "n"]
    ends: Int32[np.ndarray, "m 2"]
    measures: Float[np.ndarray, "m 3"]  #: length [m], cost [s], clearance [m]
    pieces: Int32[np.ndarray, "m 4"]  #: see ``_junction_kernels.join_lines``
    slot_cell: Int32[np.ndarray, "slots"]
    slot_parent: Int32[np.ndarray, "slots"]
    path: Int32[np.ndarray, "p"]  #: cells of all lines

    def paths(
        self, edge_start: Int32[np.ndarray, "e+1"], halves: Int32[np.ndarray, "w"]
    ) -> tuple[Int32[np.ndarray, "e+1"], Int32[np.ndarray, "p"]]:
        """Cells (flat) of edges that consist of half-edges of this graph, in CSR form.

        Parameters
        ----------
        edge_start, halves
            Half-edges of each edge in CSR form: 2 r for piece r, 2 r + 1 for the reversed piece.
        """

        start, cells, size = edge_paths(
            edge_start, halves, self.pieces, self.slot_cell, self.slot_parent, self.path
        )
        return start, cells[:size].copy()


def skeleton_lines(layers: GridLayers, mark: UInt8[np.ndarray, "rows columns"]) -> RawGraph:
    """Lines between the junction and end cells of a skeleton, and the graph that they form.

    Parameters
    ----------
    layers
        Layers of the map.
    mark
        1 on the skeleton.
    """

    scale = (layers.map.resolution_m, speeds(layers))
    distance, place = layers.distance_m, np.zeros(layers.shape, np.int32)
    cells = np.flatnonzero(mark.view(np.bool_)).astype(np.int32)
    cell, masks, count = find_ends(mark, cells, place)
    cell, masks = cell[:count].copy(), masks[:count].copy()
    table, measured, path, links, lines, size = find_lines(distance, mark, place, cell, masks, cells, *scale)
    table, measured, path = table[:lines].copy(), measured[:lines].copy(), path[:size].copy()
    keys = distance.ravel()[cell]
    ends = (cell, masks, keys, links)
    widest = np.flatnonzero(BITS[masks] >= 3)
    widest = widest[np.argsort(-keys[widest], kind="stable")]
    owner, parent, to_leader = gather_junctions(*ends, widest, layers.shape[1], *scale)
    rings = np.flatnonzero(table[:, 0] == -1)
    rings = rings[np.argsort(table[rings, 1])]
    nodes, clearance_m, joined, measures, pieces, n, m = join_lines(
        distance, *ends, owner, parent, to_leader, table, measured, rings, *scale
    )
    kept = joined[:m].copy(), measures[:m].copy(), pieces[:m].copy()
    return RawGraph(nodes[:n].copy(), clearance_m[:n].copy(), *kept, cell, parent, path)
