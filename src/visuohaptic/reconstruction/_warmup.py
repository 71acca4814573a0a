"""Runs the kernels of fusion, detection and completion once."""

from __future__ import annotations

import numpy as np

__all__ = ["warmup"]


def warmup() -> None:
    """A few small views of a plane through both detectors and the fusion, and a small spline."""
    from ..camera import Camera
    from ..recording.depth_sequence import DepthFrame
    from ._hull_kernels import hull_distance, mask_through, seen_share, within_hull
    from .pipeline import reconstruct
    from .rbf import RbfSurface
    from .volume import SpaceGrid

    camera = Camera.simple(80, 60, 70.0)
    frames = []
    for index in range(30):
        pose = camera.pose_of_view((0.02 * index - 0.3, -0.8, 0.6), (0.02 * index - 0.3, 0.0, 0.0))
        rays = camera.rays(np.stack(np.meshgrid(np.arange(80.0), np.arange(60.0)), axis=-1))
        down = rays @ pose.rotation[2]
        depth_m = np.where(down < -0.05, -pose.translation_m[2] / np.minimum(down, -0.05), np.nan)
        frames.append(DepthFrame(index / 30, depth_m.astype(np.float32), None, pose, camera, index))
    grid = SpaceGrid(np.array([-0.4, -0.4, -0.1]), (16, 16, 8), 0.05)
    reconstruct(frames, grid=grid, method="published")
    reconstruct(frames, grid=grid, method="consistency")
    corners_m = np.array([[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)])
    surface = RbfSurface(corners_m, np.zeros(8))
    surface(corners_m)
    surface.on_grid(corners_m)
    surface.gradient(corners_m)
    rows = np.array([0, 59])
    planes = np.array([[0.0, 0.0, -1.0, 0.5], [0.0, 0.0, 1.0, -0.6]])
    numbers = (camera.matrix[0, 0], camera.matrix[1, 1], camera.matrix[0, 2], camera.matrix[1, 2])
    mask_through(frames[0].depth_m.copy(), planes, rows, rows, *numbers, 0.01)
    ways = np.eye(3)
    seen_share(np.zeros((2, 2, 2), dtype=bool), np.ones((1, 3)), np.eye(3)[:1].copy(), ways, np.empty(1))
    hull_distance(corners_m, np.ascontiguousarray(planes.T), np.empty(8))
    within_hull(corners_m, np.ascontiguousarray(planes.T), 0.0, np.empty(8, dtype=np.bool_))
