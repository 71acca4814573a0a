"""What the pixels on both sides of an edge say: the zero's texture behind it, a shadow or a body before it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...tracking.contours.contour import PIXEL_PX, quick_median
from ._chain_kernels import FOAM, OCCLUDER, SHADOW
from ._light_kernels import mean_between
from ._posterior_kernels import (
    COUNT,
    COV_PRESSED,
    COV_REST,
    GAIN_PRESSED,
    GAIN_REST,
    OWN,
    VAR_PRESSED,
    VAR_REST,
    foam_bands,
    shadow_odds,
)
from .strip.optics import ObservedStrip
from .strip.zero import ZeroReference
from .uneven_light import local_statistics

__all__ = ["ALIKE", "MAX_ODDS", "image_evidence"]

#: Texture that goes with the foam, stays, or is not that of the zero.
_MOVED, _FIXED, _OTHER = np.log([0.6, 0.3, 0.1])
#: Pixels of a band are not independent: lens, interpolation and JPEG leave half of them.
_INDEPENDENT = 0.5
#: An edge of a body is within a pixel of a given place: two edges on some forty pixels.
_BY_CHANCE = 0.05
#: Mean squared residual of the zero in another light, in variances of the foam, at the most.
_MISFIT = 3.0
#: Largest log-odds of one point by its pixels: a speck must not decide alone.
MAX_ODDS = 12.0
#: Two surfaces have the same grey within this part of it, and neighbours share their surfaces: five are one.
_SAME_GREY, ALIKE = 0.03, 0.2


def image_evidence(
    strip: ObservedStrip,
    zero: ZeroReference,
    rest_px: Float[np.ndarray, "K"],
    seen: Bool[np.ndarray, "K"],
    deflected: Bool[np.ndarray, "K"],
    unary: Float[np.ndarray, "K 4"],
    against: Float[np.ndarray, "K 6"],
) -> None:
    """Log-likelihoods of the pixels on both sides of each edge.

    Parameters
    ----------
    strip, zero
        What this image shows, and the strip at rest.
    rest_px
        Place of the resting front along each line [px].
    seen, deflected
        Points with an edge, and those of them whose edge has moved.
    unary
        Log-likelihood of foam, shadow, occluder and nothing; set.
    against
        Log-odds against foam by kind of evidence; the first two, texture and shadow, are set.
    """
    step = strip.step_px * (strip.image.shape[2] - 1) / (zero.image.shape[2] - 1)
    front = np.where(seen, strip.front.position_px, rest_px) / step
    resting = rest_px / step
    blur = math.hypot(strip.blur_px, PIXEL_PX) / quick_median(step) if np.isfinite(strip.blur_px) else 1.0
    bands = np.empty((len(seen), 9))
    slope = strip.front.slope * strip.across_px / step
    foam_bands(strip.image, zero.image, front, resting, slope, blur, seen, bands)
    used = bands[:, COUNT] > 0.0
    if used.sum() < 6:
        return
    b = bands[used]
    pressed = np.abs(b[:, COV_PRESSED]) * b[:, VAR_REST] > np.abs(b[:, COV_REST]) * b[:, VAR_PRESSED]
    cov, var = (
        np.where(pressed, b[:, COV_PRESSED], b[:, COV_REST]),
        np.where(pressed, b[:, VAR_PRESSED], b[:, VAR_REST]),
    )
    transfer = min(max(quick_median(cov) / max(quick_median(var), 1e-6), 0.0), 1.0)

    def left(cov: Float[np.ndarray, "n"], var: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        return np.maximum(b[:, OWN] - 2.0 * transfer * cov + transfer**2 * var, 0.05)

    moved, fixed = left(b[:, COV_PRESSED], b[:, VAR_PRESSED]), left(b[:, COV_REST], b[:, VAR_REST])
    variance = quick_median(np.minimum(moved, fixed))
    half = 0.5 * _INDEPENDENT * b[:, COUNT]
    odds = [
        np.clip(
            half * (1.0 + np.log(np.maximum(b[:, OWN], 0.05) / variance) - rest / variance),
            -MAX_ODDS,
            MAX_ODDS,
        )
        for rest in (moved, fixed)
    ]
    foam = np.logaddexp(np.logaddexp(_MOVED + odds[0], _FIXED + odds[1]), _OTHER)
    other = np.logaddexp(_FIXED + odds[1], np.log1p(-np.exp(_FIXED)))
    # Why a texture is another one is the same for a run of points: where foam also turns, where it is worn.
    foam = np.where(foam < other, other + ALIKE * (foam - other), foam)
    unary[used, FOAM], unary[used, OCCLUDER] = foam, other
    unary[used, SHADOW] = np.logaddexp(np.log(0.9) + odds[1], _OTHER)
    against[used, 0] = other - foam
    places = _Places(front, resting, slope, blur)
    gain = np.full(len(seen), np.nan)
    gain[used] = np.where(moved < fixed, b[:, GAIN_PRESSED], b[:, GAIN_REST])
    odds_shadow = _shadow_evidence(strip, zero, places, deflected & seen, gain, transfer, variance)
    unary[:, SHADOW] += odds_shadow
    against[:, 1] = odds_shadow


@dataclass(frozen=True, slots=True, eq=False)
class _Places:
    """Edges in the rectified image; all in samples."""

    front: Float[np.ndarray, "K"]
    resting: Float[np.ndarray, "K"]
    slope: Float[np.ndarray, "K"]  #: from one parallel to the next
    blur: float  #: standard deviation


def _shadow_evidence(
    strip: ObservedStrip,
    zero: ZeroReference,
    at: _Places,
    tested: Bool[np.ndarray, "K"],
    gain: Float[np.ndarray, "K"],
    transfer: float,
    variance: float,
) -> Float[np.ndarray, "K"]:
    """Log-odds of a shadow's edge against a body's, by what lies between the edge and where it was at rest."""
    found = np.empty((len(tested), 7))
    lines = np.column_stack(
        [strip.reference_points_px, strip.front.lines.direction_px, strip.step_px, strip.across_px]
    )
    shadow_odds(
        strip.image,
        zero.image,
        lines,
        at.front,
        at.resting,
        at.slope,
        at.blur,
        transfer,
        variance,
        tested,
        found,
    )
    texture, near, between, beyond, floor, misfit, alike = found.T
    # A point whose texture agrees by chance leaves residuals that look independent; its neighbours know better.
    known = np.isfinite(alike)
    texture[known] /= local_statistics(alike)[0, known]
    stop = int(0.9 * at.resting.min())
    light, foam = quick_median(gain[np.isfinite(gain)]), np.empty((len(gain), 1))
    mean_between(zero.image, np.tile([float(stop // 2), float(stop)], (len(gain), 1)), foam)
    foam = foam[:, 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        sigma = np.hypot(_SAME_GREY * light * foam, math.sqrt(variance))

        def density(away: Float[np.ndarray, "K"]) -> Float[np.ndarray, "K"]:
            return np.exp(-0.5 * (away / sigma) ** 2) / (2.5 * sigma)

        shaded = (
            0.4 * density(beyond - light * floor) + 0.4 * density(beyond - between / foam * floor) + 0.2 / 255
        )
        # A body's own edge lies just where the front was at rest by chance alone.
        clean = misfit < _MISFIT
        body = 0.6 * density(beyond - between) + 0.4 / 255 * np.where(clean, _BY_CHANCE, 1.0)
        # What is not the zero in another light cannot show that its texture goes on.
        texture = np.where(clean, texture, np.minimum(texture, 0.0))
        levels = ALIKE * np.log(shaded / body)
    # A shadow's edge that crosses the strip changes the light from one point to some other beside it.
    change = local_statistics(np.log(np.maximum(gain, 1e-3)))[2]
    lit = ALIKE * np.clip(0.5 * (change / _SAME_GREY) ** 2 - 3.0, -3.0, 3.0)
    odds_shadow = (
        np.where(np.isfinite(near), lit, 0.0)
        + np.nan_to_num(texture)
        + np.nan_to_num(levels)
        + np.nan_to_num(_INDEPENDENT * near)
    )
    result: Float[np.ndarray, "K"] = np.clip(odds_shadow, -MAX_ODDS, MAX_ODDS)
    return result
