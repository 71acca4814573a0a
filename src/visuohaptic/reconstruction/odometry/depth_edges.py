"""Depth steps of a view: where a near surface ends before a farther one, with the direction across the step.

Planes leave a camera free to slide along them; the borders of a table and of what stands on it do not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from ...core.camera.model import Camera

#: A step exceeds this fraction of the depth, beyond what a surface rises within the gap whose normal is 73 degrees
#: (this tangent) off the line of sight.
_STEP, _GRAZING = 0.05, 3.3
#: Widest gap without readings between both sides of a step, as a fraction of the image: shadow of the second eye.
_GAP = 0.05
#: Radius over which the direction across a step is averaged [px].
_SMOOTH_PX = 2.0
#: Maximum number of points of a view.
_POINTS = 400


@dataclass(frozen=True, slots=True, eq=False)
class DepthEdges:
    """Steps of one view."""

    points_m: Float[np.ndarray, "n 3"]  #: on the nearer side, camera frame [m]
    nearest: Int[np.ndarray, "2 h w"]  #: row and column of the edge pixel next to each pixel
    distance_px: Float32[np.ndarray, "h w"]  #: from each pixel to it [px]
    across: Float32[np.ndarray, "2 h w"]  #: unit vector across the edge (x, y)


def depth_edges(depth_m: Float32[np.ndarray, "h w"], camera: Camera) -> DepthEdges:
    """Steps of a depth image.

    Parameters
    ----------
    depth_m
        Depth image of a camera without distortion [m]; NaN: not measured.
    camera
        Its model.
    """
    from scipy.ndimage import distance_transform_edt, gaussian_filter

    fx, fy, cx, cy = camera.matrix[0, 0], camera.matrix[1, 1], camera.matrix[0, 2], camera.matrix[1, 2]
    found = np.zeros(depth_m.shape, bool)
    for view, mask in ((depth_m, found), (depth_m.T, found.T)):
        mask |= _steps(view, fx)
        mask[:, ::-1] |= _steps(view[:, ::-1], fx)
    border = round(_SMOOTH_PX) + 1
    found[:border] = found[-border:] = found[:, :border] = found[:, -border:] = False
    measured = np.isfinite(depth_m)
    if not (found.any() and measured.any()):
        none = np.zeros((2, *depth_m.shape), np.float32)
        return DepthEdges(
            np.zeros((0, 3)), none.astype(int), np.full(depth_m.shape, np.inf, np.float32), none
        )
    distance, nearest = distance_transform_edt(~found, return_indices=True)
    fill = distance_transform_edt(~measured, return_distances=False, return_indices=True)
    rise = np.array(np.gradient(gaussian_filter(1 / depth_m[fill[0], fill[1]], _SMOOTH_PX)))[::-1]
    across = rise / (np.hypot(*rise) + 1e-12)
    i, j = np.nonzero(found)
    chosen = np.linspace(0, len(i) - 1, min(len(i), _POINTS)).astype(int)
    i, j, z = i[chosen], j[chosen], depth_m[i[chosen], j[chosen]].astype(float)
    points = np.stack([(j - cx) / fx * z, (i - cy) / fy * z, z], axis=1)
    return DepthEdges(points, nearest, distance.astype(np.float32), across.astype(np.float32))


def _steps(depth_m: Float32[np.ndarray, "h w"], focal_px: float) -> Bool[np.ndarray, "h w"]:
    """Pixels that are nearer than the last reading to their left."""
    height, width = depth_m.shape
    number = np.where(np.isfinite(depth_m), np.arange(width), -1)
    last = np.maximum.accumulate(number, axis=1)
    before = np.concatenate([np.full((height, 1), -1), last[:, :-1]], axis=1)
    gap = np.arange(width) - before
    behind = np.take_along_axis(depth_m, np.maximum(before, 0), 1)
    with np.errstate(invalid="ignore"):
        step = behind - depth_m > depth_m * (_STEP + _GRAZING * gap / focal_px)
    found: Bool[np.ndarray, "h w"] = (number >= 0) & (before >= 0) & (gap <= max(1, _GAP * width)) & step
    return found
