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
from jaxtyping import Float, Float32

from ...core.camera.model import Camera
from ...core.camera.pose import Pose
from ...core.geometry import hat, so3_exp, so3_log
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
#: Steps of the solution, each looks the matching points up anew.
_STEPS = 8
#: Over-relaxation of a step, and fraction of the step before that it goes on with (heavy ball, Polyak 1964): reweighting
#: minimises a bound, so that twice its step still descends; along surfaces its steps shrink by no more than a tenth.
_RELAXED, _MOMENTUM = 1.5, 0.5


def _points(depth_m: Float32[np.ndarray, "h w"], camera: Camera, count: int) -> Float[np.ndarray, "n 3"]:
    """As many points of a view where it has a smooth surface, spread over it, in the frame of its camera [m]."""
    from ._background_kernels import smooth_points

    # A view of which a quarter is smooth still gives all of them.
    stride = max(1, math.isqrt(depth_m.size // (4 * count)))
    found = np.empty((math.ceil(depth_m.shape[0] / stride) * math.ceil(depth_m.shape[1] / stride), 3))
    found = found[: smooth_points(depth_m, stride, *_numbers(camera), found)]
    return found[np.linspace(0, len(found) - 1, min(count, len(found))).astype(int)]


def _numbers(camera: Camera) -> list[float]:
    return [float(value) for value in intrinsics(camera)]


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
    near = {(i, k) for i in range(count) for k in graph.neighbours(i, _NEIGHBOURS)}
    pairs = np.array(sorted(near | {(k, i) for i, k in near}), np.int64).reshape(-1, 2)
    depths, camera = np.stack([ideal_depth(frame) for frame in frames]), frames[0].camera
    points = [_points(depth_m, camera, max(_POINTS, _ALL_POINTS // count)) for depth_m in depths]
    firsts = np.cumsum([0, *(len(chosen) for chosen in points)])
    places = pairs, np.concatenate(points), firsts
    numbers = noise.quadratic_per_m, noise.constant_m, noise.offset_m, _LEAST_M
    squares, pulls = np.empty((len(pairs), 6, 6)), np.empty((len(pairs), 6))
    measured = np.array([frame.T_world_camera.matrix[:3] for frame in frames])
    present = measured.copy()
    stiffness = np.repeat([1 / sigma_rad**2, 1 / sigma_m**2], 3)
    each, moved = np.arange(count), np.zeros((count, 6))
    for step in range(_STEPS):
        # Far matches help a poor start and spoil a good one.
        reach_m = 4 * sigma_m * max(0.25, 0.6**step)
        # Fewer points lead as far as they match poorly; each of them stands for those that are left out.
        stride = 4 if step < _STEPS // 2 else 1
        last = _CORRELATED / stride, squares, pulls
        plane_equations(*places, stride, present, depths, *_numbers(camera), reach_m, *numbers, *last)
        matrix, right = np.zeros((count, count, 6, 6)), np.zeros((count, 6))
        # A motion of the first view of a pair in the world moves its points, one of the second its planes.
        i, k = pairs.T
        for rows, columns, sign in ((i, i, 1), (k, k, 1), (i, k, -1), (k, i, -1)):
            np.add.at(matrix, (rows, columns), sign * squares)
        np.add.at(right, i, -pulls)
        np.add.at(right, k, pulls)
        away, local = _offsets(present, measured)
        firm = local.transpose(0, 2, 1) * stiffness
        matrix[each, each] += firm @ local
        right -= (firm @ away[..., None])[..., 0]
        whole = matrix.transpose(0, 2, 1, 3).reshape(6 * count, -1)
        newton = np.linalg.solve(whole, right.ravel()).reshape(count, 6)
        moved = _RELAXED * newton + _MOMENTUM * moved
        present = so3_exp(moved[:, :3]) @ present
        present[:, :, 3] += moved[:, 3:]
    poses = (Pose.from_matrix(matrix) for matrix in present)
    return [replace(frame, T_world_camera=pose) for frame, pose in zip(frames, poses, strict=True)]


def _offsets(
    present: Float[np.ndarray, "n 3 4"], measured: Float[np.ndarray, "n 3 4"]
) -> tuple[Float[np.ndarray, "n 6"], Float[np.ndarray, "n 6 6"]]:
    """Turn [rad] and shift of the eye [m] of each pose from the measured one, and how a motion in the world changes them."""
    turned = so3_log(present[:, :, :3] @ measured[:, :, :3].transpose(0, 2, 1))
    away = np.concatenate([turned, present[:, :, 3] - measured[:, :, 3]], axis=1)
    local = np.tile(np.eye(6), (len(present), 1, 1))
    local[:, 3:, :3] = -hat(present[:, :, 3])
    return away, local


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
