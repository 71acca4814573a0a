"""Depth views of the plane z = 0, in closed form."""

from __future__ import annotations

import numpy as np

from visuohaptic.core.camera import Camera, Pose
from visuohaptic.io.depth import DepthFrame

CAMERA = Camera.simple(64, 48, 60.0)


def plane_frame(pose: Pose, rng: np.random.Generator | None = None, sigma_m: float = 0.0) -> DepthFrame:
    """The plane, with white noise of the depth."""
    rows, columns = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    rays = CAMERA.rays(np.stack([columns, rows], axis=-1).astype(float)) @ pose.rotation.T
    depth_m = -pose.translation_m[2] / rays[..., 2]
    if rng is not None:
        depth_m = depth_m + sigma_m * rng.standard_normal(depth_m.shape)
    return DepthFrame(0.0, depth_m.astype(np.float32), None, pose, CAMERA)


def looking_down(x: float) -> Pose:
    return Camera.pose_of_view((x, -0.6, 0.8), (x, 0.0, 0.0))
