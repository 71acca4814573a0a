"""Joint point-to-plane refinement of the poses of all views of a depth sequence.

Small tracking errors contradict the background model at every slanted surface, which the detector would take for glass.
Points of every view are matched to the planes that its neighbours see (:mod:`.view_geometry`), with robust weights, and
the reported poses are priors with the standard deviations of the tracker. All poses are solved for together (Gauss-Newton), so
eight views around a table work as well as eighty along a path.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int

from ...core import Camera, Pose, one_blas_thread
from ...core.geometry import hat, so3_exp, so3_log
from ...io.depth.depth_sequence import DepthFrame
from ..fusion.depth_noise import SENSOR_NOISE, DepthNoise
from .view_geometry import ideal_depth, intrinsics, view_graph

#: Standard deviation of the reported poses, per axis [m], [rad].
_SIGMA_M, _SIGMA_RAD = 0.005, math.radians(0.3)
#: Number of neighbours that each view is compared with.
_NEIGHBOURS = 6
#: Number of points of all views together that are matched to each neighbour, and minimum number of each view.
_ALL_POINTS, _POINTS = 24_000, 500
#: Number of residuals of neighbouring points that count as one: they are correlated.
_CORRELATED = 2.0
#: Minimum standard deviation of a depth [m].
MIN_SIGMA_M = 5e-4
#: Number of iterations; each matches the points again.
_STEPS = 8
#: Over-relaxation of a step, and weight of the previous step (heavy ball, Polyak 1964): reweighting minimises
#: an upper bound, so that twice its step still descends; along surfaces its steps shrink by at most a tenth.
_RELAXED, _MOMENTUM = 1.5, 0.5


def _points(depth_m: Float32[np.ndarray, "h w"], camera: Camera, count: int) -> Float[np.ndarray, "n 3"]:
    """About ``count`` points on smooth surfaces, spread over the view, in the camera frame [m]."""
    from ._view_kernels import smooth_points

    # Oversampled by 4, so that a view of which a quarter is smooth yields all points.
    stride = max(1, math.isqrt(depth_m.size // (4 * count)))
    found = np.empty((math.ceil(depth_m.shape[0] / stride) * math.ceil(depth_m.shape[1] / stride), 3))
    found = found[: smooth_points(depth_m, stride, *_numbers(camera), found)]
    return found[np.linspace(0, len(found) - 1, min(count, len(found))).astype(int)]


def _numbers(camera: Camera) -> list[float]:
    return [float(value) for value in intrinsics(camera)]


@one_blas_thread()
def refine_poses(
    frames: Sequence[DepthFrame], noise: DepthNoise = SENSOR_NOISE["kinect"]
) -> list[DepthFrame]:
    """Refine the poses of frames; returns frames in the same order.

    Parameters
    ----------
    frames
        Views of one camera.
    noise
        Noise of the camera; its tracking term is not used here.
    """
    from scipy.linalg import block_diag

    from ._view_kernels import plane_equations

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
    numbers = noise.quadratic_per_m, noise.constant_m, noise.offset_m, MIN_SIGMA_M
    squares, pulls = np.empty((len(pairs), 6, 6)), np.empty((len(pairs), 6))
    measured = np.array([frame.T_world_camera.matrix[:3] for frame in frames])
    present = measured.copy()
    stiffness = np.repeat([1 / _SIGMA_RAD**2, 1 / _SIGMA_M**2], 3)
    moved = np.zeros((count, 6))
    for step in range(_STEPS):
        # Distant matches help a poor initial pose and degrade a good one.
        reach_m = 4 * _SIGMA_M * max(0.25, 0.6**step)
        # Fewer points suffice while the poses are poor; each represents the omitted ones.
        stride = 4 if step < _STEPS // 2 else 1
        last = _CORRELATED / stride, squares, pulls
        plane_equations(*places, stride, present, depths, *_numbers(camera), reach_m, *numbers, *last)
        matrix, right = normal_equations(squares, pulls, pairs, count)
        away, local = _offsets(present, measured)
        firm = local.transpose(0, 2, 1) * stiffness
        right -= (firm @ away[..., None])[..., 0]
        whole = matrix.toarray() + block_diag(*(firm @ local))
        newton = np.linalg.solve(whole, right.ravel()).reshape(count, 6)
        moved = _RELAXED * newton + _MOMENTUM * moved
        present = so3_exp(moved[:, :3]) @ present
        present[:, :, 3] += moved[:, 3:]
    poses = (Pose.from_matrix(matrix) for matrix in present)
    return [replace(frame, T_world_camera=pose) for frame, pose in zip(frames, poses, strict=True)]


def normal_equations(
    squares: Float[np.ndarray, "p 6 6"],
    pulls: Float[np.ndarray, "p 6"],
    pairs: Int[np.ndarray, "p 2"],
    count: int,
) -> tuple[Any, Float[np.ndarray, "n 6"]]:
    """Normal equations of all poses (sparse, 6n x 6n) and their right side.

    Parameters
    ----------
    squares, pulls
        J^T J and J^T r of each pair, for a motion of the points in the world.
    pairs
        View of the points, and view of the planes: a motion of the first moves the points, one of the second the planes.
    count
        Number of views n.
    """
    from scipy.sparse import coo_matrix

    i, k = pairs.T
    blocks = np.concatenate([squares, squares, -squares, -squares])
    rows, columns = (
        6 * np.stack([np.concatenate([i, k, i, k]), np.concatenate([i, k, k, i])])[..., None, None]
    )
    down, across = np.indices((6, 6))
    places = np.stack([rows + down, columns + across]).reshape(2, -1)
    right = np.zeros((count, 6))
    np.add.at(right, i, -pulls)
    np.add.at(right, k, pulls)
    return coo_matrix((blocks.ravel(), places), shape=(6 * count, 6 * count)).tocsc(), right


def _offsets(
    present: Float[np.ndarray, "n 3 4"], measured: Float[np.ndarray, "n 3 4"]
) -> tuple[Float[np.ndarray, "n 6"], Float[np.ndarray, "n 6 6"]]:
    """Rotation [rad] and translation of the camera centre [m] from the measured to the present pose, and its Jacobian."""
    turned = so3_log(present[:, :, :3] @ measured[:, :, :3].transpose(0, 2, 1))
    away = np.concatenate([turned, present[:, :, 3] - measured[:, :, 3]], axis=1)
    local = np.tile(np.eye(6), (len(present), 1, 1))
    local[:, 3:, :3] = -hat(present[:, :, 3])
    return away, local


def common_sigma_m(
    reported: Sequence[DepthFrame], refined: Sequence[DepthFrame], point_m: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Standard deviation of the common error of all views at a point [m].

    Poses that are refined jointly keep the mean of the reported poses; the corrections show the errors of these.

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
