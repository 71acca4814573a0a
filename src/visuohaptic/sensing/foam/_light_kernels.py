"""Compiled edges as a lens blurs them, and comparison of the floor beyond the front with the zero image in any light."""

# mypy: disable-error-code="no-untyped-def, assignment"
from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel

#: Table of the complementary error function from -5 to 5, interpolated linearly: exact to 3e-6, 1/2000 of a grey level.
_OVER, _STEPS = 5.0, 200.0
_ERFC = np.array([math.erfc(i / _STEPS - _OVER) for i in range(int(2.0 * _OVER * _STEPS) + 2)])
_ERFC[0], _ERFC[-2:] = 2.0, 0.0


@kernel(nogil=True)
def beyond_edge(away):
    """Twice the fraction of a Gaussian edge that lies beyond a position, given in units of its width times sqrt(2)."""
    place = min(max((away + _OVER) * _STEPS, 0.0), 2.0 * _OVER * _STEPS)
    at = int(place)
    return _ERFC[at] + (place - at) * (_ERFC[at + 1] - _ERFC[at])


@kernel(nogil=True)
def _variance(now, rest, first, last):
    """Mean of the samples ``first`` to ``last`` of ``rest``, of shape (lines, samples), times the deviation of ``now / rest`` from
    a straight line, squared, and their number; NaN where there are too few."""
    n, sx, sxx, sy, sxy, syy, level = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(first, last + 1):
        x = float(j - first)
        for lane in range(now.shape[0]):
            if rest[lane, j] > 0.0 and now[lane, j] > 0.0:
                y = now[lane, j] / rest[lane, j]
                n, sx, sxx, level = n + 1.0, sx + x, sxx + x * x, level + rest[lane, j]
                sy, sxy, syy = sy + y, sxy + x * y, syy + y * y
    if n < 4.0 * now.shape[0]:
        return math.nan, n
    slope = (n * sxy - sx * sy) / (n * sxx - sx * sx)
    left = max(syy - (sy - slope * sx) / n * sy - slope * sxy, 0.0)
    return left / (n - 2.0) * (level / n) ** 2, n


@kernel(nogil=True)
def floor_beyond(image, zero, spacing, begin, end, found):
    """Compare the samples of a plateau of each line with the zero image in another light, which varies linearly.

    Parameters
    ----------
    image, zero
        Grey levels along the lines, (K, parallels, samples).
    spacing
        Of the samples [px], (K,).
    begin, end
        Ends of the plateau along each line [px], NaN where there is none, (K,).
    found
        Filled, (3, K): variance of the samples about the zero image in this light, and about a straight line [grey levels^2], and
        their number. Left as it is where too little is seen.
    """
    even = np.ones(image.shape[1:])
    for k in range(image.shape[0]):
        if begin[k] >= 0.0:
            first = int(math.ceil(begin[k] / spacing[k]))
            last = min(int(end[k] / spacing[k]), image.shape[2] - 1)
            variance, count = _variance(image[k], zero[k], first, last)
            if math.isfinite(variance):
                found[0, k], found[2, k] = variance, count
                found[1, k], count = _variance(image[k], even, first, last)
