"""Transparency detector as published: deviations from the background model summed along rays (Alt 2016, 5.2).

Incremental, frame by frame while the camera moves. Eq. (5.4) is implemented with its
sign corrected: an observation counts if it disagrees with the model. The more
accurate detector is in :mod:`.evidence`; both have the same methods.
"""

from __future__ import annotations

import logging
import math
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from ...core.camera.model import Camera
from ...core.camera.pose import Pose
from ...io.depth.depth_sequence import DepthFrame
from ..fusion.depth_noise import SENSOR_NOISE, DepthNoise
from ..fusion.volume import SpaceGrid
from .background import (
    BackgroundModel,
    LocalViews,
    back_motions,
    background_model,
    ideal_depth,
    intrinsics,
)
from .regions import TransparentRegion, find_regions
from .search_report import SearchReport

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class TransparencySettings:
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


@dataclass(frozen=True, slots=True, eq=False)
class ErrorImage:
    """Deviation of a view from its model; with ``valid`` False it was not used for the ``reason``."""

    score: Float32[np.ndarray, "h w"]  #: S_E of Eq. (5.4), 0-1
    model: BackgroundModel | None
    valid: bool
    reason: str = ""


def error_image(
    model: BackgroundModel,
    depth_m: Float32[np.ndarray, "h w"],
    camera: Camera,
    T_world_camera: Pose,
    model_poses: list[Pose],
    settings: TransparencySettings | None = None,
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
    from ._background_kernels import error_score

    settings = settings or TransparencySettings()
    there = back_motions(T_world_camera, model_poses)
    error = np.empty_like(depth_m)
    numbers = (settings.theta, min(settings.min_views, len(there)))
    arrays = (depth_m, model.mean_m, model.sigma_m, model.reliability)
    error_score(*arrays, there, *numbers, *intrinsics(camera), error)
    return error


@dataclass(slots=True)
class TransparencyDetector:
    """Accumulates error rays of successive views in a volume.

    Examples
    --------
    >>> detector = TransparencyDetector(grid)  # doctest: +SKIP
    >>> for frame in DepthSequence("scan"):
    ...     detector.add(frame)
    >>> detector.regions()
    """

    grid: SpaceGrid
    noise: DepthNoise = SENSOR_NOISE["kinect"]
    settings: TransparencySettings = field(default_factory=TransparencySettings)
    volume: Float32[np.ndarray, "x y z"] = field(init=False)  #: summed scores
    views: int = 0  #: number of views added
    used: int = 0  #: number of views compared with a model
    skipped: Counter[str] = field(default_factory=Counter)  #: number of views not compared, by cause
    _views: LocalViews = field(init=False)
    _compared_m: float = field(init=False, default=-np.inf)

    def __post_init__(self) -> None:
        self.volume = np.zeros(self.grid.shape, np.float32)
        s = self.settings
        self._views = LocalViews(s.views, s.span_m, s.gap_m, min(0.01, s.step_m), s.jump_m)

    def add(self, frame: DepthFrame) -> ErrorImage:
        """Compare one view with its model and cast its error rays.

        Parameters
        ----------
        frame
            Next view.
        """
        self.views += 1
        views, settings = self._views, self.settings
        if views.jumped(frame):
            views.clear()
            self._compared_m = -np.inf
            views.add(frame)
            return self._left_out(frame, "pose jumps", "the pose jumps; the model is restarted")
        if not views.add(frame):
            return self._left_out(frame, "not moved", "the camera has not moved")
        if views.path_length_m[-1] - self._compared_m < settings.step_m - 1e-9:
            return self._left_out(frame, "between steps", "less than one step from the last comparison")
        others = views.of_model()
        if len(others) < settings.min_views:
            return self._left_out(frame, "no model", "too few views for a model so far")
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
            return self._left_out(frame, "too wrong", "large erroneous regions: moved scene or lost track")
        self._cast(score, model.mean_m, frame)
        self.used += 1
        return ErrorImage(score, model, True)

    def _left_out(self, frame: DepthFrame, cause: str, reason: str) -> ErrorImage:
        self.skipped[cause] += 1
        _log.debug("view %d: %s", frame.index, reason)
        return ErrorImage(np.zeros(frame.depth_m.shape, np.float32), None, False, reason)

    def _cast(
        self, score: Float32[np.ndarray, "h w"], mean_m: Float32[np.ndarray, "h w"], frame: DepthFrame
    ) -> None:
        """Cast the error rays up to the surface predicted by the model."""
        from ._background_kernels import cast_rays

        i, j = np.nonzero(score)
        fx, fy, cx, cy = intrinsics(frame.camera)
        slopes = np.column_stack([(j - cx) / fx, (i - cy) / fy, np.ones(len(i))])
        ends = frame.T_world_camera.apply(slopes * mean_m[i, j, None])
        origin = frame.T_world_camera.translation_m
        cast_rays(origin, ends, score[i, j], self.grid.low_m, self.grid.voxel_m, 4, self.volume)

    def score(self, cells: Int[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Summed scores of voxels per compared view.

        Parameters
        ----------
        cells
            Indices (n, 3) of the voxels.
        """
        return self.volume[tuple(cells.T)] / np.float32(max(self.used, 1))

    def inside(self) -> Bool[np.ndarray, "x y z"]:
        """Mask of the transparent voxels."""
        hit = self.volume[self.volume > 0]
        if not hit.size:
            return np.zeros(self.grid.shape, dtype=bool)
        peak = float(np.percentile(hit, 99.9))
        return self.volume >= max(self.settings.min_sum, self.settings.of_peak * peak)

    def regions(self) -> tuple[TransparentRegion, ...]:
        """Clusters of transparent voxels with their convex hulls."""
        inside = self.inside()
        return find_regions(
            self.volume / np.float32(max(self.used, 1)),
            inside,
            inside,
            self.grid,
            min_voxels=self.settings.min_voxels,
        )

    def report(self) -> SearchReport:
        """Summary of the search, with the reason if nothing was found."""
        found = SearchReport.of_search(
            self.volume,
            (self.volume > 0) * self.used,
            views=self.views,
            compared=self.used,
            skipped=self.skipped,
            rate=math.exp(-1.0),
            threshold=self.settings.min_sum,
            regions=len(self.regions()),
        )
        return replace(found, bad_rate=math.nan)
