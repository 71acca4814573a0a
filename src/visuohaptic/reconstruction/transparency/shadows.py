"""Where a structured-light camera must fail: shadows of its projector, edges, grazing surfaces.

Alt 2016, 5.1 names these as sources of holes; predicted from the expected
surface they can be told from holes that only glass explains.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32

__all__ = ["explained_dropouts"]


def explained_dropouts(
    predicted_m: Float32[np.ndarray, "h w"],
    focal_px: float,
    baseline_m: float,
    *,
    edge_px: int = 3,
    edge_m: float = 0.03,
    grazing_slope: float = 4.0,
    range_m: tuple[float, float] = (0.4, 3.5),
) -> Bool[np.ndarray, "h w"]:
    """Pixels at which a missing depth says nothing.

    Parameters
    ----------
    predicted_m
        Expected depth of the opaque surface, 0 where nothing is known [m].
    focal_px
        Focal length [px].
    baseline_m
        Projector from the camera along its x; 0 = not known, no shadows are predicted [m].
    edge_px
        Margin around edges, shadows and the unknown: about the correlation window [px].
    edge_m
        Step between neighbours that is an edge, at 1 m [m].
    grazing_slope
        Tangent of the angle of incidence beyond which the pattern is too compressed.
    range_m
        Depths that the camera can tell [m].
    """
    import cv2

    from ._consistency_kernels import projector_shadow

    known = predicted_m > 0
    failing = ~known | (predicted_m < range_m[0]) | (predicted_m > range_m[1])
    if baseline_m != 0:
        shadow = np.zeros(predicted_m.shape, np.uint8)
        projector_shadow(predicted_m, focal_px * baseline_m, 0.5, shadow)
        failing |= shadow > 0
    for axis in (0, 1):
        ahead = np.diff(predicted_m, axis=axis)
        both = np.minimum(*(np.take(predicted_m, s, axis) for s in (_front(ahead, axis), _back(ahead, axis))))
        steep = np.abs(ahead) * focal_px > grazing_slope * np.maximum(both, 0.1)
        steep &= np.abs(ahead) > edge_m * np.maximum(both, 0.3) * 0.3
        sides = [(0, 1), (1, 0)]
        for before, after in sides:
            pad = [(0, 0), (0, 0)]
            pad[axis] = (before, after)
            failing |= np.pad(steep, pad)
    edge = 2 * edge_px + 1
    return cv2.dilate(failing.astype(np.uint8), np.ones((edge, edge), np.uint8)) > 0


def _front(ahead: Float32[np.ndarray, "h w"], axis: int) -> np.ndarray:
    return np.arange(ahead.shape[axis])


def _back(ahead: Float32[np.ndarray, "h w"], axis: int) -> np.ndarray:
    return np.arange(1, ahead.shape[axis] + 1)
