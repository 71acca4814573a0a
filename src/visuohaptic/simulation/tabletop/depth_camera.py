"""Structured-light depth camera: the projector's pattern is refracted by glass on both paths.

Every camera ray and every projector ray is traced through the glass to a
diffuse surface. A camera pixel whose ray ends at surface point P shows the part of the
pattern that lands on P, by any path; its disparity is interpreted as depth. The
pattern cannot be decoded where no light or two displaced parts of it land on P, where it is
shifted across the rows, too dim, too discontinuous within the correlation window, or
where the projector's specular reflection saturates the camera.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core import Camera, Pose
from .refraction import RefractingScene


@dataclass(frozen=True, slots=True)
class DepthCameraOptics:
    """Decoding of the pattern; defaults are those of a Kinect/Xtion."""

    baseline_m: float = 0.075  #: projector to camera, along the camera's x [m]
    range_m: tuple[float, float] = (0.4, 4.0)  #: depths that are reported [m]
    noise_px: float = 0.06  #: standard deviation of the disparity; 1.4 mm at 1 m, as in Eq. (5.1) [px]
    step_px: float = 0.125  #: step of the reported disparities; 0 = exact [px]
    window_px: int = 7  #: edge of the correlation window, odd [px]
    window_fraction: float = 0.6  #: fraction of the window that must show the pattern undisturbed
    window_tolerance_px: float = 1.0  #: disparities in the window that count as undisturbed [px]
    row_tolerance_px: float = 1.2  #: maximum shift across the rows for the correlation [px]
    min_signal: float = 0.02  #: transmitted fraction x albedo x cosine / depth^2 below which it is too dim
    glint_rad: float = math.radians(3.0)  #: half width of the saturating reflection on smooth surfaces [rad]
    glint_return_rad: float = math.radians(4.5)  #: up to here, it returns the depth of the glass [rad]


def _kinect() -> Camera:
    return Camera.simple(640, 480, 580.0)


@dataclass(frozen=True, slots=True)
class DepthCamera:
    """Camera and projector side by side with equal optics, rectified."""

    camera: Camera = field(default_factory=_kinect)  #: ideal pinhole; distortion is not applied
    optics: DepthCameraOptics = field(default_factory=DepthCameraOptics)

    @classmethod
    def kinect(cls, width: int = 640) -> DepthCamera:
        """A Kinect's field of view at another resolution: noise, steps and window keep their size in space.

        Parameters
        ----------
        width
            Width of the images [px].
        """
        scale = width / 640
        optics = DepthCameraOptics(
            noise_px=0.06 * scale,
            step_px=0.125 * scale,
            window_px=max(3, 2 * round(3.5 * scale) + 1),
            window_tolerance_px=max(0.6, scale),
        )
        return cls(Camera.simple(width, round(width * 0.75), 580.0 * scale), optics)

    def render(
        self, scene: RefractingScene, T_world_camera: Pose, rng: np.random.Generator | None = None
    ) -> Float[np.ndarray, "h w"]:
        """One depth image.

        Parameters
        ----------
        scene
            Scene to measure.
        T_world_camera
            ``T_world_camera``, z forward.
        rng
            Noise of the disparity; without it the image has neither noise nor quantisation.

        Returns
        -------
        depth_m
            Depth along the optical axis, float32, NaN where the sensor returns no value [m].
        """
        from ._refraction_kernels import decode_pattern, pattern_map, trace_rays

        camera, optics = self.camera, self.optics
        fx, fy = float(camera.matrix[0, 0]), float(camera.matrix[1, 1])
        cx, cy = float(camera.matrix[0, 2]), float(camera.matrix[1, 2])
        rotation = np.ascontiguousarray(T_world_camera.rotation)
        eye = np.ascontiguousarray(T_world_camera.translation_m)
        projector = eye + optics.baseline_m * rotation[:, 0]
        margin = math.ceil(fx * optics.baseline_m / optics.range_m[0])
        rows = (np.arange(camera.height) - cy) / fy
        columns = (np.arange(camera.width) - cx) / fx
        p_columns = (np.arange(-margin, camera.width) - cx) / fx
        arrays = scene.solid_rows, scene.segment_rows, scene.box_rows
        hit, found = trace_rays(eye, rotation, columns, rows, *arrays)
        p_hit, p_found = trace_rays(projector, rotation, p_columns, rows, *arrays)
        first_x = -margin - cx
        light = rotation, projector, fx, fy, first_x, cy
        pattern = pattern_map(p_hit, p_found, *light)
        limits = optics.row_tolerance_px, optics.min_signal
        seen = decode_pattern(hit, found, p_found, *pattern, *light, *limits)
        disparity_px = np.arange(camera.width) - cx - seen
        disparity_px = self._correlate(disparity_px)
        self._glints(disparity_px, found, eye, projector, rotation, fx * optics.baseline_m)
        if rng is not None:
            disparity_px += optics.noise_px * self._noise(rng, disparity_px.shape)
            if optics.step_px > 0:
                disparity_px = np.round(disparity_px / optics.step_px) * optics.step_px
        with np.errstate(divide="ignore", invalid="ignore"):
            depth_m = fx * optics.baseline_m / disparity_px
            depth_m[~((depth_m >= optics.range_m[0]) & (depth_m <= optics.range_m[1]))] = np.nan
        return depth_m.astype(np.float32)

    def _correlate(self, disparity_px: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
        """Keep pixels with sufficient agreement in the window, as the mean of the agreeing values."""
        half = self.optics.window_px // 2
        padded = np.pad(disparity_px, half, constant_values=np.nan).astype(np.float32)
        height, width = disparity_px.shape
        count, total = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
        centre = disparity_px.astype(np.float32)
        tolerance = np.float32(self.optics.window_tolerance_px)
        for i in range(2 * half + 1):
            for j in range(2 * half + 1):
                difference = padded[i : i + height, j : j + width] - centre
                near = np.abs(difference) <= tolerance
                count += near
                total += np.where(near, difference, 0)
        kept = count >= self.optics.window_fraction * self.optics.window_px**2
        return np.where(kept, disparity_px + total / np.maximum(count, 1), np.nan)

    def _glints(
        self,
        disparity_px: Float[np.ndarray, "h w"],
        found: Float[np.ndarray, "h w 11"],
        eye: Float[np.ndarray, "3"],
        projector: Float[np.ndarray, "3"],
        rotation: Float[np.ndarray, "3 3"],
        focal_baseline: float,
    ) -> None:
        """Saturation, or the depth of the glass, where it reflects the projector (in place)."""
        distance_m = found[..., 7]
        i, j = np.nonzero(distance_m > 0)
        if not len(i):
            return
        camera = self.camera
        slopes = np.column_stack(
            [
                (j - camera.matrix[0, 2]) / camera.matrix[0, 0],
                (i - camera.matrix[1, 2]) / camera.matrix[1, 1],
                np.ones(len(i)),
            ]
        )
        rays = slopes / np.linalg.norm(slopes, axis=1, keepdims=True) @ rotation.T
        points = eye + distance_m[i, j, None] * rays
        to_light = projector - points
        to_light /= np.linalg.norm(to_light, axis=1, keepdims=True)
        half = to_light - rays
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        off_rad = np.arccos(np.clip((half * found[i, j, 8:11]).sum(axis=1), -1, 1))
        shown = off_rad < self.optics.glint_return_rad
        depth_m = (points - eye) @ rotation[:, 2]
        disparity_px[i[shown], j[shown]] = focal_baseline / depth_m[shown]
        blinded = off_rad < self.optics.glint_rad
        disparity_px[i[blinded], j[blinded]] = np.nan

    @staticmethod
    def _noise(rng: np.random.Generator, shape: tuple[int, int]) -> Float[np.ndarray, "h w"]:
        """Unit noise, half of its variance is correlated between neighbours: correlation windows overlap."""
        import cv2

        alone = rng.standard_normal(shape)
        shared = cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), 1.5) * (2 * math.sqrt(math.pi) * 1.5)
        return math.sqrt(0.5) * (alone + shared)
