"""Compiled test of a foam's flanks; plain arrays in and out. What it means is in ``_flank.py``."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np

from ....core.kernels import kernel

#: Neighbours on either side of a point that its chord may span, one side and both together.
REACH, SPAN = 3, 4


@kernel
def below_chord(s, delta, sigma, start, end, decay, tolerance, bulge, bulge_reach, sigmas):
    """How far each point lies below what its neighbours force on free foam between them.

    Free foam between a and c is ``(a sinh((c - b) / decay) + c sinh((b - a) / decay)) / sinh((c - a) /
    decay)``. ``tolerance`` is taken off as a fraction of the higher end, ``bulge`` as one of the deepest
    point within ``bulge_reach``, ``sigmas`` as standard deviations. Beyond the ends of the strip at ``start`` and ``end`` its mirror image goes on: a free
    end has no slope. Returns the largest excess of each point, and the side of the higher neighbour.

    Parameters
    ----------
    s, delta, sigma
        Position, deflection and its standard deviation of n points [m].
    start, end
        Ends of the strip [m]; beyond them its mirror image goes on.
    decay
        Decay length of free foam [m].
    tolerance
        Fraction of the higher end that is taken off.
    bulge, bulge_reach
        Fraction of the deepest point within that distance [m] that is taken off.
    sigmas
        Standard deviations that are taken off.
    """
    n = len(s)
    excess = np.full(n, -1.0)
    side = np.zeros(n, np.int64)
    for b in range(n):
        deepest = 0.0
        i = b
        while i >= 0 and s[b] - s[i] <= bulge_reach:
            deepest = max(deepest, delta[i])
            i -= 1
        i = b
        while i < n and s[i] - s[b] <= bulge_reach:
            deepest = max(deepest, delta[i])
            i += 1
        for left in range(1, REACH + 1):
            i = b - left
            if i < 0:
                i = -1 - i
            before = s[b] - s[i] if b >= left else s[b] + s[i] - 2.0 * start
            for right in range(1, min(REACH, SPAN - left) + 1):
                k = b + right
                if k >= n:
                    k = 2 * n - 1 - k
                after = s[k] - s[b] if b + right < n else 2.0 * end - s[k] - s[b]
                whole = np.sinh((before + after) / decay)
                from_left = np.sinh(after / decay) / whole
                from_right = np.sinh(before / decay) / whole
                top = max(delta[i], delta[k])
                if top <= delta[b]:
                    continue
                value = from_left * delta[i] + from_right * delta[k] - delta[b]
                value -= tolerance * top * (from_left + from_right) + bulge * deepest
                value -= sigmas * np.sqrt(
                    (from_left * sigma[i]) ** 2 + (from_right * sigma[k]) ** 2 + sigma[b] ** 2
                )
                if value > excess[b]:
                    excess[b] = value
                    higher = i - b if delta[i] > delta[k] else k - b
                    # The mirror image of a point is on its own side.
                    side[b] = 1 if higher > 0 else -1
    return excess, side
