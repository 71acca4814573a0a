"""Runs the kernels of the primitives and of the obstacle mask once."""

from __future__ import annotations

import numpy as np

__all__ = ["warmup"]


def warmup() -> None:
    """Fit all primitives to the impression of a cylinder."""
    from .obstacle_mask import FloorMixture
    from .primitives import fit_primitive

    radius_m, depth_m = 0.06, 0.006
    s_m = np.linspace(-0.06, 0.06, 41)
    delta_m = np.maximum(depth_m - radius_m + np.sqrt(np.maximum(radius_m**2 - s_m**2, 0.0)), 1e-5)
    points_m = np.column_stack([0.04 - delta_m, s_m])
    fit_primitive(points_m, np.full(len(s_m), 1e-5), delta_m=delta_m)
    for shape in ((8, 16), (8, 16, 3)):
        FloorMixture().update(np.full(shape, 100, np.uint8))
    _object()


def _object() -> None:
    """Fit the motion of a square that stands still before a camera."""
    from ..camera import Camera
    from ..tracking.plane_pose import lens_numbers
    from ._object_kernels import fit_motion

    camera = Camera.simple(64, 64, 100.0)
    body = np.array([[-1.0, -1, 5], [1, -1, 5], [1, 1, 5], [-1, 1, 5]])
    fit_motion(
        body, camera.project(body), np.ones(4), np.zeros(3), np.eye(3), np.zeros(3), lens_numbers(camera), 4.0, 4,
        np.ones(6, dtype=bool), np.eye(3), np.zeros(3), np.zeros(4), np.zeros((6, 6)),
    )  # fmt: skip
