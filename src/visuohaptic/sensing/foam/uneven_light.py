"""Shift of the front due to uneven light: the edge of a shadow within the blur of the front, or beside it.

The edge of a shadow at a distance u from the front, with a fraction a of the whole step, merges with the front into one step
that is shifted by a u and whose variance is increased by a (1 - a) u^2. Hence shift^2 = a / (1 - a) times the excess of the
squared blur over that of the base in the same image. The excess is negative where light increases as grey decreases. The
edge of a shadow farther away tilts the grey levels beside the front: the level that is extrapolated over a plateau with a
step of d in its middle has an error of d / 4, which shifts an edge of blur b and contrast C by sqrt(2 pi) / 4 b d / C. Both
errors are shared by neighbours, as far as these agree beyond their own scatter.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Num

from ...tracking.contours.contour import PIXEL_PX, quick_median
from ._light_kernels import local_medians, mean_between
from .strip.optics import ObservedStrip
from .strip.zero import ZeroReference

#: Fraction a of the step that is due to a shadow within the blur: the ratio of squared shift to excess squared blur is 0.05
#: to 0.19 over 1,300 positions of shadows of 10 to 60 %.
_SHADOW_PART = 0.11
#: Length of each of the two parts of the plateau between which the light is compared [px].
_PLATEAU_PX = 4.0
#: Minimum number of edges at rest for estimating their scatter, to a fifth.
SCATTER_POINTS = 24
#: An excess blur of more than this many standard deviations is attributed to a gap, such a change of light to a shadow: the
#: false-alarm rate is one in forty edges at rest.
_CHANCE_SIGMAS = 2.0


def blur_excess_px2(
    strip: ObservedStrip, zero: ZeroReference, moved_px: Float[np.ndarray, "K"]
) -> Float[np.ndarray, "K"]:
    """Excess of the squared blur of each edge over that of lens and motion [px^2]; NaN where no edge was observed.

    Parameters
    ----------
    strip, zero
        Observation of the strip in this image, and the strip at rest.
    moved_px
        Distance that each edge has moved since the last frame [px].
    """
    seen = strip.usable & (not strip.stripe)
    excess = np.where(seen, strip.front.blur_px**2 - (zero.blur_ratio * strip.lens_px) ** 2, np.nan)
    # Upper limit of motion blur: a shutter open for the whole frame interval (box filter).
    return np.where(excess > 0.0, np.maximum(excess - moved_px**2 / 12.0, 0.0), excess)


def gap_shift_px(
    strip: ObservedStrip,
    zero: ZeroReference,
    rest_px: Float[np.ndarray, "K"],
    excess_px2: Float[np.ndarray, "K"],
) -> tuple[Float[np.ndarray, "K"], Float[np.ndarray, "K"]]:
    """Shift of each edge beyond the front due to a gap in front of a body, and its error [px].

    Between foam and body there is a gap of floor. If it is narrower than the blur, its two edges merge into one. The fraction
    a of this edge that is due to the body follows from the excess contrast relative to the floor at rest.

    Parameters
    ----------
    strip, zero
        As in :func:`blur_excess_px2`.
    rest_px
        Position of the front at rest along each line [px].
    excess_px2
        From :func:`blur_excess_px2`; its scatter over edges at rest is its uncertainty.
    """
    ends = 2.0 * np.hypot(strip.lens_px, PIXEL_PX) + _PLATEAU_PX * np.array([0.0, 2.0])
    at_rest = _means(zero.image, rest_px[:, None] + np.concatenate([-ends[::-1], ends]), strip)
    contrast, beyond = strip.front.contrast, strip.front.level
    moved = np.abs(strip.front.position_px - rest_px)
    scatter = excess_px2[(moved < 1.0) & np.isfinite(excess_px2)]
    if len(scatter) < SCATTER_POINTS:
        return np.zeros(len(rest_px)), np.zeros(len(rest_px))
    # Median absolute deviation: a standard deviation would include edges beside a gap. An edge that has moved has other texture than at rest,
    # and a blurred step has half as much information on its blur as on its position.
    still = 1.4826 * quick_median(np.abs(scatter - quick_median(scatter)))
    texture = (strip.front.sigma_px**2 - strip.front.noise_px**2) * (1.0 - np.exp(-0.5 * moved**2))
    error = np.sqrt(still**2 + 8.0 * strip.front.blur_px**2 * np.maximum(texture, 0.0))
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
    """Standard deviation of the position of each edge due to uneven light [px], shared by neighbours.

    Parameters
    ----------
    strip, zero
        As in :func:`blur_excess_px2`.
    rest_px
        Position of the front at rest along each line [px].
    excess_px2
        From :func:`blur_excess_px2`; NaN where a gap explains it.
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
    # Values that neighbours have in common by chance are not attributed to light.
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
    """Mean grey levels between n = m + 1 positions on each line; NaN where there is none."""
    result = np.empty((len(place_px), place_px.shape[1] - 1))
    mean_between(image, place_px / strip.step_px[:, None], result)
    return result


def local_statistics(values: Float[np.ndarray, "K"]) -> Float[np.ndarray, "3 K"]:
    """Median over each point and four neighbours to either side, its standard error from their scatter, and their range.

    Parameters
    ----------
    values
        One value for each point, NaN where unknown; where all are unknown, the result is zero.
    """
    result = np.empty((3, len(values)))
    local_medians(np.ascontiguousarray(values), result)
    return result
