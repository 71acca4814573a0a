"""What light that is not even may shift the front by: a shadow's edge within its blur, or beside it.

A shadow's edge at a distance u from the front, with a part a of the whole step, and the front look like one step
that is shifted by a u, and whose variance is raised by a (1 - a) u^2, so that shift^2 = a / (1 - a) times what the square
of the blur has more than that of the base in the same image. It has less where light rises as grey falls. A shadow's edge
farther away tilts the grey levels beside the front: the level that is extrapolated over a plateau with a step of d in its
middle is wrong by d / 4, which shifts an edge of a blur b and a contrast C by sqrt(2 pi) / 4 b d / C. Both are errors that
neighbours share, as far as they agree beyond their own scatter.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Num

from ...tracking.contours.contour import PIXEL_PX
from ._light_kernels import local_medians, mean_between
from .strip.optics import ObservedStrip
from .strip.zero import ZeroReference

__all__ = ["SCATTER_POINTS", "blur_excess_px2", "gap_shift_px", "light_shift_px", "local_statistics"]

#: Part a of the step that a shadow within the blur has: the squares of shifts by those of the blur are 0.05 to 0.19 over
#: 1,300 places of shadows of 10 to 60 %.
_SHADOW_PART = 0.11
#: Lengths of both parts of the plateau in which the light is compared [px].
_PLATEAU_PX = 4.0
#: Edges at rest from which on their scatter is known: to a fifth.
SCATTER_POINTS = 24
#: An excess of the blur by so many standard deviations is a gap's, a change of the light by as many a shadow's: one edge
#: in forty at rest has it by chance.
_CHANCE_SIGMAS = 2.0


def blur_excess_px2(
    strip: ObservedStrip, zero: ZeroReference, moved_px: Float[np.ndarray, "K"]
) -> Float[np.ndarray, "K"]:
    """What the square of each edge's blur has more than lens and motion make [px^2]; NaN where no edge was seen.

    Parameters
    ----------
    strip, zero
        What this image shows, and the strip at rest.
    moved_px
        How far each edge has moved since the last frame [px].
    """
    seen = strip.usable & (not strip.stripe)
    excess = np.where(seen, strip.front.blur_px**2 - (zero.blur_ratio * strip.lens_px) ** 2, np.nan)
    # A shutter that is open from frame to frame, at the most, sees the edge move by a box.
    return np.where(excess > 0.0, np.maximum(excess - moved_px**2 / 12.0, 0.0), excess)


def gap_shift_px(
    strip: ObservedStrip,
    zero: ZeroReference,
    rest_px: Float[np.ndarray, "K"],
    excess_px2: Float[np.ndarray, "K"],
) -> tuple[Float[np.ndarray, "K"], Float[np.ndarray, "K"]]:
    """How far beyond the front each edge lies by a gap before a body, and the error of that [px].

    Between foam and body lies a gap of floor. Narrower than the blur, both its edges look like one; the part a of it that is
    the body's is known: what the contrast has more than that to the floor at rest.

    Parameters
    ----------
    strip, zero
        What this image shows, and the strip at rest.
    rest_px
        Place of the front at rest along each line [px].
    excess_px2
        From :func:`blur_excess_px2`; that of edges at rest shows how uncertain it is.
    """
    ends = 2.0 * np.hypot(strip.lens_px, PIXEL_PX) + _PLATEAU_PX * np.array([0.0, 2.0])
    at_rest = _means(zero.image, rest_px[:, None] + np.concatenate([-ends[::-1], ends]), strip)
    contrast, beyond = strip.front.contrast, strip.front.level
    still = np.abs(strip.front.position_px - rest_px) < 1.0
    scatter = excess_px2[still & np.isfinite(excess_px2)]
    error = (
        float(np.std(scatter)) if len(scatter) >= SCATTER_POINTS else math.inf
    )  # then nothing is called a gap
    with np.errstate(invalid="ignore", divide="ignore"):
        part = 1.0 + (beyond / contrast - 1.0) * (1.0 - at_rest[:, 2] / at_rest[:, 0])
        square, sigma = part / (1.0 - part) * excess_px2, np.abs(part / (1.0 - part)) * error
        shift = np.sqrt(np.maximum(square - _CHANCE_SIGMAS * sigma, 0.0))
        sigma = np.where(shift > 0.0, 0.5 * sigma / shift, 0.0)
    found = np.isfinite(shift) & np.isfinite(sigma)
    return np.where(found, np.sign(part) * shift, 0.0), np.where(found, np.minimum(sigma, shift), 0.0)


def light_shift_px(
    strip: ObservedStrip,
    zero: ZeroReference,
    rest_px: Float[np.ndarray, "K"],
    excess_px2: Float[np.ndarray, "K"],
) -> Float[np.ndarray, "K"]:
    """Standard deviation of each edge's place by uneven light [px], which neighbours share.

    Parameters
    ----------
    strip, zero
        What this image shows, and the strip at rest.
    rest_px
        Place of the front at rest along each line [px].
    excess_px2
        From :func:`blur_excess_px2`, without what is explained otherwise.
    """
    if strip.stripe:
        return np.zeros(len(rest_px))
    front = np.where(strip.usable, strip.front.position_px, np.nan)
    local = [excess_px2]
    blur = np.hypot(strip.lens_px, PIXEL_PX)
    ends = blur * 2.0 + _PLATEAU_PX * np.arange(3.0)
    floor = np.where(np.abs(front - rest_px) < 2.0 * blur, rest_px, np.nan)
    for edges in (front[:, None] - ends[::-1], floor[:, None] + ends):
        now, rest = (_means(image, edges, strip) for image in (strip.image, zero.image))
        with np.errstate(invalid="ignore", divide="ignore"):
            step = np.diff(now / rest, axis=1)[:, 0] * rest.mean(axis=1) / strip.front.contrast
        local.append(np.where(np.isfinite(step), step, np.nan))
    (shadow, error, _), *steps = (local_statistics(values) for values in local)
    # What neighbours have in common by chance is none of the light.
    unlike = np.abs(shadow) > _CHANCE_SIGMAS * error
    variance = _SHADOW_PART / (1.0 - _SHADOW_PART) * np.where(unlike, np.abs(shadow) - error, 0.0)
    for step, error, _ in steps:
        unlike = np.abs(step) > _CHANCE_SIGMAS * error
        variance += 0.125 * math.pi * blur**2 * np.where(unlike, step**2 - error**2, 0.0)
    result: Float[np.ndarray, "K"] = np.sqrt(np.where(np.isfinite(variance), variance, 0.0))
    return result


def _means(
    image: Num[np.ndarray, "K parallels samples"], place_px: Float[np.ndarray, "K n"], strip: ObservedStrip
) -> Float[np.ndarray, "K m"]:
    """Mean grey levels between n = m + 1 places of each line; NaN where there is none."""
    result = np.empty((len(place_px), place_px.shape[1] - 1))
    mean_between(image, place_px / strip.step_px[:, None], result)
    return result


def local_statistics(values: Float[np.ndarray, "K"]) -> Float[np.ndarray, "3 K"]:
    """Median of each point and four to either side, its standard error by their scatter, and their range.

    Parameters
    ----------
    values
        One for each point, NaN where it is not known; where none of them is, the result is zero.
    """
    result = np.empty((3, len(values)))
    local_medians(np.ascontiguousarray(values), result)
    return result
