"""Fit the poses of a depth sequence to each other, against what neighbouring views show.

Small errors of the tracker contradict the model at every slanted surface, which
the detector would take for glass. Each view is aligned point to plane with the
mean of its neighbours, robustly, and held to its own reported pose as firmly as the
tracker deserves it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ...core.camera.pose import Pose
from ...core.geometry import so3_log
from ...io.depth.depth_sequence import DepthFrame
from ..fusion.depth_noise import SENSOR_NOISE, DepthNoise
from .background import background_model, ideal_depth
from .view_selection import nearest_on_both_sides, signed_baselines

__all__ = ["alignment_step", "refine_poses"]

#: Neighbours of a view on each side, by rank: near enough to see the same, more than one for a mean.
_RANKS = (1, 2, 3, 5)
#: Residuals of neighbouring pixels are not independent: one in so many counts.
_SHARED = 40.0


def refine_poses(
    frames: Sequence[DepthFrame],
    noise: DepthNoise = SENSOR_NOISE["kinect"],
    *,
    sigma_m: float = 0.005,
    sigma_rad: float = math.radians(0.2),
    sweeps: int = 2,
    step_px: int = 4,
) -> list[DepthFrame]:
    """Frames with better poses.

    Parameters
    ----------
    frames
        Views of one camera along its way.
    noise
        Of the camera; its tracking part is not used here.
    sigma_m, sigma_rad
        Standard deviation of the reported poses, per axis [m], [rad].
    sweeps
        Rounds over the sequence.
    step_px
        Every so many pixels give a point.
    """
    measured = [frame.T_world_camera for frame in frames]
    poses = list(measured)
    model_noise = noise.with_tracking(0.01)
    around = [
        nearest_on_both_sides(signed_baselines(measured, i), _RANKS, index=i) for i in range(len(measured))
    ]
    for _ in range(sweeps if len(frames) >= 4 else 0):
        for i, frame in enumerate(frames):
            near = around[i]
            others = [replace(frames[k], T_world_camera=poses[k]) for k in near]
            if len(others) < 3:
                continue
            model = background_model(others, poses[i], model_noise, min_views=3, erosion_px=1)
            target = np.where(model.reliability > 0.7, model.mean_m, np.nan)
            prior = poses[i].inverse() @ measured[i]
            motion = alignment_step(
                ideal_depth(frame), target, frame.camera.matrix, prior, noise, sigma_m, sigma_rad, step_px
            )
            poses[i] = poses[i] @ motion
    poses = _anchored(poses, measured)
    return [replace(frame, T_world_camera=pose) for frame, pose in zip(frames, poses, strict=True)]


def _anchored(poses: Sequence[Pose], measured: Sequence[Pose]) -> list[Pose]:
    """Fitted poses, moved as one body onto the measured ones.

    Views say where they are to each other, not to the world. The expected surface is the nearest of
    what falls into a pixel, a part of a pixel too near: without this all views would back off together.
    """
    away = [there @ here.inverse() for here, there in zip(poses, measured, strict=True)]
    turn = np.mean([so3_log(pose.rotation) for pose in away], axis=0)
    back = Pose.from_rotation_vector(turn, np.mean([pose.translation_m for pose in away], axis=0))
    return [back @ pose for pose in poses]


def alignment_step(
    depth_m: Float[np.ndarray, "h w"],
    target_m: Float[np.ndarray, "h w"],
    matrix: Float[np.ndarray, "3 3"],
    prior: Pose,
    noise: DepthNoise,
    sigma_m: float,
    sigma_rad: float,
    step_px: int = 4,
) -> Pose:
    """Motion ``T_target_view`` that lays a depth image on an expected one, by robust Gauss-Newton steps.

    Points are matched along their pixel's ray and measured along the normal of
    the expected surface; ``prior`` is the measured motion.

    Parameters
    ----------
    depth_m
        Depth image to be moved (h, w) [m].
    target_m
        Expected depth image (h, w) [m].
    matrix
        Camera matrix (3, 3) [px].
    prior
        Measured motion ``T_target_view``.
    noise
        Noise of the camera.
    sigma_m, sigma_rad
        Standard deviation of the measured motion, position [m] and rotation [rad].
    step_px
        Every how many pixels a point is used.
    """
    rows, columns = np.mgrid[2 : depth_m.shape[0] - 2 : step_px, 2 : depth_m.shape[1] - 2 : step_px]
    fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]

    def points(depth: Float[np.ndarray, "h w"], row: np.ndarray, column: np.ndarray) -> np.ndarray:
        z = depth[row, column].astype(np.float64)
        return np.stack([(column - cx) / fx * z, (row - cy) / fy * z, z], axis=-1)

    here, there = points(depth_m, rows, columns), points(target_m, rows, columns)
    right = points(target_m, rows, columns + 2) - points(target_m, rows, columns - 2)
    down = points(target_m, rows + 2, columns) - points(target_m, rows - 2, columns)
    normals = np.cross(right, down)
    with np.errstate(invalid="ignore"):
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        z = there[..., 2]
        smooth = (np.abs(right[..., 2]) < 0.1 * z) & (np.abs(down[..., 2]) < 0.1 * z)
        usable = smooth & np.isfinite(normals).all(axis=-1) & (np.abs(here[..., 2] - z) < 0.08)
    p, q, n = here[usable], there[usable], normals[usable]
    if len(p) < 200:
        return Pose.identity()
    spread = (
        noise.sigma_m(q[:, 2]) if noise.tracking_m < 0.002 else noise.with_tracking(0.002).sigma_m(q[:, 2])
    )
    vector = np.zeros(6)
    measured = np.concatenate([so3_log(prior.rotation), prior.translation_m])
    stiffness = np.repeat([1 / sigma_rad**2, 1 / sigma_m**2], 3)
    for _ in range(3):
        motion = Pose.from_rotation_vector(vector[:3], vector[3:])
        moved = motion.apply(p)
        residual = ((moved - q) * n).sum(axis=1) / spread
        weight = np.minimum(1.0, 1.5 / np.maximum(np.abs(residual), 1e-9)) / _SHARED
        weight[np.abs(residual) > 12] = 0.0
        jacobian = np.concatenate([np.cross(moved, n), n], axis=1) / spread[:, None]
        normal = (jacobian * weight[:, None]).T @ jacobian + np.diag(stiffness)
        right_side = -(jacobian * weight[:, None]).T @ residual - stiffness * (vector - measured)
        step = np.linalg.solve(normal, right_side)
        turned = Pose.from_rotation_vector(step[:3], step[3:]) @ motion
        vector = np.concatenate([so3_log(turned.rotation), turned.translation_m])
    return Pose.from_rotation_vector(vector[:3], vector[3:])
