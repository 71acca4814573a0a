"""Transparency detector as published: deviations from a background model summed along rays (Alt 2016, 5.2).

Incremental, frame by frame while the camera moves. Eq. (5.4) is implemented with its sign corrected: an observation counts if it
disagrees with the model. The detector of the library is :mod:`visuohaptic.reconstruction.transparency.evidence`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float32

from ...core import Camera, InputError, Pose
from ...io.depth.depth_sequence import DepthFrame
from ...reconstruction.fusion import SENSOR_NOISE, DepthNoise, SpaceGrid
from ...reconstruction.transparency._view_kernels import warp_views
from ...reconstruction.transparency.regions import TransparentRegion, find_regions
from ...reconstruction.transparency.view_geometry import back_motions, ideal_depth, intrinsics, motions

#: w of Eq. (5.3), such that the reliability is 0 at sigma = 4 sigma_s.
HELLINGER_WEIGHT = 1 / (1 - math.sqrt(8 / 17))
#: Minimum distance of a kept view from the previous one [m].
_MIN_STEP_M = 0.01
#: A larger rotation is a tracking error [rad].
_JUMP_RAD = math.radians(20)


@dataclass(frozen=True, slots=True)
class PublishedSettings:
    """Parameters of the published detector; the defaults are the dissertation's where it states them."""

    views: int = 8  #: number of views of a model
    span_m: float = 0.2  #: path length that they cover [m]
    gap_m: float = 0.16  #: path length between them and the current view [m]
    step_m: float = 0.02  #: path length between two comparisons [m]
    min_views: int = 3  #: minimum number of observations of a pixel of the model
    erosion_px: int | None = None  #: erosion of reliable regions; default the edge margin of the camera [px]
    theta: float = 0.9  #: minimum probability of a deviation that counts
    max_wrong: float = 0.15  #: maximum fraction of deviating among reliable pixels of a frame that is used
    jump_m: float = 0.15  #: a longer step is a tracking error [m]
    of_peak: float = 0.5  #: minimum score of transparent voxels, as a fraction of the 99.9th percentile
    min_sum: float = 3.0  #: minimum summed score of transparent voxels
    min_voxels: int = 50  #: minimum size of a cluster


@dataclass(slots=True)
class LocalViews:
    """Recent path of the camera, and selection of the views on it that model the current view.

    Views ``gap_m`` to ``gap_m + span_m`` back along the path are far enough away that glass covers another part of the
    background, and near enough that the scene looks the same otherwise.
    """

    settings: PublishedSettings = field(default_factory=PublishedSettings)
    frames: list[DepthFrame] = field(default_factory=list)  #: kept views, oldest first
    path_length_m: list[float] = field(default_factory=list)  #: path length at each of them [m]

    def jumped(self, frame: DepthFrame) -> bool:
        """Whether the step from the last kept view is a tracking error.

        Parameters
        ----------
        frame
            Next view.
        """
        if not self.frames:
            return False
        before, now = self.frames[-1].T_world_camera, frame.T_world_camera
        step_m = float(np.linalg.norm(now.translation_m - before.translation_m))
        return step_m > self.settings.jump_m or before.angle_to(now) > _JUMP_RAD

    def add(self, frame: DepthFrame) -> bool:
        """Keep a view unless it is too near to the last one; returns whether it was kept.

        Parameters
        ----------
        frame
            Next view.
        """
        step = math.inf
        if self.frames:
            before = self.frames[-1].T_world_camera.translation_m
            step = float(np.linalg.norm(frame.T_world_camera.translation_m - before))
            if step < min(_MIN_STEP_M, self.settings.step_m):
                return False
        self.path_length_m.append(self.path_length_m[-1] + step if self.frames else 0.0)
        self.frames.append(frame)
        s = self.settings
        oldest = self.path_length_m[-1] - s.gap_m - s.span_m - s.jump_m
        while len(self.path_length_m) > 2 and self.path_length_m[1] < oldest:
            del self.frames[0], self.path_length_m[0]
        return True

    def clear(self) -> None:
        """Discard all views, after a tracking error."""
        self.frames.clear()
        self.path_length_m.clear()

    def of_model(self) -> list[DepthFrame]:
        """Views for the model of the last added view: spread over the span, oldest first."""
        if not self.path_length_m:
            return []
        s, behind = self.settings, self.path_length_m[-1] - np.array(self.path_length_m)
        slack = 0.5 * s.span_m / max(s.views - 1, 1)
        usable = np.flatnonzero((behind >= s.gap_m - 1e-9) & (behind <= s.gap_m + s.span_m + slack))
        if len(usable) > s.views:
            goals_m = s.gap_m + np.linspace(0, s.span_m, s.views)
            usable = np.unique([usable[np.argmin(np.abs(behind[usable] - goal_m))] for goal_m in goals_m])
        return [self.frames[i] for i in usable]


