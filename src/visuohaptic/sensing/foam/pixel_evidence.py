"""Evidence of the pixels on both sides of an edge: texture of the zero image behind it, shadow or body in front of it."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float

from ...tracking.contours.contour import PIXEL_PX, quick_median
from ._chain_kernels import SHADOW
from ._light_kernels import mean_between
from ._posterior_kernels import shadow_odds
from ._texture_kernels import foam_bands, level_odds, texture_odds
from .strip.optics import ObservedStrip
from .strip.zero import ZeroReference
from .uneven_light import local_statistics


def image_evidence(
    strip: ObservedStrip,
    zero: ZeroReference,
    rest_px: Float[np.ndarray, "K"],
    seen: Bool[np.ndarray, "K"],
    deflected: Bool[np.ndarray, "K"],
    moved_px: Float[np.ndarray, "K"],
    unary: Float[np.ndarray, "K 4"],
    against: Float[np.ndarray, "K 6"],
) -> None:
    """Log-likelihoods of the pixels on both sides of each edge.

    Parameters
    ----------
    strip, zero
        Observation of the strip in this image, and the strip at rest.
    rest_px
        Position of the front at rest along each line [px].
    seen, deflected
        Points with an edge, and those of them whose edge has moved.
    moved_px
        Distance of each edge from the last position of the foam [px].
    unary
        Log-likelihood of foam, shadow, occluder and nothing; filled.
    against
        Log-odds against foam by kind of evidence; the first two, texture and shadow, are filled.
    """
    step = strip.step_px * (strip.image.shape[2] - 1) / (zero.image.shape[2] - 1)
    front = np.where(seen, strip.front.position_px, rest_px) / step
    resting = rest_px / step
    blur = math.hypot(strip.blur_px, PIXEL_PX) / quick_median(step) if np.isfinite(strip.blur_px) else 1.0
    bands, gain = np.empty((len(seen), 9)), np.empty(len(seen))
    slope = strip.front.slope * strip.across_px / step
    foam_bands(strip.image, zero.image, front, resting, slope, blur, seen, bands)
    transfer, variance = texture_odds(bands, unary, against, gain)
    if variance == 0.0:
        return
    found = np.empty((len(seen), 8))
    lines = np.column_stack(
        [strip.reference_points_px, strip.front.lines.direction_px, strip.step_px, strip.across_px]
    )
    # A shutter that is open from frame to frame, at the most, sees the edge move by a box.
    places = front, resting, slope, blur, moved_px / step / math.sqrt(12.0)
    shadow_odds(strip.image, zero.image, lines, *places, transfer, variance, deflected & seen, found)
    stop = int(0.9 * resting.min())
    foam = np.empty((len(seen), 1))
    mean_between(zero.image, np.full((len(seen), 2), [float(stop // 2), float(stop)]), foam)
    change = local_statistics(np.log(np.maximum(gain, 1e-3)))[2]
    level_odds(found, local_statistics(found[:, 6])[0], gain, change, foam[:, 0], variance, against)
    unary[:, SHADOW] += against[:, 1]
