"""Points of the front that were not seen, or not seen well: which to use, and what to put into gaps."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

__all__ = ["bridged", "plausible"]

#: A gap of up to this many points between seen neighbours is bridged; a longer one may hide a contact.
_BRIDGED_POINTS = 2

#: At the end of the strip nothing lies on the other side of a gap: foam that is deflected by more than
#: this before it may go on in any way [m].
_FREE_END_M = 5e-4

#: So many poor fits in a row are used if they lie between their good neighbours, with a margin of this
#: part of the difference between these.
_LOW_CONFIDENCE_POINTS = 4
_LOW_CONFIDENCE_MARGIN = 0.15

#: A flank is free foam where the next point beyond its upper end rises on by this part of its rise ...
_RISES_ON = 0.3
#: ... and where it does not fall by more than this factor: steeper than any foam, an edge lies between.
_STEEPEST = 8.0


def plausible(
    s: Float[np.ndarray, "K"],
    delta: Float[np.ndarray, "K"],
    sigma: Float[np.ndarray, "K"],
    good: Bool[np.ndarray, "K"],
    low_confidence: Bool[np.ndarray, "K"],
) -> Bool[np.ndarray, "K"]:
    """Points of low confidence that lie between their good neighbours, up to a few in a row.

    At the edge of a plate the front is a kink, which is no blurred step; its fit is
    still ten times closer than a line between the neighbours. What lies outside of
    its neighbours is something else, and is not used. The tip of an edge is above both: between flanks
    that rise towards each other a point may lie as high as where these would meet.

    Parameters
    ----------
    s
        Position of the points along the strip [m].
    delta, sigma
        Deflection and its standard deviation [m].
    good
        Points that were seen as one clean step.
    low_confidence
        Points that were seen, but not as one clean step.
    """
    usable = np.zeros_like(good)
    known = np.flatnonzero(good)
    tips = _tips(s, delta, known)
    for k in np.flatnonzero(low_confidence & ~good & np.isfinite(delta)):
        after = int(np.searchsorted(known, k))
        if after == 0 or after == len(known) or known[after] - known[after - 1] > _LOW_CONFIDENCE_POINTS + 1:
            continue
        ends = delta[known[after - 1 : after + 1]]
        top = max(float(ends.max()), float(tips[k]))
        margin = _LOW_CONFIDENCE_MARGIN * (top - float(ends.min())) + 5.0 * float(sigma[k])
        usable[k] = ends.min() - margin <= delta[k] <= top + margin
    return usable


def _tips(
    s: Float[np.ndarray, "K"], value: Float[np.ndarray, "K"], known: Int[np.ndarray, "k"]
) -> Float[np.ndarray, "K"]:
    """How high the front may be in gaps that bulge: where the lines through both flanks meet; -inf elsewhere.

    A flank is the last known point before the gap and its neighbour. The gap bulges where
    the line between its ends is less steep than the flank on the left and steeper than that on the right.
    """
    tips = np.full(len(s), -np.inf)
    for i in np.flatnonzero(np.diff(known) > 1):
        a, b = known[i], known[i + 1]
        if i == 0 or i + 2 == len(known) or known[i - 1] < a - 2 or known[i + 2] > b + 2:
            continue
        before, after = known[i - 1], known[i + 2]
        left = (value[a] - value[before]) / (s[a] - s[before])
        right = (value[after] - value[b]) / (s[after] - s[b])
        if left > (value[b] - value[a]) / (s[b] - s[a]) > right:
            inside = slice(a + 1, b)
            tips[inside] = np.minimum(
                value[a] + left * (s[inside] - s[a]), value[b] + right * (s[inside] - s[b])
            )
    return tips


def bridged(
    s: Float[np.ndarray, "K"],
    value: Float[np.ndarray, "K"],
    sigma: Float[np.ndarray, "K"],
    seen: Bool[np.ndarray, "K"],
) -> tuple[Float[np.ndarray, "K"], Float[np.ndarray, "K"], Float[np.ndarray, "K"], bool]:
    """Fill gaps of a few points from their neighbours, with what that may be wrong by.

    Parameters
    ----------
    s
        Position of the points along the strip [m].
    value, sigma
        Deflection and its standard deviation [m].
    seen
        Points that can be used.

    Returns
    -------
    value, sigma
        With bridged points; NaN inside longer gaps.
    uncertainty
        Systematic error of the bridged points; 0 for the others.
    gap
        Whether a gap is left that could hide a contact.
    """
    if seen.all():
        return value, sigma, np.zeros_like(sigma), False
    known = np.flatnonzero(seen)
    if len(known) < 2:
        return np.full_like(value, np.nan), np.full_like(sigma, np.nan), np.zeros_like(sigma), True
    filled, filled_sigma = value.copy(), sigma.copy()
    left = np.searchsorted(known, np.arange(len(seen)), side="right") - 1
    before = known[np.clip(left, 0, len(known) - 1)]
    after = known[np.clip(left + 1, 0, len(known) - 1)]
    missing = np.flatnonzero(~seen)
    a, b = before[missing], after[missing]
    filled[missing] = np.interp(s[missing], s[known], value[known])
    filled_sigma[missing] = np.maximum(sigma[a], sigma[b])
    # Between two neighbours the contour may do what it does from one to the other, and where it bulges it lies
    # between the straight line and the tip: half way for a circle, at the tip for an edge.
    bulge = 0.5 * np.maximum(_tips(s, value, known)[missing] - filled[missing], 0.0)
    filled[missing] += bulge
    uncertainty = np.zeros_like(sigma)
    uncertainty[missing] = np.hypot(2.0 * filled_sigma[missing], 0.5 * np.abs(value[b] - value[a]))
    uncertainty[missing] = np.hypot(uncertainty[missing], bulge)
    for k, first, last in zip(missing, a, b, strict=True):
        if first < k < last and _on_flank(value, first, last):
            # Free foam beside a contact falls off exponentially; a straight line is far above it.
            part = (s[k] - s[first]) / (s[last] - s[first])
            line, filled[k] = filled[k], value[first] ** (1.0 - part) * value[last] ** part
            uncertainty[k] = np.hypot(2.0 * filled_sigma[k], 0.5 * (line - filled[k]))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (~seen).astype(np.int8), [0]])))
    long = [
        (a, b)
        for a, b in zip(edges[::2], edges[1::2], strict=True)
        if b - a > _BRIDGED_POINTS or _open_end(value, a, b)
    ]
    for a, b in long:
        filled[a:b] = np.nan
        filled_sigma[a:b] = np.nan
        uncertainty[a:b] = 0.0
    return filled, filled_sigma, uncertainty, bool(long)


def _on_flank(value: Float[np.ndarray, "K"], first: int, last: int) -> bool:
    """Whether the front rises from one point to the other, and goes on rising as steeply beyond it."""
    low, high = (first, last) if value[first] < value[last] else (last, first)
    beyond = high + (1 if high > low else -1)
    if not 0 <= beyond < len(value) or not value[low] > 0.0:
        return False
    rise = value[high] - value[low]
    return bool(value[high] < _STEEPEST * value[low] and value[beyond] - value[high] > _RISES_ON * rise)


def _open_end(value: Float[np.ndarray, "K"], first: int, stop: int) -> bool:
    """Whether a gap reaches an end of the strip from where it is deflected."""
    if first == 0:
        return bool(value[stop] > _FREE_END_M)
    return bool(stop == len(value) and value[first - 1] > _FREE_END_M)
