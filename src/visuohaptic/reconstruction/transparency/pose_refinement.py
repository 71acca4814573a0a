"""Fit the poses of a depth sequence to each other: all views at once, point to plane.

Small errors of the tracker contradict the model at every slanted surface, which the detector would take for glass.
Points of every view are laid on the planes that its neighbours see (:mod:`.view_selection`), robustly, and each pose
is held to the reported one as firmly as the tracker deserves it. All poses are solved for together (Gauss-Newton), so
that eight views around a table serve as well as eighty along a path.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ...core.camera.pose import Pose
from ...core.geometry import so3_log
from ...core.resources import one_blas_thread
from ...io.depth.depth_sequence import DepthFrame
from ..fusion.depth_noise import SENSOR_NOISE, DepthNoise
from .background import ideal_depth
from .view_selection import view_graph

__all__ = ["common_sigma_m", "refine_poses"]

#: Neighbours that each view is compared with.
_NEIGHBOURS = 6
#: Points of all views together that are laid on each neighbour, and of one view at least.
_ALL_POINTS, _POINTS = 24_000, 500
#: Residuals of neighbouring points are not independent: one in this number counts.
_CORRELATED = 2.0
#: Steps of the solution at most, each looks the matching points up anew; the motion that ends it [m] or [rad].
_STEPS, _STILL = 12, 5e-5


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """One view as points and planes in the frame of its camera."""

    points_m: Float[np.ndarray, "h w 3"]
    normals: Float[np.ndarray, "h w 3"]  #: NaN where there is no smooth surface
    chosen: Float[np.ndarray, "n 3"]  #: some of the points that have a normal [m]


def _surface(frame: DepthFrame, count: int) -> _Surface:
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
    return _Surface(points, normals, points.reshape(-1, 3)[spread])


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
    count = len(frames)
    if count < 2:
        return list(frames)
    graph = view_graph(frames)
    pairs = sorted(
        {(i, k) for i in range(count) for k in graph.neighbours(i, _NEIGHBOURS)}
        | {(k, i) for i in range(count) for k in graph.neighbours(i, _NEIGHBOURS)}
    )
    views = [_surface(frame, max(_POINTS, _ALL_POINTS // count)) for frame in frames]
    measured = [frame.T_world_camera for frame in frames]
    poses = list(measured)
    device = noise.with_tracking(0.0)
    stiffness = np.repeat([1 / sigma_rad**2, 1 / sigma_m**2], 3)
    for step in range(_STEPS):
        # Far matches help a poor start and spoil a good one.
        reach_m = 4 * sigma_m * max(0.25, 0.6**step)
        matrix, right = np.zeros((count, 6, count, 6)), np.zeros((count, 6))
        for i, k in pairs:
            # A motion of the view i in the world moves its points, one of k its planes.
            rows, residual = _equations(views[i], views[k], poses[i], poses[k], frames[k], device, reach_m)
            square, pull = rows.T @ rows, rows.T @ residual
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


def _equations(
    here: _Surface,
    there: _Surface,
    pose: Pose,
    other: Pose,
    frame: DepthFrame,
    noise: DepthNoise,
    reach_m: float,
) -> tuple[Float[np.ndarray, "n 6"], Float[np.ndarray, "n"]]:
    """Weighted rows of the derivative by a motion of the points in the world, and weighted residuals."""
    world = pose.apply(here.chosen)
    local = other.inverse().apply(world)
    matrix = frame.camera.matrix
    z = np.maximum(local[:, 2], 1e-3)
    u = np.rint(matrix[0, 0] * local[:, 0] / z + matrix[0, 2]).astype(int)
    v = np.rint(matrix[1, 1] * local[:, 1] / z + matrix[1, 2]).astype(int)
    height, width = there.normals.shape[:2]
    held = (local[:, 2] > 0.05) & (u >= 0) & (v >= 0) & (u < width) & (v < height)
    local, world, u, v = local[held], world[held], u[held], v[held]
    normal = there.normals[v, u]
    residual = ((local - there.points_m[v, u]) * normal).sum(axis=1)
    with np.errstate(invalid="ignore"):
        used = np.abs(residual) < reach_m
    residual, normal = residual[used], normal[used] @ other.rotation.T
    sigma = np.sqrt(2.0) * noise.sigma_m(local[used, 2]) + 5e-4
    # Geman-McClure: what is not the same surface has no say.
    weight = 1 / (1 + (residual / (3 * sigma)) ** 2) / (sigma * math.sqrt(_CORRELATED))
    rows = np.concatenate([np.cross(world[used], normal), normal], axis=1)
    return rows * weight[:, None], residual * weight
