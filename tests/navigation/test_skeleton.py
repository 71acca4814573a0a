"""The skeleton compared with a plain implementation that deletes cell by cell, and its topology with labels."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.ndimage import label

from visuohaptic.navigation.graph.tracing import skeleton
from visuohaptic.navigation.graph.tracing._lines import Lines, measures
from visuohaptic.navigation.graph.tracing._skeleton_kernels import _adjacent, _deletable
from visuohaptic.navigation.grid import SpeedLimits, grid_layers

from .random_maps import RADII_M, random_map, topology

EIGHT, FOUR = np.ones((3, 3)), np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]])


def is_simple(near: np.ndarray) -> bool:
    """Whether deleting the middle of 3 x 3 cells keeps components and holes: by definition."""
    set_parts = near.copy()
    set_parts[1, 1] = False
    one_part = label(set_parts, EIGHT)[1] == 1
    gaps = ~near
    # Gaps that touch the middle by a side, connected inside the 3 x 3 cells by sides.
    parts = label(gaps, FOUR)[0]
    beside = {parts[0, 1], parts[1, 0], parts[1, 2], parts[2, 1]} - {0}
    return one_part and len(beside) == 1


def plain_skeleton(distance: np.ndarray, reachable: np.ndarray) -> np.ndarray:
    """Delete cell after cell in the order of (distance, index), in one pass."""
    kept = np.pad(reachable, 1)
    for cell in np.lexsort((np.arange(distance.size), distance.ravel())):
        row, column = divmod(int(cell), distance.shape[1])
        near = kept[row : row + 3, column : column + 3]
        if near[1, 1] and near.sum() > 2 and is_simple(near):
            kept[row + 1, column + 1] = False
    return kept[1:-1, 1:-1]


def test_the_kernel_finds_the_skeleton_of_plain_sequential_deletion():
    rng = np.random.default_rng(1)
    for _ in range(60):
        layers = grid_layers(random_map(rng, 24), SpeedLimits(float(rng.choice(RADII_M))))
        truth = plain_skeleton(layers.distance_m, layers.reachable)
        np.testing.assert_array_equal(skeleton(layers), truth)


def test_components_and_holes_are_kept():
    rng = np.random.default_rng(2)
    for _ in range(300):
        layers = grid_layers(random_map(rng), SpeedLimits(float(rng.choice(RADII_M))))
        assert topology(skeleton(layers)) == topology(layers.reachable)


def test_links_make_the_euler_number_of_any_set():
    adjacent = _adjacent()
    rng = np.random.default_rng(3)
    for density in (0.1, 0.3, 0.5, 0.7, 0.9, 1.0):
        for _ in range(20):
            cells = rng.random((12, 15)) < density
            padded = np.pad(cells, 1)
            weights = np.array([[32, 64, 128], [16, 0, 1], [8, 4, 2]])
            ends = 0
            for row, column in np.argwhere(cells):
                near = padded[row : row + 3, column : column + 3]
                ends += int(adjacent[int((near * weights).sum())]).bit_count()
            components, holes = topology(cells)
            assert ends % 2 == 0  # every link is seen from both sides
            assert cells.sum() - ends // 2 == components - holes


def test_lines_are_measured_like_a_walk_from_cell_to_cell():
    """Three walks over random steps, one after the other in the same array; each is added up on its own."""
    rng = np.random.default_rng(4)
    layers = grid_layers(random_map(rng, 24), SpeedLimits(0.2))
    rows, columns = layers.shape
    walks = []
    for count in (2, 5, 9):
        walk = [(rows // 2, columns // 2)]
        for _ in range(count - 1):
            step = [(0, 1), (1, 0), (1, 1), (-1, 1), (0, -1)][rng.integers(5)]
            walk.append((walk[-1][0] + step[0], walk[-1][1] + step[1]))
        walks.append(walk)
    path = np.array([row * columns + column for walk in walks for row, column in walk])
    start = np.array([0, 2, 7, 16])
    found = measures(layers, Lines(path[[0]], np.zeros((3, 2), np.int64), start, path))
    for walk, (length_m, time_s, clearance_m) in zip(walks, found, strict=True):
        away = [float(layers.distance_m[cell]) for cell in walk]
        slow = [float(layers.limits.cost_s_per_m(np.maximum(each, layers.radius_m))) for each in away]
        steps = [
            layers.map.resolution_m * ((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2) ** 0.5
            for a, b in pairwise(walk)
        ]
        np.testing.assert_allclose(length_m, sum(steps), rtol=1e-5)
        taken = sum(0.5 * (slow[k] + slow[k + 1]) * step for k, step in enumerate(steps))
        np.testing.assert_allclose(time_s, taken, rtol=1e-5)
        np.testing.assert_allclose(clearance_m, min(away), rtol=1e-6)


def test_cells_are_deleted_where_they_are_simple_and_no_end():
    """By the definition, for each of the 256 surroundings of a cell."""
    around = [(1, 2), (2, 2), (2, 1), (2, 0), (1, 0), (0, 0), (0, 1), (0, 2)]
    deletable = _deletable()
    for mask in range(256):
        near = np.zeros((3, 3), dtype=bool)
        near[1, 1] = True
        for k, cell in enumerate(around):
            near[cell] = bool(mask >> k & 1)
        assert deletable[mask] == (near.sum() > 2 and is_simple(near)), mask