@dataclass(frozen=True, slots=True, eq=False)
class BackgroundModel:
    """Expected depth of each pixel of a view."""

    mean_m: Float32[np.ndarray, "h w"]  #: NaN below ``min_views`` observations [m]
    sigma_m: Float32[np.ndarray, "h w"]  #: max(sigma, sigma_s) [m]
    reliability: Float32[np.ndarray, "h w"]  #: S_r of Eq. (5.3) after erosion, 0-1
    views: int  #: number of views in the model


def background_model(
    views: Sequence[DepthFrame],
    T_world_camera: Pose,
    noise: DepthNoise = SENSOR_NOISE["kinect"],
    *,
    min_views: int = 3,
    erosion_px: int | None = None,
) -> BackgroundModel:
    """Predict a view from others: z-buffered reprojection, mean, standard deviation and reliability of each pixel.

    Parameters
    ----------
    views
        Views of the same camera.
    T_world_camera
        Pose of the predicted view.
    noise
        Lower bound of the noise, Eq. (5.1).
    min_views
        Minimum number of observations of a pixel.
    erosion_px
        Erosion of reliable regions; by default the edge margin of the camera, 2 px for a Kinect [px].

    Raises
    ------
    InputError
        There are no views, or their images differ in size.
    """
    if not views:
        raise InputError("background_model", "found no views, expected at least 3")
    shape = views[0].depth_m.shape
    if any(view.depth_m.shape != shape for view in views):
        raise InputError("background_model", "the views differ in size, expected one camera")
    depths = np.stack([ideal_depth(view) for view in views])
    warped = np.empty_like(depths)
    moved = motions(T_world_camera, [view.T_world_camera for view in views])
    warp_views(depths, moved, *intrinsics(views[0].camera), warped)
    mean_m, sigma_m, score = view_moments(warped, noise, min_views)
    if erosion_px is None:
        erosion_px = noise.edge_px(views[0].camera.focal_px)
    if erosion_px > 0:
        import cv2

        edge = 2 * erosion_px + 1
        score = cv2.erode(score, np.ones((edge, edge), np.uint8), borderValue=0)
    return BackgroundModel(mean_m, sigma_m, score, len(views))


def view_moments(
    warped_m: Float32[np.ndarray, "n h w"], noise: DepthNoise, min_views: int
) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
    """Mean [m], sigma' [m] and reliability of each pixel, Eq. (5.3); the variance has the factor n / (n - 1).

    Parameters
    ----------
    warped_m
        Depths of other views in this one [m]; infinite: not seen.
    noise
        Lower bound of the noise.
    min_views
        Minimum number of views of a pixel; with fewer, the mean is NaN.
    """
    known = np.isfinite(warped_m)
    count = known.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean_m = np.where(known, warped_m, 0.0).sum(axis=0) / count
        variance = np.where(known, (warped_m - mean_m) ** 2, 0.0).sum(axis=0) / (count - 1)
        least = noise.sigma_m(mean_m) ** 2
        variance = np.maximum(variance, least)
        overlap = np.sqrt(2.0 * np.sqrt(least * variance) / (least + variance))
    score = np.maximum(1.0 - HELLINGER_WEIGHT * (1.0 - overlap), 0.0)
    enough = count >= min_views
    found = ((mean_m, np.nan), (np.sqrt(variance), 0.0), (score, 0.0))
    mean_m, sigma_m, score = (np.where(enough, values, other).astype(np.float32) for values, other in found)
    return mean_m, sigma_m, score


