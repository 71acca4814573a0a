"""The lines of a skeleton, walked once and again only where something has changed."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int32, UInt8

from .grid import GridLayers

__all__ = ["SkeletonLines"]


class SkeletonLines:
    """Lines between the cells of a skeleton where lines meet or end.

    A whole build and an edit take the same way: forget what touched cells are on, walk what is missing.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self._place = np.zeros(shape, np.int32)
        self._special = np.empty(0, np.int32)
        self._masks = np.empty(0, np.uint8)
        self._table = np.empty((1024, 4), np.int32)
        self._measured = np.empty((1024, 3))
        self._path = np.empty(4096, np.int32)
        self._used = 0
        self._size = 0
        self._after_cleaning = 0

    def follow(
        self, layers: GridLayers, mark: UInt8[np.ndarray, "rows columns"], touched: Int32[np.ndarray, "c"]
    ) -> tuple[np.ndarray, ...]:
        """Bring the lines up to date and return their graph, see ``_graph_kernels.join_lines``.

        ``touched`` (flat, some twice) are all cells whose mark or distance changed, and those beside a
        changed mark; before the first call, all cells of the skeleton.
        """
        from ._graph_kernels import compact_lines, find_lines, find_specials, forget_lines, join_lines

        limits = layers.limits
        speeds = np.array([limits.radius_m, 1.0 / limits.v_min_m_s, 1.0 / limits.v_max_m_s])
        resolution_m = layers.map.resolution_m
        maybe = forget_lines(mark, self._place, self._table, self._path, touched)
        self._special, self._masks = find_specials(mark, self._place, self._special, self._masks, maybe)
        if self._size > 2 * self._after_cleaning + 65536:
            self._used, self._size = compact_lines(
                self._place, self._table, self._measured, self._path, self._used
            )
            self._after_cleaning = self._size
        lines = (self._place, self._special, self._masks)
        self._table, self._measured, self._path, self._used, self._size = find_lines(
            layers.distance_m,
            mark,
            *lines,
            maybe,
            self._table,
            self._measured,
            self._path,
            self._used,
            self._size,
            resolution_m,
            speeds,
        )
        found: tuple[np.ndarray, ...] = join_lines(
            layers.distance_m,
            *lines,
            self._table,
            self._measured,
            self._path,
            self._used,
            self._size,
            resolution_m,
            speeds,
        )
        return found
