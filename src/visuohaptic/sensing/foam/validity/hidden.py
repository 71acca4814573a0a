"""Points of the strip at which something else than the foam's own front was found."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from ....tracking.contours.contour import PIXEL_PX
from ..strip.appearance import covered_points, other_surface
from ..strip.optics import ObservedStrip, StripOptics
from ..strip.zero import ZeroReference
from .edge_at_rest import EdgeLines, resting_edge
from .plausibility import thicker_than_at_rest

__all__ = ["hidden_points"]

#: Deflections of up to so many sigmas are noise, in which nothing has to be proved.
_SIGMAS = 3.0


def hidden_points(
    strip: ObservedStrip,
    zero: ZeroReference,
    optics: StripOptics,
    delta_m: Float[np.ndarray, "K"],
    sigma_m: Float[np.ndarray, "K"],
) -> Bool[np.ndarray, "K"]:
    """Points whose edge is not the front of the foam: covered, of another surface, or of a shadow.

    Parameters
    ----------
    strip, optics
        What one image shows, and the lines on which it was found.
    zero
        The strip at rest.
    delta_m, sigma_m
        Deflection and its standard deviation, that of the zero included [m].
    """
    deepest_m = float(np.max(delta_m, initial=0.0, where=strip.usable))
    hidden = covered_points(strip.foam_grey, zero.foam_grey, optics.geometry.s_m)
    hidden |= _other_surface(strip, zero)
    hidden |= thicker_than_at_rest(delta_m, sigma_m, optics.geometry.width_m, deepest_m)
    deflected = (strip.usable | strip.low_confidence) & (delta_m > _SIGMAS * sigma_m)
    if deflected.any():
        lines = EdgeLines(
            strip.grey,
            strip.reference_points_px,
            optics.direction_px,
            strip.front.position_px,
            optics.rest_px(strip, zero.width_m),
            float(np.hypot(strip.blur_px, PIXEL_PX)),
            strip.front.noise_grey,
        )
        hidden |= resting_edge(lines, deflected, zero)
    return hidden


def _other_surface(strip: ObservedStrip, zero: ZeroReference) -> Bool[np.ndarray, "K"]:
    """Points with an edge of the object behind the foam instead of the foam's own."""
    if zero.front_ratio is None or zero.contrast is None:
        return np.zeros(len(strip.foam_grey), dtype=bool)
    with np.errstate(divide="ignore", invalid="ignore"):
        near = strip.front_grey / strip.foam_grey
        light = strip.foam_grey / zero.foam_grey
        # Ten pixels or fewer, and the noise of the line that they are compared with.
        noise = strip.front.noise_grey / strip.foam_grey / np.sqrt(6.0)
    seen = strip.usable | strip.low_confidence
    return other_surface(near, zero.front_ratio, strip.front.contrast, light * zero.contrast, seen, noise)