def error_image(
    model: BackgroundModel,
    depth_m: Float32[np.ndarray, "h w"],
    camera: Camera,
    T_world_camera: Pose,
    model_poses: list[Pose],
    settings: PublishedSettings | None = None,
) -> Float32[np.ndarray, "h w"]:
    """Error score of each pixel, Eq. (5.4): erf of the deviation, mapped from [theta, 1] to [0, 1], times S_r.

    Parameters
    ----------
    model
        Background model of the pixels.
    depth_m
        Depth image (h, w) [m].
    camera
        Camera without distortion.
    T_world_camera
        Pose of the view.
    model_poses
        Poses of the views of the model.
    settings
        Thresholds of the score.
    """
    from scipy.special import erf

    settings = settings or PublishedSettings()
    (height, width), (fx, fy, cx, cy) = depth_m.shape, intrinsics(camera)
    with np.errstate(divide="ignore", invalid="ignore"):
        certain = erf(np.abs(depth_m - model.mean_m) / (math.sqrt(2.0) * model.sigma_m))
        error = model.reliability * (certain - settings.theta) / (1.0 - settings.theta)
        error = np.where(depth_m > 0, np.fmax(error, 0.0), 0.0).astype(np.float32)
    rows, columns = np.nonzero(error)
    z = depth_m[rows, columns].astype(np.float64)
    points = np.stack([z * (columns - cx) / fx, z * (rows - cy) / fy, z, np.ones(len(z))])
    there = back_motions(T_world_camera, model_poses)
    x, y, away = np.moveaxis(there @ points, 1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = fx * x / away + cx, fy * y / away + cy
    seen = ((away > 0.05) & (u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1)).sum(axis=0)
    few = seen < min(settings.min_views, len(there))
    error[rows[few], columns[few]] = 0.0
    return error


@dataclass(slots=True)
class PublishedDetector:
    """Accumulates error rays of successive views in a volume."""

    grid: SpaceGrid
    noise: DepthNoise = SENSOR_NOISE["kinect"]
    settings: PublishedSettings = field(default_factory=PublishedSettings)
    volume: Float32[np.ndarray, "x y z"] = field(init=False)  #: summed scores
    used: int = 0  #: number of views compared with a model
    skipped: Counter[str] = field(default_factory=Counter)  #: number of views not compared, by cause
    _views: LocalViews = field(init=False)
    _compared_m: float = field(init=False, default=-np.inf)

    def __post_init__(self) -> None:
        self.volume = np.zeros(self.grid.shape, np.float32)
        self._views = LocalViews(self.settings)

    def add(self, frame: DepthFrame) -> Float32[np.ndarray, "h w"] | None:
        """Compare one view with its model and cast its error rays; returns the error scores of its pixels, if it was compared.

        Parameters
        ----------
        frame
            Next view.
        """
        views, settings = self._views, self.settings
        if views.jumped(frame):
            views.clear()
            self._compared_m = -np.inf
            views.add(frame)
            self.skipped["pose jumps"] += 1
            return None
        if not views.add(frame):
            self.skipped["not moved"] += 1
            return None
        if views.path_length_m[-1] - self._compared_m < settings.step_m - 1e-9:
            self.skipped["between steps"] += 1
            return None
        others = views.of_model()
        if len(others) < settings.min_views:
            self.skipped["no model"] += 1
            return None
        self._compared_m = views.path_length_m[-1]
        model = background_model(
            others,
            frame.T_world_camera,
            self.noise,
            min_views=settings.min_views,
            erosion_px=settings.erosion_px,
        )
        depth_m = ideal_depth(frame)
        poses = [view.T_world_camera for view in others]
        score = error_image(model, depth_m, frame.camera, frame.T_world_camera, poses, settings)
        reliable = np.count_nonzero((model.reliability > 0) & (depth_m > 0))
        if np.count_nonzero(score) > settings.max_wrong * max(int(reliable), 1):
            self.skipped["too wrong"] += 1
            return None
        self.cast(score, model.mean_m, frame)
        self.used += 1
        return score

    def cast(
        self, score: Float32[np.ndarray, "h w"], mean_m: Float32[np.ndarray, "h w"], frame: DepthFrame
    ) -> None:
        """Cast the error rays up to the surface predicted by the model.

        Parameters
        ----------
        score, mean_m
            Error score and predicted depth of each pixel (h, w) [m].
        frame
            Their view.
        """
        from ._published_kernels import cast_rays

        i, j = np.nonzero(score)
        fx, fy, cx, cy = intrinsics(frame.camera)
        slopes = np.column_stack([(j - cx) / fx, (i - cy) / fy, np.ones(len(i))])
        ends = frame.T_world_camera.apply(slopes * mean_m[i, j, None])
        origin = frame.T_world_camera.translation_m
        cast_rays(origin, ends, score[i, j], self.grid.low_m, self.grid.voxel_m, 4, self.volume)

    def regions(self) -> tuple[TransparentRegion, ...]:
        """Clusters of transparent voxels with their convex hulls."""
        hit, settings = self.volume[self.volume > 0], self.settings
        if not hit.size:
            return ()
        inside = self.volume >= max(settings.min_sum, settings.of_peak * float(np.percentile(hit, 99.9)))
        score = self.volume / np.float32(max(self.used, 1))
        return find_regions(score, inside, self.grid, min_voxels=settings.min_voxels)
