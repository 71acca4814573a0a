"""Compiled interpolation of single points from the shape of their neighbours; used by ``deflection.py``."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

from ...core.kernels import kernel

#: A flank is free foam where the next point beyond its upper end rises further by this fraction of its rise ...
_RISES_ON = 0.3
#: ... and where it does not fall by more than this factor: no foam is steeper, there must be an edge in between.
_STEEPEST = 8.0


@kernel(nogil=True)
def bridge(s, value, sigma, seen, first, stop, filled, error):
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
    decays = 0 <= beyond < len(s) and 0.0 < value[low] < value[high] < _STEEPEST * value[low]
    decays = decays and value[beyond] - value[high] > _RISES_ON * rise
    if not a < first < b:
        decays = decays and seen[a] and seen[b] and stop == first + 1 and beyond != first
        error[first] = math.inf
        if not decays:
            return
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
            error[k] = math.hypot(noise, 0.5 * abs(line - filled[k]))
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
def drop_bridged(s, value, sigma, seen, filled, error, kept):
    """Known points, except those that are inferred from better neighbours more accurately than measured.

    Parameters
    ----------
    s, value, sigma, seen
        See :func:`bridge`.
    filled, error
        Overwritten [m], (K,).
    kept
        Filled, (K,).
    """
    for k in range(len(s)):
        kept[k] = seen[k]
        a, b = k - 1 if k > 0 else k + 1, k + 1 if k < len(s) - 1 else k - 1
        if seen[a] and seen[k] and seen[b] and sigma[k] > 2.0 * max(sigma[a], sigma[b]):
            bridge(s, value, sigma, seen, k, k + 1, filled, error)
            kept[k] = not error[k] < sigma[k]
