"""Soft darkening of the floor around objects that stand on it or are close to it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from ._solids import at_height
from .appearance import Look
from .rolling_view import RollingView
from .scene import FoamScene

#: The shadow is soft: it is computed on an image this many times smaller.
_REDUCTION = 8


def shade_floor(
    view: RollingView, scene: FoamScene, outlines_m: list[np.ndarray], look: Look
) -> Float32[np.ndarray, "rows columns"]:
    """Light of the floor in each pixel of the image, reduced around the feet of outlines.

    Parameters
    ----------
    view
        Camera.
    scene
        Heights of the floor.
    outlines_m
        Outlines (n, K, 2) in frame F [m].
    look
        Strength and width of the shadow.
    """
    import cv2

    rows, columns = view.camera.height, view.camera.width
    small = np.zeros((rows // _REDUCTION + 1, columns // _REDUCTION + 1), np.uint8)
    for outline in outlines_m:
        polygon = view.polygon(at_height(outline, -scene.floor_below_m))
        if len(polygon) >= 3:
            fixed = np.rint((polygon + 0.5) / _REDUCTION * 16 - 8).astype(np.int32)
            cv2.fillPoly(small, [fixed], 255, shift=4)
    distance_m = float(np.linalg.norm(view.centre_foam_m))
    sigma = 0.6 * look.shadow_reach_m * view.camera.focal_px / distance_m / _REDUCTION
    soft = cv2.GaussianBlur(small.astype(np.float32), (0, 0), max(sigma, 0.3))
    factor = cv2.resize(
        1 - look.shadow / 255 * soft, (small.shape[1] * _REDUCTION, small.shape[0] * _REDUCTION)
    )
    return factor[:rows, :columns]
