"""Masking of depth readings through transparent regions: they do not measure a surface.

An empty bottle refracts little, so the camera sees the inside of its own label through it, and the fusion
would create an inner wall. Readings through a transparent region are excluded from the fusion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...io.depth.depth_sequence import DepthFrame
from .regions import TransparentRegion

__all__ = ["mask_refracted_rays"]


def mask_refracted_rays(
    frame: DepthFrame, regions: Sequence[TransparentRegion], *, min_m: float = 0.01
) -> DepthFrame:
    """The frame without readings through one of the regions.

    Parameters
    ----------
    frame
        View to mask.
    regions
        Transparent parts.
    min_m
        Minimum path length inside a hull of a masked reading [m]: hulls are a voxel or two too large, and
        surfaces behind their margins are still seen directly.
    """
    from .._hull_kernels import mask_through

    depth_m = None
    camera, pose = frame.camera, frame.T_world_camera
    matrix = camera.matrix
    for region in regions:
        corners = pose.inverse().apply(region.hull_m)
        if corners[:, 2].max() <= 0.05:
            continue
        if corners[:, 2].min() > 0.05:
            u = matrix[0, 0] * corners[:, 0] / corners[:, 2] + matrix[0, 2]
            v = matrix[1, 1] * corners[:, 1] / corners[:, 2] + matrix[1, 2]
            box = np.array([[v.min(), v.max()], [u.min(), u.max()]])
        else:  # the camera is beside or inside the hull
            box = np.array([[0.0, camera.height], [0.0, camera.width]])
        last = np.array([[camera.height - 1], [camera.width - 1]])
        first_last = np.clip(np.stack([np.floor(box[:, 0]), np.ceil(box[:, 1])], axis=1), 0, last)
        rows, columns = first_last.astype(np.int64)
        planes = region.planes @ pose.matrix
        if depth_m is None:
            depth_m = frame.depth_m.copy()
        mask_through(
            depth_m, planes, rows, columns, matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], min_m
        )
    return frame if depth_m is None else replace(frame, depth_m=depth_m)
