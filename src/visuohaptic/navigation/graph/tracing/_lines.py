"""The lines of a skeleton, walked once and again only where something has changed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int32, UInt8

from ...grid.cost_grid import GridLayers

__all__ = ["RawGraph", "SkeletonLines", "speeds"]


def speeds(layers: GridLayers) -> Float[np.ndarray, "3"]:
    """Radius [m], and the reciprocals of the minimum and maximum speed [s/m], as kernels take them.

    Parameters
    ----------
    layers
        Of the map.
    """
    limits = layers.limits
    return np.array([limits.radius_m, 1.0 / limits.v_min_m_s, 1.0 / limits.v_max_m_s])


@dataclass(frozen=True, slots=True, eq=False)
class RawGraph:
    """All lines of a skeleton, junction cells that touch made one node. No later edit changes it.

    Symbols: n nodes, m edges.
    """

    cells: Int32[np.ndarray, "n"]  #: of the nodes (row * columns + column), ascending
    clearance_m: Float32[np.ndarray, "n"]
    ends: Int32[np.ndarray, "m 2"]
    measures: Float[np.ndarray, "m 3"]  #: length [m], cost [s], clearance [m]
    pieces: Int32[np.ndarray, "m 4"]  #: see ``_junction_kernels.join_lines``
    slot_cell: Int32[np.ndarray, "slots"]
    slot_parent: Int32[np.ndarray, "slots"]
    path: Int32[np.ndarray, "p"]  #: cells of all lines; nothing that was written is ever overwritten

    def paths(
        self, edge_start: Int32[np.ndarray, "e+1"], halves: Int32[np.ndarray, "w"]
    ) -> tuple[Int32[np.ndarray, "e+1"], Int32[np.ndarray, "p"]]:
        """Cells (flat) of edges that are made of half-edges of this graph, in CSR form.

        Parameters
        ----------
        edge_start, halves
            Half-edges of each edge in CSR form: 2 r for piece r, 2 r + 1 for it backwards.
        """
        from ._junction_kernels import edge_paths

        start, cells = edge_paths(
            edge_start, halves, self.pieces, self.slot_cell, self.slot_parent, self.path
        )
        return start, cells


class SkeletonLines:
    """Lines between the cells of a skeleton where lines meet or end.

    A whole build and an edit take the same steps: forget what touched cells are on, walk what is missing.

    Parameters
    ----------
    shape
        Rows and columns of the map.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self._place = np.zeros(shape, np.int32)
        self._cell = np.full(1024, -1, np.int32)
        self._masks = np.zeros(1024, np.uint8)
        self._keys = np.zeros(1024, np.float32)
        self._links = np.zeros((1024, 8), np.int32)
        self._order = np.empty(0, np.int32)
        self._table = np.empty((1024, 5), np.int32)
        self._measured = np.empty((1024, 3))
        self._path = np.empty(4096, np.int32)
        self._used = 0  # lines
        self._size = 0  # cells of ``_path``
        self._lost = 0  # of them, those of lines that are gone

    def follow(
        self, layers: GridLayers, mark: UInt8[np.ndarray, "rows columns"], touched: Int32[np.ndarray, "c"]
    ) -> RawGraph:
        """Bring the lines up to date and return their graph.

        Parameters
        ----------
        layers
            Of the map as it is now.
        mark
            Marks of its skeleton.
        touched
            All cells (flat, some twice) whose mark or distance changed, and those beside a changed mark; before the
            first call, all cells of the skeleton.
        """
        from ._junction_kernels import gather_junctions, join_lines
        from ._line_end_kernels import BITS, find_ends, forget_lines
        from ._line_kernels import find_lines, gather_paths

        scale = (layers.map.resolution_m, speeds(layers))
        distance = layers.distance_m
        maybe, near, lost = forget_lines(mark, self._place, self._cell, self._table, self._path, touched)
        self._lost += lost
        self._cell, self._masks, self._keys, self._links, self._order, look = find_ends(
            distance, mark, self._place, self._cell, self._masks, self._keys, self._links, self._order,
            np.sort(maybe), np.sort(near),
        )  # fmt: skip
        self._table, self._measured, self._path, self._used, self._size = find_lines(
            distance, mark, self._place, self._cell, self._masks, self._links, look, maybe,
            self._table, self._measured, self._path, self._used, self._size, *scale,
        )  # fmt: skip
        if 2 * self._lost > self._size + 65536:
            self._path, self._size = gather_paths(
                self._table, self._path, self._used, self._size - self._lost
            )
            self._lost = 0
        ends = (self._cell, self._masks, self._keys, self._links, self._order)
        widest = self._order[BITS[self._masks[self._order]] >= 3]
        widest = widest[np.argsort(-self._keys[widest], kind="stable")]
        owner, parent, to_leader = gather_junctions(*ends, widest, layers.shape[1], *scale)
        rings = np.flatnonzero(self._table[: self._used, 0] == -1)
        rings = rings[np.argsort(self._table[rings, 1])]
        cells, clearance_m, joined, measures, pieces = join_lines(
            distance, *ends, owner, parent, to_leader, self._table, self._measured, rings, *scale
        )
        return RawGraph(cells, clearance_m, joined, measures, pieces, self._cell.copy(), parent, self._path)
