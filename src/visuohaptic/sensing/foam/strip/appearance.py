"""Is it still the foam that we see between both contours? Covered points look different from the rest."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from ....core.kernels import kernel

__all__ = ["covered_points", "front_grey", "interior_grey", "other_surface"]

#: Samples per line and the part of the visible foam that they span: away from both blurred edges.
_SAMPLES = 12
_FROM, _TO = 0.2, 0.8

#: The foam just behind the front: from the end of the blur of its edge on [px].
_BEHIND_PX, _BAND_PX = 5, 10

#: Its grey level may differ by this fraction from what it was at rest, or so many sigmas.
_SAME_SURFACE, _SAME_SIGMAS = 0.015, 4.0

#: A point is covered when its grey level, after removal of the light that is common to the strip,
#: differs from its neighbours' by more than this fraction.
_TOLERANCE = 0.12

#: So many neighbours that differ alike need less: this fraction, and so many sigmas of their mean.
_TOGETHER, _TOLERANCE_TOGETHER, _SIGMAS_TOGETHER = 5, 0.045, 6.0


@kernel
def interior_grey(image, origin_px, direction_px, extent_px):
    """Mean grey level along each line between 20 % and 80 % of its extent; NaN outside the image.

    Parameters
    ----------
    image
        Grey image.
    origin_px
        Origins of K lines (x, y) [px].
    direction_px
        Their unit directions.
    extent_px
        Their lengths [px].
    """
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


@kernel
def front_grey(image, front_px, direction_px, extent_px):
    """Mean grey level of the last foam before the front's edge; NaN where there is none.

    At most the last third of ``extent_px``, the visible foam.

    Parameters
    ----------
    image
        Grey image.
    front_px
        Points of the front (x, y) [px].
    direction_px
        Unit directions of the lines, from the base to the front.
    extent_px
        Visible foam before each point [px].
    """
    rows, columns = image.shape
    count = front_px.shape[0]
    result = np.full(count, np.nan)
    for k in range(count):
        total = 0.0
        samples = min(_BAND_PX, int(extent_px[k] / 3.0) - _BEHIND_PX)
        if samples < 3:
            continue
        for j in range(samples):
            x = front_px[k, 0] - (_BEHIND_PX + j) * direction_px[k, 0]
            y = front_px[k, 1] - (_BEHIND_PX + j) * direction_px[k, 1]
            if not (0.0 <= x < columns - 0.5 and 0.0 <= y < rows - 0.5):
                samples = 0
                break
            total += image[int(y + 0.5), int(x + 0.5)]
        if samples:
            result[k] = total / samples
    return result


def other_surface(
    near: Float[np.ndarray, "K"],
    near_rest: Float[np.ndarray, "K"],
    contrast: Float[np.ndarray, "K"],
    contrast_rest: Float[np.ndarray, "K"],
    seen: Bool[np.ndarray, "K"],
    noise: Float[np.ndarray, "K"],
) -> Bool[np.ndarray, "K"]:
    """Points whose edge is not the foam's, but one on the object behind it.

    An object as grey as the foam hides the front, and its next edge is taken instead. Then the
    edge is another than at rest (the other way round, or half as strong), and what lies before it is
    a little brighter or darker than foam. Neither alone says anything: objects are of any
    grey, and they cast shadows.

    Parameters
    ----------
    near, near_rest
        Grey level just before the front by that of the whole line, now and at rest.
    contrast, contrast_rest
        Step at the front, signed [grey levels in the light of now].
    seen
        Points to look at.
    noise
        Standard deviation of ``near`` by the noise of the pixels.
    """
    with np.errstate(invalid="ignore"):
        odd = seen & (contrast * np.sign(contrast_rest) < 0.5 * np.abs(contrast_rest))
        change = near / near_rest - 1.0
    other = np.zeros(len(near), dtype=bool)
    if not odd.any():
        return other
    calm = change[seen & ~odd & np.isfinite(change)]
    # Texture of the foam counts as noise, as far as foam is seen.
    texture = 1.4826 * float(np.median(np.abs(calm))) if len(calm) >= 8 else 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[0], odd.astype(np.int8), [0]])))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        run = change[first:last]
        run = run[np.isfinite(run)]
        if not len(run):
            continue
        sigma = max(texture, float(np.median(noise[first:last]))) / np.sqrt(len(run))
        other[first:last] = abs(float(run.mean())) > max(_SAME_SURFACE, _SAME_SIGMAS * sigma)
    return other


def covered_points(
    grey: Float[np.ndarray, "K"], zero_grey: Float[np.ndarray, "K"], s: Float[np.ndarray, "K"]
) -> Bool[np.ndarray, "K"]:
    """Points whose foam looks different from the zero reference.

    The light may change by a factor that varies slowly along the strip (a straight line in s,
    fitted robustly); a local difference means that something covers the foam. Neighbours that
    differ alike are judged together.

    Parameters
    ----------
    grey, zero_grey
        Mean grey level of the foam on each line, now and at rest.
    s
        Position of the points along the strip [m].
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
    change = np.where(seen, (ratio - light) / np.abs(light), 0.0)
    covered: Bool[np.ndarray, "K"] = ~seen | (np.abs(change) > _TOLERANCE)
    scatter = 1.4826 * float(np.median(np.abs(change[seen])))
    limit = max(_TOLERANCE_TOGETHER, _SIGMAS_TOGETHER * scatter / np.sqrt(_TOGETHER))
    # Something of nearly the foam's grey: a little, but the same on all points that it covers.
    mean = np.convolve(change, np.full(_TOGETHER, 1.0 / _TOGETHER), mode="valid")
    for first in np.flatnonzero(np.abs(mean) > limit):
        run = slice(first, first + _TOGETHER)
        covered[run] |= np.sign(mean[first]) * change[run] > 0.5 * limit
    return covered
