"""Poses of a depth camera from its images alone: every view is registered to earlier ones, then all are solved together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int

from ...core import Camera, Pose, one_blas_thread
from ...core.errors import InputError, needs
from ...core.geometry import hat
from ...io.depth.depth_sequence import DepthFrame
from ...io.depth.poses import EstimatedPose
from ..fusion.depth_noise import SENSOR_NOISE, DepthNoise
from ..transparency.view_geometry import thinned, view_graph
from .pose_graph import PoseGraph, solve_graph
from .registration import Phase, RegisteredViews, moved

#: Images are thinned to this width [px].
_WIDTH_PX = 320
#: Earlier views that a new one is registered to.
_BACK = (1, 2, 3, 5, 8)
#: Differences of the places of views that are compared with each other.
_GAPS = (1, 3, 4, 6, 7, 8)
#: Steps of a registration: reach [m], and weights of planes and of depth steps. Steps find the way, planes the place.
_PHASES: tuple[Phase, ...] = (
    *((reach_m, 0.1, 1.0) for reach_m in (0.06, 0.04, 0.03, 0.02)),
    *((0.015, 1.0, 1.0),) * 3,
)
#: Displacements along the three directions in which a registration is least determined, where another optimum is sought [m].
_SHIFTS_M = (0.08, 0.05, 0.03)
#: Reach of the coarse and the fine registration of points, and edge of their voxels [m].
_REACHES_M, _VOXEL_M = (0.1, 0.03), 0.01
#: Steps that move all views; only planes decide, because a step lies off the edge by half of a matching window.
_TOGETHER: tuple[Phase, ...] = (*((0.03, 1.0, 1.0),) * 5, *((0.02, 1.0, 0.0),) * 8, *((0.012, 1.0, 0.0),) * 6)
#: Farthest that a start may lie off between two compared views: within the reach, and beyond what may stay uncertain [m].
_OFF_M = 0.018
#: Agreement of solutions, and of a standard deviation with the last reach, in standard deviations.
_AGREE = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class SequencePoses:
    """Estimated poses of a sequence."""

    poses: list[EstimatedPose]  #: of every image; the first registered view is the world
    loops: int  #: pairs of distant views that were found to see the same surfaces
    text: str  #: one line on the result


@one_blas_thread()
def estimate_poses(
    depths_m: Sequence[Float32[np.ndarray, "h w"] | None],
    camera: Camera,
    noise: DepthNoise = SENSOR_NOISE["realsense_d435"],
) -> SequencePoses:
    """Poses of the views of a depth camera that moves through a scene at rest, relative to the first one.

    A view whose registration is less likely than unrelated surfaces has no pose. Surfaces that let the camera slide, such
    as a plane, hold it only by chance: the solution must be found again from starts that drift in each of the six
    directions, within three of its standard deviations. If it is not, the first view alone has a pose.

    Parameters
    ----------
    depths_m
        Depth images in temporal order [m]; NaN: not measured. ``None``: unreadable.
    camera
        Model of the camera.
    noise
        Noise of its depths.

    Raises
    ------
    MissingExtraError
        small_gicp is not installed.
    InputError
        Less than two images have depths, or none can be registered to the first.
    """
    with needs("small-gicp", "geometry", "odometry"):
        import small_gicp
    usable = [k for k, depth_m in enumerate(depths_m) if depth_m is not None and np.isfinite(depth_m).any()]
    if len(usable) < 2:
        raise InputError("depths_m", f"found {len(usable)} images with depths, expected at least two")
    stride = math.ceil(camera.width / _WIDTH_PX)
    frames = []
    for k in usable:
        depth_m = np.asarray(depths_m[k], np.float32)
        frames.append(thinned(DepthFrame(0.0, depth_m, None, Pose.identity(), camera, k), stride))
    views = RegisteredViews(np.stack([frame.depth_m for frame in frames]), frames[0].camera, noise)
    clouds = [small_gicp.preprocess_points(points, _VOXEL_M, num_neighbors=12) for points in views.points]
    poses, ratios = _chain(views, clouds)
    found = [k for k, ratio in enumerate(ratios) if ratio > 0]
    problems = {k: "its depths fit no earlier view" for k, ratio in enumerate(ratios) if ratio <= 0}
    if len(found) < 2:
        raise InputError("depths_m", "no view can be registered to the first one")
    pairs = _pairs(found)
    first = solve_graph(views, poses, pairs, found[0], _TOGETHER)
    loops = _loops(views, frames, first.poses, found)
    pairs = np.concatenate([pairs, loops])
    best = solve_graph(views, first.poses, pairs, found[0], _TOGETHER[-6:]) if len(loops) else first
    lost, drift_m = _drifts(views, best, pairs, found)
    if lost:
        why = f"the surfaces do not determine it: solutions that fit as well are {1e3 * drift_m:.0f} mm apart"
        problems |= dict.fromkeys(found[1:], why)
    estimates = [EstimatedPose(None, problem="not one depth is valid") for _ in depths_m]
    for k, number in enumerate(usable):
        estimates[number] = _estimate(best, k, problems.get(k, ""))
    return SequencePoses(estimates, len(loops) // 2, _said(estimates, len(loops) // 2))


def _said(estimates: Sequence[EstimatedPose], loops: int) -> str:
    """One line on the result, with the first view that has no pose."""
    posed = [one.sigma_m for one in estimates if one.pose is not None]
    text = f"{len(posed)} of {len(estimates)} poses by odometry, {loops} loops"
    if len(posed) > 1:
        text += f", standard deviation at most {1e3 * max(posed):.2g} mm per axis"
    lost = [f"image {k} has no pose, {one.problem}" for k, one in enumerate(estimates) if one.pose is None]
    return "; ".join([text, *lost[:1]])


def _estimate(graph: PoseGraph, k: int, problem: str) -> EstimatedPose:
    """Pose of a view with its standard deviations, or the reason why there is none."""
    if problem:
        return EstimatedPose(None, problem=problem)
    spread = np.diagonal(graph.covariance[k])
    sigma_rad, sigma_m = (math.sqrt(max(part.mean(), 0.0)) for part in (spread[:3], spread[3:]))
    return EstimatedPose(Pose.from_matrix(graph.poses[k]), sigma_m, sigma_rad)


def _drifts(
    views: RegisteredViews, best: PoseGraph, pairs: Int[np.ndarray, "p 2"], found: Sequence[int]
) -> tuple[bool, float]:
    """Whether another start leads to another solution, and the largest distance between their views [m]."""
    world = views.points[found[0]]
    centre, radius_m = _extent(world)
    spread = np.array([np.trace(best.covariance[k][3:, 3:]) for k in found[1:]])
    limit = _AGREE * np.sqrt(spread)
    # The equations of the last matches are not valid beyond their reach.
    largest = float(limit.max())
    lost = not largest < _TOGETHER[-1][0]
    step_m = _OFF_M / min(len(found) - 1, max(_GAPS))
    for axis in range(6):
        drift = np.zeros(6)
        drift[axis] = step_m
        if axis < 3:
            # A rotation about the scene that moves its points as far as the translations do.
            drift /= radius_m
            drift[3:] = -np.cross(drift[:3], centre)
        start = best.poses.copy()
        for place, k in enumerate(found):
            start[k] = moved(best.poses[k], place * drift)
        other = solve_graph(views, start, pairs, found[0], _TOGETHER[5:])
        away = np.array([np.linalg.norm(other.poses[k][:3, 3] - best.poses[k][:3, 3]) for k in found[1:]])
        lost |= bool((away > limit).any())
        largest = max(largest, float(away.max()))
    return lost, largest


def _extent(points_m: Float[np.ndarray, "m 3"]) -> tuple[Float[np.ndarray, "3"], float]:
    """Middle of points, and their median distance from it [m]."""
    centre = np.median(points_m, axis=0)
    return centre, math.sqrt(float(np.median(((points_m - centre) ** 2).sum(axis=1))))


def _pairs(found: Sequence[int]) -> Int[np.ndarray, "p 2"]:
    """Both directions of the pairs of registered views that are compared without a loop."""
    ahead = [(found[a], found[a - gap]) for a in range(len(found)) for gap in _GAPS if a >= gap]
    both = np.array([pair for i, k in ahead for pair in ((i, k), (k, i))], np.int64)
    return both.reshape(-1, 2)


def _loops(
    views: RegisteredViews,
    frames: Sequence[DepthFrame],
    poses: Float[np.ndarray, "n 4 4"],
    found: Sequence[int],
) -> Int[np.ndarray, "p 2"]:
    """Pairs of distant views that are more likely to see the same surfaces than unrelated ones."""
    placed = [replace(frames[k], T_world_camera=Pose.from_matrix(poses[k])) for k in found]
    graph = view_graph(placed)
    closed = []
    for a, i in enumerate(found):
        for b in graph.neighbours(a, max(_GAPS)):
            k = found[b]
            if a - b > max(_GAPS) and min(views.log_ratio(i, k, poses), views.log_ratio(k, i, poses)) > 0:
                closed += [(i, k), (k, i)]
    return np.array(closed, np.int64).reshape(-1, 2)


def _chain(
    views: RegisteredViews, clouds: Sequence[tuple[Any, Any]]
) -> tuple[Float[np.ndarray, "n 4 4"], list[float]]:
    """Pose of every view relative to earlier ones, with its log-likelihood ratio; infinite for the first."""
    import small_gicp

    poses, ratios = np.tile(np.eye(4), (len(clouds), 1, 1)), [math.inf]
    for i in range(1, len(clouds)):
        good = [k for k in range(i) if ratios[k] > 0]
        last = good[-1]
        others = [good[-back] for back in _BACK if back <= len(good)]
        starts = [np.eye(4)]
        if len(good) > 1:
            starts.append(np.linalg.inv(poses[good[-2]]) @ poses[last])
        (target, tree), (source, _) = clouds[last], clouds[i]
        tried = []
        for start in starts:
            for reach_m in _REACHES_M:
                start = small_gicp.align(
                    target, source, tree, init_T_target_source=start, max_correspondence_distance=reach_m,
                    max_iterations=30,
                ).T_target_source  # fmt: skip
            tried.append(_registered(views, i, others, poses, poses[last] @ start))
        best = max(tried, key=lambda one: one[0])
        for shift_m in _SHIFTS_M:
            tried = [
                _registered(views, i, others, poses, start)
                for start in _beside(views.points[i], best[1], best[2], shift_m)
            ]
            best = max(best, *tried, key=lambda one: one[0])
        poses[i] = best[1]
        ratios.append(best[0])
    return poses, ratios


_Registered = tuple[float, Float[np.ndarray, "4 4"], Float[np.ndarray, "6 6"]]


def _registered(
    views: RegisteredViews, i: int, others: list[int], poses: Float[np.ndarray, "n 4 4"], start: np.ndarray
) -> _Registered:
    """Log-likelihood ratio, pose and information of a view after registration to others."""
    trial = poses.copy()
    trial[i] = start
    trial[i], matrix = views.polished(i, others, trial, _PHASES)
    ratios = [views.log_ratio(*pair, trial) for k in others for pair in ((i, k), (k, i))]
    return float(np.mean(ratios)), trial[i], matrix


def _beside(
    points_m: Float[np.ndarray, "m 3"],
    pose: Float[np.ndarray, "4 4"],
    matrix: Float[np.ndarray, "6 6"],
    shift_m: float,
) -> list[Float[np.ndarray, "4 4"]]:
    """Poses that are displaced along the three motions of the scene that are least determined."""
    world = points_m @ pose[:3, :3].T + pose[:3, 3]
    centre, radius_m = _extent(world)
    # Motions of the scene: rotation about its centre, by the way of a point at its radius, and translation.
    basis = np.eye(6)
    basis[:3, :3] /= radius_m
    basis[3:, :3] = hat(centre) / radius_m
    vectors = np.linalg.eigh(basis.T @ matrix @ basis)[1]
    return [moved(pose, sign * shift_m * (basis @ vectors[:, k])) for k in range(3) for sign in (1, -1)]
