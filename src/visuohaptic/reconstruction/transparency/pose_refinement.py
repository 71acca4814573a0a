"""Fit the poses of a depth sequence to each other: all views at once, point to plane.

Small errors of the tracker contradict the model at every slanted surface, which the detector would take for glass.
Points of every view are laid on the planes that its neighbours see (:mod:`.view_selection`), robustly, and each pose
is held to the reported one as firmly as the tracker deserves it. All poses are solved for together (Gauss-Newton), so
that eight views around a table serve as well as eighty along a path.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ...core.camera.pose import Pose
from ...core.geometry import so3_log
from ...core.resources import one_blas_thread
from ...io.depth.depth_sequence import DepthFrame
from ..fusion.depth_noise import SENSOR_NOISE, DepthNoise
from .background import ideal_depth, intrinsics
from .view_selection import view_graph

__all__ = ["common_sigma_m", "refine_poses"]

#: Neighbours that each view is compared with.
_NEIGHBOURS = 6
#: Points of all views together that are laid on each neighbour, and of one view at least.
_ALL_POINTS, _POINTS = 24_000, 500
#: Residuals of neighbouring points are not independent: one in this number counts.
_CORRELATED = 2.0
#: Deviation that even the best depth has [m].
_LEAST_M = 5e-4
#: Steps of the solution at most, each looks the matching points up anew; the motion that ends it [m] or [rad].
_STEPS, _STILL = 12, 5e-5


def _surface(frame: DepthFrame, count: int) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "n 3"]]:
    """Normals of a view in the frame of its camera, NaN where there is no smooth surface, and some points that have one [m]."""
    depth_m = ideal_depth(frame).astype(np.float64)
    height, width = depth_m.shape
    matrix = frame.camera.matrix
    v, u = np.mgrid[:height, :width]
    rays = np.stack(
        [(u - matrix[0, 2]) / matrix[0, 0], (v - matrix[1, 2]) / matrix[1, 1], np.ones_like(u)], axis=-1
    )
    points = rays * depth_m[..., None]
    right, down = np.full_like(points, np.nan), np.full_like(points, np.nan)
    right[:, 2:-2] = points[:, 4:] - points[:, :-4]
    down[2:-2] = points[4:] - points[:-4]
    normals = np.cross(right, down)
    with np.errstate(invalid="ignore", divide="ignore"):
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        # A step of a tenth of the depth over four pixels is an edge.
        rough = (np.abs(right[..., 2]) > 0.1 * depth_m) | (np.abs(down[..., 2]) > 0.1 * depth_m)
    normals[rough] = np.nan
    good = np.flatnonzero((np.isfinite(normals[..., 0]) & (depth_m > 0)).ravel())
    spread = good[np.linspace(0, len(good) - 1, min(count, len(good))).astype(int)] if len(good) else good
    return normals.astype(np.float32), points.reshape(-1, 3)[spread]


@one_blas_thread()
def refine_poses(
    frames: Sequence[DepthFrame],
    noise: DepthNoise = SENSOR_NOISE["kinect"],
    *,
    sigma_m: float = 0.005,
    sigma_rad: float = math.radians(0.3),
) -> list[DepthFrame]:
    """Frames with better poses, in the same order.

    Parameters
    ----------
    frames
        Views of one camera.
    noise
        Of the camera; its tracking part is not used here.
    sigma_m, sigma_rad
        Standard deviation of the reported poses, per axis [m], [rad].
    """
    from ._background_kernels import plane_equations

    count = len(frames)
    if count < 2:
        return list(frames)
    graph = view_graph(frames)
    pairs = sorted(
        {(i, k) for i in range(count) for k in graph.neighbours(i, _NEIGHBOURS)}
        | {(k, i) for i in range(count) for k in graph.neighbours(i, _NEIGHBOURS)}
    )
    normals, points = zip(*(_surface(one, max(_POINTS, _ALL_POINTS // count)) for one in frames), strict=True)
    planes = np.stack([ideal_depth(frame) for frame in frames]), np.stack(normals)
    firsts = np.cumsum([0, *(len(chosen) for chosen in points)])
    places = np.array(pairs, np.int64).reshape(-1, 2), np.concatenate(points), firsts
    camera = [float(value) for value in intrinsics(frames[0].camera)]
    numbers = noise.quadratic_per_m, noise.constant_m, noise.offset_m, _LEAST_M, _CORRELATED
    squares, pulls = np.empty((len(pairs), 6, 6)), np.empty((len(pairs), 6))
    measured = [frame.T_world_camera for frame in frames]
    poses = list(measured)
    stiffness = np.repeat([1 / sigma_rad**2, 1 / sigma_m**2], 3)
    for step in range(_STEPS):
        # Far matches help a poor start and spoil a good one.
        reach_m = 4 * sigma_m * max(0.25, 0.6**step)
        matrix, right = np.zeros((count, 6, count, 6)), np.zeros((count, 6))
        present = np.array([pose.matrix[:3] for pose in poses])
        plane_equations(*places, present, *planes, *camera, reach_m, *numbers, squares, pulls)
        for (i, k), square, pull in zip(pairs, squares, pulls, strict=True):
            # A motion of the view i in the world moves its points, one of k its planes.
            matrix[i, :, i] += square
            matrix[k, :, k] += square
            matrix[i, :, k] -= square
            matrix[k, :, i] -= square
            right[i] -= pull
            right[k] += pull
        for i in range(count):
            to_measured, local = _offset(poses[i], measured[i])
            matrix[i, :, i] += local.T @ (stiffness[:, None] * local)
            right[i] -= local.T @ (stiffness * to_measured)
        moved = np.linalg.solve(matrix.reshape(6 * count, -1), right.ravel()).reshape(count, 6)
        poses = [Pose.from_rotation_vector(x[:3], x[3:]) @ pose for x, pose in zip(moved, poses, strict=True)]
        if step > 4 and np.abs(moved).max() < _STILL:
            break
    return [replace(frame, T_world_camera=pose) for frame, pose in zip(frames, poses, strict=True)]


def common_sigma_m(
    reported: Sequence[DepthFrame], refined: Sequence[DepthFrame], point_m: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Standard deviation of where all views together see a point [m].

    Poses that are fitted to each other keep the mean of the reported ones, whose errors the fit shows.

    Parameters
    ----------
    reported, refined
        The same views before and after :func:`refine_poses`, at least two.
    point_m
        Point (3) of the world [m].
    """
    shifts = [
        after.T_world_camera.apply(before.T_world_camera.inverse().apply(point_m))
        for before, after in zip(reported, refined, strict=True)
    ]
    found: Float[np.ndarray, "3"] = np.std(shifts, axis=0, ddof=1) / math.sqrt(len(shifts))
    return found


def _offset(pose: Pose, measured: Pose) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6 6"]]:
    """Turn [rad] and shift of the eye [m] of a pose from the measured one, and how a motion in the world changes it."""
    away = np.concatenate(
        [so3_log(pose.rotation @ measured.rotation.T), pose.translation_m - measured.translation_m]
    )
    local = np.eye(6)
    local[3:, :3] = -_cross_matrix(pose.translation_m)
    return away, local


def _cross_matrix(v: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
