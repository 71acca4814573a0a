"""Deflection of the foam from the edges of one frame: valid points, their errors, and bounds for hidden points."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int64, Shaped

from ...core.kernels import kernel
from ...tracking.contours.contour import SHARED_NOISE
from .edges import MeasuredEdges
from .posterior import DECAY_PER_WIDTH, REST_PX, EdgeStates
from .profile import FoamContour
from .strip import ObservedStrip, StripGeometry

#: Frame-to-frame scatter of a point at a kink, and of an interpolated point, relative to its systematic error, from rendered
#: plates of 1 to 10 mm depth. The remaining error is the same in all frames.
_KINK_NOISE, _BRIDGE_NOISE = 0.08, 0.33
#: Gaps of up to this many points are interpolated from the shape of their neighbours.
_BRIDGED_POINTS = 2
#: A flank is free foam where the next point beyond its upper end rises further by this fraction of its rise.
_RISES_ON = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Deflection:
    """Deflection of K points in one frame, normalised with the zero reference."""

    delta_m: Float[np.ndarray, "K"]  #: towards the base, gaps interpolated; NaN where that is impossible
    sigma_m: Float[np.ndarray, "K"]  #: its standard deviation, all errors except those common to all points
    noise_m: Float[np.ndarray, "K"]  #: the part that varies from frame to frame
    own_noise_m: Float[np.ndarray, "K"]  #: the part that varies and that neighbours do not share
    seen: Bool[np.ndarray, "K"]  #: an edge of the foam is seen
    hidden_m: Float[
        np.ndarray, "K"
    ]  #: upper bound of the deflection of a hidden point; infinite where there is none
    raw_m: Float[np.ndarray, "K"]  #: deflection if every edge belonged to the foam
    states: EdgeStates  #: states of the edges
    light_m: Float[np.ndarray, "K"]  #: standard deviation due to uneven light, shared by neighbours
    unclean_m: Float[np.ndarray, "K"]  #: error of edges that were not observed at rest, shared by neighbours
    encoding_m: Float[np.ndarray, "K"]  #: error due to the camera's encoding, shared by all points
    measured: Bool[np.ndarray, "K"]  #: seen, and not inferred more accurately from its neighbours

    @property
    def covered(self) -> Bool[np.ndarray, "K"]:
        """Hidden points in gaps that are too long for interpolation."""
        return ~self.seen & (self.hidden_m > 0.0)

    def contour(self, geometry: StripGeometry, zero_sigma_m: float) -> FoamContour:
        """Convert to the input of :func:`~visuohaptic.sensing.foam.profile.read_profile`.

        Parameters
        ----------
        geometry
            Positions of the points.
        zero_sigma_m
            Error that is common to all points [m].
        """
        systematic = self.sigma_m**2 - self.noise_m**2 - self.own_noise_m**2
        return FoamContour(
            geometry.s_m,
            self.delta_m,
            self.noise_m,
            np.isfinite(self.delta_m),
            own_noise_m=self.own_noise_m,
            uncertainty_m=np.sqrt(np.maximum(systematic, 0.0)),
            unclean_m=self.unclean_m,
            shared_m=self.encoding_m,
            zero_sigma_m=zero_sigma_m,
            averaged=True,
            shared_noise=SHARED_NOISE,
            # An edge that may be another one's is no history of the foam, and neither is a point between two lines.
            measured=self.measured & ~self.states.undecided,
            end_cells_m=geometry.end_cells_m,
        )


def measure_deflection(
    edges: MeasuredEdges, states: EdgeStates, strip: ObservedStrip, geometry: StripGeometry
) -> Deflection:
    """Deflection of each point whose edge belongs to the foam, and bounds for the hidden points.

    Parameters
    ----------
    edges, states
        Deflection of the edges of one frame, and their states.
    strip
        Observation of the strip in the same frame.
    geometry
        Points of the strip.
    """
    # Under the edge of a shadow the foam looks like the zero image in another light: at rest within the pixel resolution.
    delta = np.where(states.shadow, 0.0, edges.delta_m)
    sigma = np.where(states.shadow, REST_PX * strip.pixel_m, edges.sigma_m)
    seen = (states.foam | states.shadow) & (strip.usable | strip.low_confidence)
    delta, sigma, noise, own, hidden, measured = fill_gaps(
        geometry, delta, sigma, edges.noise_m, edges.systematic_m, seen
    )
    unclean, encoding = (np.where(states.foam, error, 0.0) for error in (edges.unclean_m, edges.encoding_m))
    raw, light = edges.delta_m, edges.light_m
    return Deflection(delta, sigma, noise, own, seen, hidden, raw, states, light, unclean, encoding, measured)


def fill_gaps(
    geometry: StripGeometry,
    delta_m: Float[np.ndarray, "K"],
    sigma_m: Float[np.ndarray, "K"],
    noise_m: Float[np.ndarray, "K"],
    uncertainty_m: Float[np.ndarray, "K"],
    seen: Bool[np.ndarray, "K"],
) -> tuple[Shaped[np.ndarray, "K"], ...]:
    """Deflection with interpolated gaps, its standard deviation, the parts due to noise and due to the own noise of each
    point, the bound for hidden points, and the points that are measured, see :class:`Deflection`.

    One or two points are interpolated from the shape of their neighbours. A load in a wider gap would also deflect the
    foam beside it: a point at a distance x from an observed one, whose deflection is d +- sigma, is deflected by at most
    (d + sigma) exp(x / l) with the shortest decay length l of free foam. An edge that lies beyond that,
    and is less accurate, is not that of the foam, as beside the edge of a shadow that crosses the front.

    Parameters
    ----------
    geometry
        Points of the strip.
    delta_m, sigma_m, noise_m, uncertainty_m
        Deflection, noise and texture, the noise alone, and the systematic error [m].
    seen
        Points whose deflection is known.
    """
    s_m, width_m = geometry.s_m, geometry.width_m
    delta, sigma, error = delta_m.copy(), sigma_m.copy(), np.zeros(len(s_m))
    hidden, kept = np.zeros(len(s_m)), seen.copy()
    total_m = np.hypot(sigma_m, uncertainty_m)
    drop_bridged(s_m, delta_m, total_m, seen, np.argsort(-total_m), delta, error, kept)
    held = np.where(kept, np.maximum(delta_m, 0.0) + total_m, np.inf)
    drawn = held * np.exp(np.minimum(np.abs(s_m[:, None] - s_m) / (DECAY_PER_WIDTH * width_m), 500.0))
    np.fill_diagonal(drawn, np.inf)
    kept &= drawn.min(axis=1) >= np.minimum(np.abs(delta_m), total_m)
    bound = np.minimum(drawn[:, kept].min(axis=1, initial=np.inf), 1.0)
    delta[kept], error[kept], seen = delta_m[kept], 0.0, kept
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (~seen).astype(np.int8), [0]])))
    for first, stop in zip(edges[::2], edges[1::2], strict=True):
        gap = np.arange(first, stop)
        ends, sigma[gap] = [k for k in (first - 1, stop) if 0 <= k < len(s_m)], 0.0
        if ends and len(gap) <= _BRIDGED_POINTS:
            bridge(s_m, delta_m, total_m, seen, first, stop, delta, error)
            if error[first] < np.inf:
                continue
            error[first] = 0.0
        delta[gap] = np.nan
        hidden[gap] = bound[gap] if ends else np.inf
        if ends:
            between = np.interp(s_m[gap], s_m[ends], np.minimum(delta_m, bound)[ends])
            delta[gap] = np.minimum(between, bound[gap])
    error = np.where(np.isfinite(hidden) & (hidden > 0.0), hidden, error)
    total = np.hypot(sigma, np.where(seen, uncertainty_m, error))
    noise = np.where(seen, np.minimum(noise_m, total), 0.0)
    own = np.where(seen, _KINK_NOISE * uncertainty_m, np.where(hidden > 0.0, 0.0, _BRIDGE_NOISE * error))
    own = np.minimum(own, np.sqrt(np.maximum(total**2 - noise**2, 0.0)))
    return delta, total, noise, own, hidden, seen


@kernel(nogil=True)
def bridge(
    s: Float[np.ndarray, "K"],
    value: Float[np.ndarray, "K"],
    sigma: Float[np.ndarray, "K"],
    seen: Bool[np.ndarray, "K"],
    first: int,
    stop: int,
    filled: Float[np.ndarray, "K"],
    error: Float[np.ndarray, "K"],
) -> None:
    """Interpolate one or two points between their neighbours, with the error of the interpolation.

    Beside a body that presses near a free end of the strip, the front corner moves inwards by up to a sixth of the width, so that
    the last line meets the end face instead of the front. The front there continues the exponential decay of its two
    neighbours. Where these do not decay, the error is infinite.

    Parameters
    ----------
    s
        Position along the strip [m], (K,).
    value, sigma
        Deflection and its standard deviation [m], (K,).
    seen
        Points with known deflection, including those beside the gap, (K,).
    first, stop
        First point of the gap, and first point after it.
    filled, error
        Set within the gap [m], (K,).
    """
    a, b = first - 1 if first > 0 else stop + 1, stop if stop < len(s) else first - 2
    low, high = (a, b) if value[a] < value[b] else (b, a)
    beyond = high + (1 if high > low else -1)
    rise, noise = value[high] - value[low], 2.0 * max(sigma[a], sigma[b])
    decays = 0 <= beyond < len(s) and 0.0 < value[low] < value[high]
    # The edge of another body beyond is no deflection of the foam.
    decays = decays and seen[beyond] and value[beyond] - value[high] > _RISES_ON * rise
    if not a < first < b:
        decays = decays and seen[a] and seen[b] and stop == first + 1 and beyond != first
        error[first] = math.inf
        if not decays:
            return
    else:
        # Not at the bottom of the trough between two bodies, from which foam rises to either side.
        lower = low - (beyond - high)
        decays = decays and 0 <= lower < len(s) and seen[lower] and value[lower] < value[low]
    before = a - 1 if a > 0 and seen[a - 1] else a - 2
    after = b + 1 if b + 1 < len(s) and seen[b + 1] else b + 2
    left, right, across = 0.0, 0.0, (value[b] - value[a]) / (s[b] - s[a])
    if before >= 0 and seen[before] and after < len(s) and seen[after]:
        left = (value[a] - value[before]) / (s[a] - s[before])
        right = (value[after] - value[b]) / (s[after] - s[b])
    for k in range(first, stop):
        part = (s[k] - s[a]) / (s[b] - s[a])
        line = value[a] + part * (value[b] - value[a])
        if decays:
            # The deflection of free foam beside a contact decays exponentially; a straight line is far above it.
            filled[k] = value[a] ** (1.0 - part) * value[b] ** part
            # Neighbours may share their errors: these add up.
            common = filled[k] * (abs(1.0 - part) * sigma[a] / value[a] + abs(part) * sigma[b] / value[b])
            error[k] = math.hypot(common, 0.5 * abs(line - filled[k]))
            continue
        # Where both flanks rise towards each other, the front lies between the straight line and the tip where
        # they meet: half way for a circle, at the tip for an edge.
        bulge = 0.0
        if left > across > right:
            tip = min(value[a] + left * (s[k] - s[a]), value[b] + right * (s[k] - s[b]))
            bulge = 0.5 * max(tip - line, 0.0)
        filled[k] = line + bulge
        error[k] = math.hypot(math.hypot(noise, 0.5 * abs(rise)), bulge)


@kernel(nogil=True)
def drop_bridged(
    s: Float[np.ndarray, "K"],
    value: Float[np.ndarray, "K"],
    sigma: Float[np.ndarray, "K"],
    seen: Bool[np.ndarray, "K"],
    order: Int64[np.ndarray, "K"],
    filled: Float[np.ndarray, "K"],
    error: Float[np.ndarray, "K"],
    kept: Bool[np.ndarray, "K"],
) -> None:
    """Known points, except those that are inferred from better neighbours more accurately than measured.

    Parameters
    ----------
    s, value, sigma, seen
        See :func:`bridge`.
    order
        Indices of the points, the least accurate first: the neighbours of a point that is inferred are measured, (K,).
    filled, error
        Overwritten [m], (K,).
    kept
        The points that are seen, (K,); those that are inferred are removed.
    """
    for k in order:
        a, b = k - 1 if k > 0 else k + 1, k + 1 if k < len(s) - 1 else k - 1
        if kept[a] and kept[k] and kept[b]:
            bridge(s, value, sigma, seen, k, k + 1, filled, error)
            kept[k] = not error[k] < sigma[k]
