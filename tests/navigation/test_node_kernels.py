"""The fused steps of a node against the same steps one by one."""

from __future__ import annotations

import numpy as np

from visuohaptic.navigation.grid import window_distance
from visuohaptic.navigation.planning._joint_kernels import free_object
from visuohaptic.navigation.planning._node_kernels import clearance_without

from .random_maps import random_map


def test_clearance_without_an_object_is_that_of_the_window():
    rng = np.random.default_rng(11)
    for _ in range(200):
        grid = random_map(rng)
        rows, columns = grid.shape
        blocks = bool(rng.integers(2))
        centre = rng.random(2) * (columns, rows)
        outline = centre + rng.uniform(0.5, 4.0, 2) * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        r0, r1 = max(int(centre[1]) - 9, 0), min(int(centre[1]) + 10, rows)
        c0, c1 = max(int(centre[0]) - 9, 0), min(int(centre[0]) + 10, columns)
        i0, i1, j0, j1 = r0 + (r1 - r0) // 4, r1, c0, c1 - (c1 - c0) // 4
        part = grid.cells[r0:r1, c0:c1]
        occupied = (part >= 50) | ((part < 0) & blocks)
        free_object(occupied, outline, r0, c0)
        window = slice(r0, r1), slice(c0, c1)
        wanted = window_distance(occupied, window, grid.shape, outside_blocks=blocks)
        found = clearance_without(grid.cells, 50, blocks, outline, (r0, r1, c0, c1), (i0, i1, j0, j1))
        expected = wanted[i0 - r0 : i1 - r0, j0 - c0 : j1 - c0]
        np.testing.assert_allclose(found, expected, rtol=1e-5)
