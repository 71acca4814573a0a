"""Paths through maps, drifting odometry, and comparison of maps: shared by tests and benchmarks."""

from __future__ import annotations

import itertools

import numpy as np
from scipy import ndimage

from visuohaptic.io.maps import OccupancyMap


def smooth_way(grid: OccupancyMap, corners_m: list[tuple[float, float]], step_m: float = 0.08) -> np.ndarray:
    """Poses (x, y, yaw) on a path through corners, away from the walls."""
    from skimage.graph import route_through_array

    clear = ndimage.distance_transform_edt(grid.cells == 0) * grid.resolution_m
    cost = np.where(clear > 0.2, 1.0 + 1.0 / (clear + 0.05) ** 2, -1.0)
    parts, _ = ndimage.label(clear > 0.2, np.ones((3, 3)))
    inner = np.argwhere((clear > 0.3) & (parts == np.bincount(parts[parts > 0]).argmax()))
    cells = [
        inner[np.abs(inner - cell).sum(axis=1).argmin()] for cell in grid.cell_from_world(np.array(corners_m))
    ]
    path: list[tuple[int, int]] = []
    for start, goal in itertools.pairwise(cells):
        leg, _ = route_through_array(cost, tuple(start), tuple(goal))
        path += leg[1:]
    way = grid.world_from_cell(np.array(path))
    way = np.column_stack([ndimage.uniform_filter1d(way[:, axis], 15, mode="nearest") for axis in (0, 1)])
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    at = np.arange(0.0, length[-1], step_m)
    way = np.column_stack([np.interp(at, length, way[:, axis]) for axis in (0, 1)])
    heading = np.gradient(way, axis=0)
    yaw = ndimage.uniform_filter1d(np.unwrap(np.arctan2(heading[:, 1], heading[:, 0])), 15, mode="nearest")
    return np.column_stack([way, yaw])


def drifted(
    poses: np.ndarray, rng: np.random.Generator, scale: float = 1.02, bias_rad_per_m: float = 0.01
) -> np.ndarray:
    """Odometry: a wrong wheel radius, a bias to one side, and noise of two per cent."""
    found = [poses[0]]
    for before, after in itertools.pairwise(poses):
        dx, dy = after[:2] - before[:2]
        c, s = np.cos(before[2]), np.sin(before[2])
        way = float(np.hypot(dx, dy))
        ahead = scale * (c * dx + s * dy) + 0.02 * way * rng.standard_normal()
        left = c * dy - s * dx
        turn = 1.02 * (after[2] - before[2]) + bias_rad_per_m * way + 0.01 * way * rng.standard_normal()
        x, y, yaw = found[-1]
        c, s = np.cos(yaw), np.sin(yaw)
        found.append(np.array([x + c * ahead - s * left, y + s * ahead + c * left, yaw + turn]))
    return np.array(found)


def agreement(built: OccupancyMap, truth: OccupancyMap) -> dict[str, float]:
    """IoU of free space where the built map is known, and of walls to within a cell."""
    rows, columns = np.indices(built.shape)
    true = truth.value_at(built.world_from_cell(np.stack([rows, columns], axis=-1)))
    near = np.ones((3, 3), bool)
    wall, true_wall = built.occupied, true >= 50
    known = ~built.unknown
    free, true_free = built.free, (true == 0) & known
    hit = (wall & ndimage.binary_dilation(true_wall, near)).sum()
    return {
        "free_iou": float((free & true_free).sum() / max((free | true_free).sum(), 1)),
        "wall_precision": float(hit / max(wall.sum(), 1)),
    }
