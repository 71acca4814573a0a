"""Lens distortion of a flat template: displacement beyond the homography through its corners."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from ...core import Camera, Pose
from ..points.homography import apply_homography, estimate_homography
from .template import Template


def lens_samples(camera: Camera, template: Template, pose: Pose) -> Float32[np.ndarray, "17 17 2"]:
    """Displacement by the lens beyond the homography through the four corners [px], at 17 x 17 points.

    Parameters
    ----------
    camera
        Intrinsics and distortion.
    template
        Flat print.
    pose
        Maps the template to the camera's frame.
    """
    rows, columns = template.image.shape
    x, y = np.meshgrid(np.linspace(0, columns - 1, 17), np.linspace(0, rows - 1, 17))
    pixels = np.stack([x, y], axis=-1)
    seen = camera.project(pose.apply(template.points_m(pixels)))
    corners = camera.project(pose.apply(template.points_m(template.esm.corners)))
    homography = estimate_homography(template.esm.corners, corners)
    return np.nan_to_num((seen - apply_homography(homography, pixels)).astype(np.float32))


def lens_offset(samples: Float32[np.ndarray, "17 17 2"], template: Template) -> Float32[np.ndarray, "2 R C"]:
    """Lens displacement at every pixel of the template.

    It is smooth: 17 x 17 exact points and cubic interpolation have an error below 1e-3 px.

    Parameters
    ----------
    samples
        Result of :func:`lens_samples` [px].
    template
        The same template, of R x C pixels.
    """
    import cv2

    rows, columns = template.image.shape
    # The first and last sample are on the first and last pixel: scale by samples - 1, not by size.
    sample_x = np.tile(np.linspace(0, 16, columns, dtype=np.float32), (rows, 1))
    sample_y = np.repeat(np.linspace(0, 16, rows, dtype=np.float32)[:, None], columns, axis=1)
    spread = cv2.remap(samples, sample_x, sample_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.ascontiguousarray(spread.transpose(2, 0, 1))
