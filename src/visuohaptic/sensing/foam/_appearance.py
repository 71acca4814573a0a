"""Is it still the foam that we see between both contours? Covered points look different from the rest."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numba import njit

__all__ = ["covered_points", "interior_grey"]

#: Samples per line and the part of the visible foam that they span: away from both blurred edges.
_SAMPLES = 12
_FROM, _TO = 0.2, 0.8

#: A point is covered when its grey level, after removal of the light that is common to the strip,
#: differs from its neighbours' by more than this fraction.
_TOLERANCE = 0.12


@njit("float64[:](uint8[:,::1], float64[:,::1], float64[:,::1], float64[:])", cache=True)
def interior_grey(image, origin_px, direction_px, extent_px):  # type: ignore[no-untyped-def]
    """Mean grey level along each line between 20 % and 80 % of its extent; NaN outside the image."""
    rows, columns = image.shape
    count = origin_px.shape[0]
    result = np.empty(count)
    for k in range(count):
        total = 0.0
        inside = True
        for j in range(_SAMPLES):
            t = extent_px[k] * (_FROM + (_TO - _FROM) * j / (_SAMPLES - 1))
            x = origin_px[k, 0] + t * direction_px[k, 0]
            y = origin_px[k, 1] + t * direction_px[k, 1]
            if not (0.0 <= x < columns - 0.5 and 0.0 <= y < rows - 0.5):
                inside = False
                break
            total += image[int(y + 0.5), int(x + 0.5)]
        result[k] = total / _SAMPLES if inside else np.nan
    return result


def covered_points(
    grey: Float[np.ndarray, "K"], zero_grey: Float[np.ndarray, "K"], s: Float[np.ndarray, "K"]
) -> Bool[np.ndarray, "K"]:
    """Points whose foam looks different from the zero reference.

    The light may change by a factor that varies slowly along the strip (a straight line in s,
    fitted robustly); a local difference means that something covers the foam.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = grey / zero_grey
    seen = np.isfinite(ratio)
    if seen.sum() < 8:
        return np.ones(len(grey), dtype=bool)
    centred = s - s.mean()
    design = np.column_stack([np.ones_like(centred), centred / max(np.abs(centred).max(), 1e-12)])
    keep = seen
    coefficients = np.array([float(np.median(ratio[seen])), 0.0])
    for _ in range(3):
        residual = ratio - design @ coefficients
        limit = max(0.03, 3.0 * 1.4826 * float(np.median(np.abs(residual[keep]))))
        keep = seen & (np.abs(residual) < limit)
        if keep.sum() < 8:
            break
        coefficients = np.linalg.lstsq(design[keep], ratio[keep], rcond=None)[0]
    light = design @ coefficients
    covered: Bool[np.ndarray, "K"] = ~seen | (np.abs(ratio - light) > _TOLERANCE * np.abs(light))
    return covered
