"""Projection of pixels onto a plane in space, Alt 2016, Eq. (3.7) with the signs of its errata."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .model import Camera
from .pose import Pose


@dataclass(frozen=True, slots=True, eq=False)
class PlaneView:
    """The x-y plane of a frame F as seen by a camera.

    ``cast`` is the operator P of Eq. (3.7): ``u' = K^-1 u`` after undistortion,
    ``X_C = (X_0 . n) / (u' . n) u'``, ``X_F = R^T (X_C - X_0)`` with ``n = R[:, 2]``.
    ``project`` is its inverse.
    """

    camera: Camera
    T_camera_plane: Pose  #: maps coordinates of F to the camera frame

    def cast(self, pixels: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
        """Points of the plane seen at pixels.

        Parameters
        ----------
        pixels
            Image positions, as in :meth:`.Camera.rays`.

        Returns
        -------
        array
            Points (x, y) of F, shape (..., 2) [m]; NaN where the ray misses the plane.
        """
        rays = self.camera.rays(pixels)
        normal = self.T_camera_plane.rotation[:, 2]
        origin = self.T_camera_plane.translation_m
        along = rays @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (origin @ normal) / along
        depth = np.where(np.isfinite(depth) & (depth > 0), depth, np.nan)
        points_camera = rays * depth[..., None]
        return ((points_camera - origin) @ self.T_camera_plane.rotation)[..., :2]

    def project(self, points_plane_m: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
        """Pixels of points of the plane.

        Parameters
        ----------
        points_plane_m
            Points (x, y) of F, shape (..., 2) [m].

        Returns
        -------
        array
            Pixels (x, y), shape (..., 2) [px].
        """
        points = np.asarray(points_plane_m, dtype=np.float64)
        spatial = np.concatenate([points, np.zeros((*points.shape[:-1], 1))], axis=-1)
        return self.camera.project(self.T_camera_plane.apply(spatial))

    def jacobian(self, pixels: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2 2"]:
        """d(x, y)/d(u) [m/px] by central differences over one pixel.

        The half-pixel step has a relative error of the order (1/f)^2, far below any
        uncertainty that is propagated with this derivative.

        Parameters
        ----------
        pixels
            As in :meth:`cast`.

        Returns
        -------
        array
            Derivatives, shape (..., 2, 2) [m/px]: rows are x and y of F, columns are x and y of the
            pixel.
        """
        pixels = np.asarray(pixels, dtype=np.float64)
        columns = []
        for axis in range(2):
            step = np.zeros(2)
            step[axis] = 0.5
            columns.append(self.cast(pixels + step) - self.cast(pixels - step))
        return np.stack(columns, axis=-1)
