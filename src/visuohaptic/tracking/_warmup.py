"""Runs every kernel of this package once, on an image small enough to cost nothing."""

from __future__ import annotations

import numpy as np

__all__ = ["warmup"]


def warmup() -> None:
    """Follow a straight edge over a few frames: first search, warm start, and the sub-pixel fit."""
    from .contour import ContourTracker
    from .lines import ConstraintLines

    image = np.full((80, 160), 40, np.uint8)
    image[41:] = 160
    column = np.arange(20.0, 141.0, 8.0)
    count = len(column)
    lines = ConstraintLines(
        origin_px=np.column_stack([column, np.full(count, 60.0)]),
        direction_px=np.tile([0.0, -1.0], (count, 1)),
        start_px=np.full(count, 0.0),
        stop_px=np.full(count, 40.0),
        half_width_px=3.5,
    )
    tracker = ContourTracker()
    for _ in range(3):
        tracker.track(image, lines)
    _planar()


def _planar() -> None:
    """Align a small template, which compiles the kernels of the planar tracker."""
    from ..camera import Camera, Pose
    from .esm import align
    from .esm_template import EsmTemplate
    from .plane_pose import estimate_plane_poses

    y, x = np.mgrid[:64, :64]
    image = (128 + 60 * np.sin(x / 5.0) * np.cos(y / 7.0)).astype(np.uint8)
    template = EsmTemplate.from_image(image[8:56, 8:56].copy())
    align(template, image, np.array([[1, 0, 8.5], [0, 1, 7.5], [0, 0, 1.0]]))
    camera = Camera.simple(64, 64, 100.0)
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    pose = Pose(np.eye(3), np.array([0.0, 0.0, 5.0]))
    estimate_plane_poses(camera, square, camera.project(pose.apply(square)), np.eye(8), starts=(pose,))
