"""Background model: the depth image of a view predicted from other views of the same camera (Alt 2016, 5.2.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float32

from ...core.camera.model import Camera
from ...core.camera.pose import Pose
from ...core.errors import InputError
from ...io.depth.depth_sequence import DepthFrame
from ..fusion._fusion_view import pinhole_images
from ..fusion.depth_noise import SENSOR_NOISE, DepthNoise

#: w of Eq. (5.3), such that the reliability is 0 at sigma = 4 sigma_s.
HELLINGER_WEIGHT = 1 / (1 - math.sqrt(8 / 17))


@dataclass(frozen=True, slots=True, eq=False)
class BackgroundModel:
    """Expected depth of each pixel of a view."""

    mean_m: Float32[np.ndarray, "h w"]  #: NaN below 3 observations [m]
    sigma_m: Float32[np.ndarray, "h w"]  #: max(sigma, sigma_s) [m]
    reliability: Float32[np.ndarray, "h w"]  #: S_r of Eq. (5.3) after erosion, 0-1
    views: int  #: number of views in the model


@dataclass(slots=True)
class LocalViews:
    """Recent path of the camera, and selection of the views on it that model the current view.

    Views ``gap_m`` to ``gap_m + span_m`` back along the path are far enough away that glass covers another part of the
    background, and near enough that the scene looks the same otherwise.
    """

    count: int = 8  #: number of views of a model
    span_m: float = 0.2  #: path length that they cover [m]
    gap_m: float = 0.16  #: path length between them and the current view [m]
    min_step_m: float = 0.01  #: minimum distance of a kept view from the previous one [m]
    jump_m: float = 0.15  #: a longer step is a tracking error [m]
    jump_rad: float = math.radians(20)  #: a larger rotation is a tracking error [rad]
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
        motion = self.frames[-1].T_world_camera.inverse() @ frame.T_world_camera
        turn = math.acos(max(-1.0, min(1.0, (np.trace(motion.rotation) - 1) / 2)))
        return float(np.linalg.norm(motion.translation_m)) > self.jump_m or turn > self.jump_rad

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
            if step < self.min_step_m:
                return False
        self.path_length_m.append(self.path_length_m[-1] + step if self.frames else 0.0)
        self.frames.append(frame)
        oldest = self.path_length_m[-1] - self.gap_m - self.span_m - self.jump_m
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
        behind = self.path_length_m[-1] - np.array(self.path_length_m)
        slack = 0.5 * self.span_m / max(self.count - 1, 1)
        usable = np.flatnonzero((behind >= self.gap_m - 1e-9) & (behind <= self.gap_m + self.span_m + slack))
        if len(usable) > self.count:
            wanted = self.gap_m + np.linspace(0, self.span_m, self.count)
            usable = np.unique([usable[np.argmin(np.abs(behind[usable] - w))] for w in wanted])
        return [self.frames[i] for i in usable]


def ideal_depth(frame: DepthFrame) -> Float32[np.ndarray, "h w"]:
    """The depth image of a pinhole camera without distortion (nearest pixel, no interpolation).

    Parameters
    ----------
    frame
        View with lens distortion.
    """
    return np.ascontiguousarray(pinhole_images(frame, color=False)[0])


def motions(T_world_this: Pose, others: Sequence[Pose]) -> Float32[np.ndarray, "n 3 4"]:
    """``T_this_other`` of each other view.

    Parameters
    ----------
    T_world_this
        Pose of this view.
    others
        Poses ``T_world_other``.
    """
    turns = np.array([other.rotation for other in others]).reshape(-1, 3, 3)
    places_m = np.array([other.translation_m for other in others]).reshape(-1, 3)
    rotation = T_world_this.rotation
    moved = np.concatenate(
        [rotation.T @ turns, ((places_m - T_world_this.translation_m) @ rotation)[..., None]], axis=2
    )
    return moved.astype(np.float32)


def back_motions(T_world_this: Pose, others: Sequence[Pose]) -> Float32[np.ndarray, "n 3 4"]:
    """``T_other_this`` of each other view.

    Parameters
    ----------
    T_world_this, others
        As in :func:`motions`.
    """
    moved = [motions(other, [T_world_this])[0] for other in others]
    return np.array(moved, np.float32).reshape(-1, 3, 4)


def intrinsics(camera: Camera) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Focal lengths and principal point in single precision [px].

    Parameters
    ----------
    camera
        Camera without distortion.
    """
    matrix = camera.matrix.astype(np.float32)
    return matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]


def background_model(
    views: Sequence[DepthFrame],
    T_world_camera: Pose,
    noise: DepthNoise = SENSOR_NOISE["kinect"],
    *,
    min_views: int = 3,
    erosion_px: int | None = None,
    weight: float = HELLINGER_WEIGHT,
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
    weight
        w of Eq. (5.3).

    Raises
    ------
    InputError
        There are no views, or their images differ in size.
    """
    from ._background_kernels import view_moments, warp_views

    if not views:
        raise InputError("background_model", "found no views, expected at least 3")
    shape = views[0].depth_m.shape
    if any(view.depth_m.shape != shape for view in views):
        raise InputError("background_model", "the views differ in size, expected one camera")
    depths = np.stack([ideal_depth(view) for view in views])
    warped = np.empty_like(depths)
    moved = motions(T_world_camera, [view.T_world_camera for view in views])
    warp_views(depths, moved, *intrinsics(views[0].camera), warped)
    mean_m, sigma_m, score = (np.empty(shape, np.float32) for _ in range(3))
    numbers = (noise.quadratic_per_m, noise.constant_m, noise.offset_m, noise.tracking_m, weight)
    view_moments(warped, *(np.float32(number) for number in numbers), min_views, mean_m, sigma_m, score)
    if erosion_px is None:
        erosion_px = noise.edge_px(views[0].camera.focal_px)
    if erosion_px > 0:
        import cv2

        edge = 2 * erosion_px + 1
        score = cv2.erode(score, np.ones((edge, edge), np.uint8), borderValue=0)
    return BackgroundModel(mean_m, sigma_m, score, len(views))
