"""Compiled classification of the fitted points of one contour: noise, declared sigma and reason."""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

from ...core.kernels import kernel
from ._fit_kernels import (
    BLUR,
    BORDER,
    CHI2,
    COUNT,
    CURVE,
    FLAT,
    HIGH,
    LOW,
    SLOPE,
    SPREAD,
    STATUS,
    TEXTURE,
    VAR,
    T,
)


@kernel(nogil=True)
def classify_points(state, found, half, start, stop, noise_var, polarity, min_contrast, max_chi2, max_move, jump_px,
          pixel_px, found_edges, reason):  # fmt: skip
    """Noise, declared sigma and reason code of every point; codes as in ``contour.PointReason``.

    Parameters
    ----------
    state
        (n, STATES), from :func:`~visuohaptic.tracking.contours._refine_kernels.refine`.
    found
        Start positions of the fit [px], (n,).
    half
        Half width of each window along the edge [px], (n,).
    start, stop
        Range of each line [px], (n,).
    noise_var
        Variance of one pixel [grey levels^2].
    polarity
        +1 brighter at larger t, -1 darker, 0 either.
    min_contrast
        Smallest usable step [grey levels].
    max_chi2
        Largest mean squared residual [noise variances].
    max_move
        Largest distance between fit and start at slope 0 [px].
    jump_px
        Largest distance from both neighbours [px].
    pixel_px
        Standard deviation of the box of one pixel [px].
    found_edges
        Filled, (8, n): position, sigma and noise [px], step and level behind it [grey levels], blur of the optics
        [px], slope, and mean squared residual [noise variances].
    reason
        Filled with the codes, (n,).
    """
    n = state.shape[0]
    for k in range(n):
        s = state[k]
        height = s[HIGH] - s[LOW]
        chi = s[CHI2] / noise_var
        var = s[VAR] * noise_var
        found_edges[0, k], found_edges[2, k] = s[T], math.sqrt(max(var, 0.0))
        found_edges[3, k], found_edges[4, k] = height, s[HIGH]
        found_edges[5, k] = math.sqrt(max(s[BLUR] ** 2 - pixel_px**2, 0.0))
        found_edges[6, k], found_edges[7, k] = s[SLOPE], chi
        if s[COUNT] > 8.0 and chi > 1.0 + 3.0 * math.sqrt(2.0 / s[COUNT]):
            var *= chi
        ratio = s[SPREAD] / noise_var
        if ratio > 2.2:
            var = max(var, s[VAR] * noise_var * ratio)
        # Uneven levels close to the edge have the same effect as a shift of it: sqrt(pi) b per unit of contrast.
        # One plateau has few patches: a uniform one beside an uneven one may be chance.
        lo, hi = max(k - 3, 0), min(k + 4, n)
        near = 0.0
        for j in range(lo, hi):
            near += state[j, TEXTURE]
        uneven = max(s[TEXTURE], near / (hi - lo))
        var += math.pi * s[BLUR] ** 2 * uneven / max(height * height, 1.0) * (1.0 + s[SLOPE] ** 2)
        # A curve is not exactly a parabola: a tenth of the correction is uncertain, more where the curvature changes.
        uncertainty = 0.1 * abs(s[CURVE])
        if 0 < k < n - 1:
            uncertainty += 0.15 * abs(2.0 * s[CURVE] - state[k - 1, CURVE] - state[k + 1, CURVE])
        var += (uncertainty * half[k] * half[k] / 6.0) ** 2
        sigma = math.sqrt(max(var, 0.0))
        found_edges[1, k] = sigma
        code = 0
        if s[STATUS] == BORDER:
            code = 3
        elif s[STATUS] == FLAT or abs(height) < min_contrast:
            code = 1
        elif polarity * height < 0.0:
            code = 4
        elif abs(s[T] - found[k]) > max_move * (1.0 + abs(s[SLOPE])) or not (sigma < 1.0):
            code = 1
        elif s[T] < start[k] or s[T] > stop[k]:
            code = 3
        elif s[CHI2] > max_chi2 * noise_var + (0.06 * height) ** 2:
            code = 5
        reason[k] = code
    for k in range(n):
        if reason[k] == 0 and n > 2:
            a, b = (1, 2) if k == 0 else ((n - 2, n - 3) if k == n - 1 else (k - 1, k + 1))
            left, right = state[k, T] - state[a, T], state[k, T] - state[b, T]
            if left * right > 0.0 and min(abs(left), abs(right)) > jump_px:
                reason[k] = 6
