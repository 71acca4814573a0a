"""Compiled driver of the sub-pixel fit: all points of one contour, in sweeps.

A sweep measures the grey levels beside each point, combines levels,
shading and blur with those of the neighbours as far as they agree, and makes one or two
scoring steps per point.
"""

# mypy: disable-error-code="no-untyped-def, assignment"
# Kernels are typed by numba at the call; their arrays are described in the docstrings.
from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel
from .._solve_kernels import median
from ._fit_kernels import (  # fmt: skip
    BLUR,
    BLUR_INFO,
    BLUR_STEP,
    BORDER,
    CHI2,
    CURVE,
    HIGH,
    HIGH_SLOPE,
    LOW,
    LOW_SLOPE,
    MOVED,
    NEXT,
    NEXT_STEP,
    OK,
    SLOPE,
    STATUS,
    TEXTURE,
    T,
    curvatures,
    fraction,
    plateaus,
    step_fit,
)
from ._next_kernels import next_edges
from ._search_kernels import edge_strength

#: Edge pixels extend this many blurs from the edge; the plateaus start there.
NEAR = 3.0
#: Independent texture patches along one point (one: conservative), lever arm of a sloping level [px].
PATCHES, SLANT_PX = 1.0, 3.0
#: Number of neighbours on each side that share levels, shading and blur.
SHARED = 10
#: Maximum curvature that is corrected [1/px].
CURVATURE_LIMIT = 0.05
MIN_BLUR, MAX_BLUR = 0.45, 6.0
#: A point whose last step was longer than this (in blurs) has not converged: kinks and steep flanks take up to
#: six sweeps from a whole pixel, and if they are stopped early, the result depends on the start position.
SETTLED, MORE_SWEEPS = 0.04, 6
#: A kink leaves a residual of up to this fraction of the squared contrast; twice as much indicates that there is no edge.
#: Well above the residual of kinks: the curvature must not be switched by the residual that it causes itself.
KINK = 0.08
#: The chain has missed the edge where its strength is below this fraction of the usual one; the edge lies between the
#: neighbours' positions, or at most this far outside [px].
WEAK, BEYOND_PX = 0.5, 2.0


@kernel(fastmath=True, nogil=True)
def start_slopes(origin, direction, position, slope):
    """Slope dt/ds at each point from its two neighbours.

    The mean of both sides; the smaller slope where they differ by more than bent
    foam allows: the other side is then a jump to another edge.

    Parameters
    ----------
    origin, direction
        Origins (x, y) [px] and unit directions of n lines, (n, 2).
    position
        Position along each line [px], (n,).
    slope
        Filled, (n,).
    """
    n = origin.shape[0]
    for k in range(n):
        dx, dy = direction[k, 0], direction[k, 1]
        x, y = origin[k, 0] + position[k] * dx, origin[k, 1] + position[k] * dy
        total = 0.0
        flattest = 1e9
        count = 0
        lowest, highest = 1e9, -1e9
        for i in (k - 1, k + 1):
            if 0 <= i < n:
                ax = origin[i, 0] + position[i] * direction[i, 0] - x
                ay = origin[i, 1] + position[i] * direction[i, 1] - y
                s = -ax * dy + ay * dx
                if abs(s) > 1.0:
                    m = (ax * dx + ay * dy) / s
                    total += m
                    count += 1
                    lowest, highest = min(lowest, m), max(highest, m)
                    if abs(m) < abs(flattest):
                        flattest = m
        m = 0.0 if count == 0 else (flattest if highest - lowest > 1.2 else total / count)
        slope[k] = min(max(m, -2.5), 2.5)


@kernel(nogil=True)
def start_on_edge(grey, origin, direction, found, strength, start, stop, polarity, cap, floor, reach_px):
    """Move points that the smooth chain placed beside the edge onto it; changes ``found``.

    At a kink, the chain cuts the corner: a point is placed on plain foam, up to a point spacing from
    its edge, and a fit started there does not converge. Such a point is moved to the edge between its neighbours'
    positions if there is exactly one within ``reach_px``; if there are two, neither is chosen.

    Parameters
    ----------
    grey
        Grey image.
    origin, direction
        Origins (x, y) [px] and unit directions of n lines, (n, 2).
    found, strength
        (n) positions of the chain [px] and their edge strength.
    start, stop
        Range of each line [px], (n,).
    polarity
        +1 brighter at larger t, -1 darker, 0 either.
    cap, floor
        Edge strength of a usual edge of this contour, and of noise.
    reach_px
        Search distance for an edge [px].
    """
    n = origin.shape[0]
    chain, first = found.copy(), np.empty(1)
    for k in range(1, n - 1):
        if strength[k] >= WEAK * cap:
            continue
        lo = min(chain[k - 1], chain[k], chain[k + 1]) - BEYOND_PX
        hi = max(chain[k - 1], chain[k], chain[k + 1]) + BEYOND_PX
        lo = math.floor(max(lo, chain[k] - reach_px, start[k]))
        hi = math.ceil(min(hi, chain[k] + reach_px, stop[k]))
        count = int(hi - lo) + 1
        if count < 3:
            continue
        row = np.empty((1, count), np.float32)
        first[0] = lo
        edge_strength(grey, origin[k : k + 1], direction[k : k + 1], first, count, polarity, row)
        top = 0
        for j in range(1, count):
            if row[0, j] > row[0, top]:
                top = j
        level = max(0.5 * row[0, top], 2.0 * floor)
        # A maximum at the end is the flank of an edge farther away.
        if row[0, top] < max(WEAK * cap, 2.0 * floor) or top == 0 or top == count - 1:
            continue
        edges = 0
        for j in range(count):
            edges += row[0, j] >= level and (j == 0 or row[0, j - 1] < level)
        if edges == 1:
            found[k] = lo + top


@kernel(nogil=True)
def _posterior(mean, spread, value, variance):
    if not spread < 1e30:
        return value, variance
    w = variance / (variance + spread)
    return value + w * (mean - value), variance * spread / (variance + spread)


@kernel(nogil=True)
def _levels(measured, state, use, noise_var, prior):
    """Levels and shading of both sides from own and neighbouring plateaus."""
    n = state.shape[0]
    value = np.zeros(n)
    variance = np.ones(n)
    mean = np.empty(n)
    spread = np.empty(n)
    tilt_var = np.empty(n)
    uneven = np.empty(n)
    state[:, TEXTURE] = 0.0
    for side in range(2):
        tilt = LOW_SLOPE if side == 0 else HIGH_SLOPE
        texture = np.ones(n)
        for k in range(n):
            m = measured[k, side]
            if use[k]:
                # Texture is correlated over a few pixels: its pixels count as a quarter.
                if m[5] > 1.5 * noise_var:
                    texture[k] = 1.0 + 4.0 * (m[5] / noise_var - 1.0)
                uneven[k] = max(m[5] - noise_var * (1.0 + 3.0 * math.sqrt(2.0 / m[0])), 0.0) / PATCHES
                value[k] = m[3]
                variance[k] = noise_var * texture[k] / (m[0] * m[4])
        fraction(value, variance, use, 2 * SHARED, mean, spread)
        for k in range(n):
            if use[k]:
                if spread[k] < 1e30:
                    slant = (value[k] - mean[k]) ** 2 - 4.0 * (
                        noise_var / (measured[k, side, 0] * measured[k, side, 4])
                    )
                    state[k, TEXTURE] += uneven[k] + SLANT_PX**2 * max(slant, 0.0)
                # Absent shading must not reduce accuracy: shrunk to zero below two sigma.
                mean[k] *= max(0.0, 1.0 - 4.0 * spread[k] / max(mean[k] * mean[k], 1e-12))
                state[k, tilt], tilt_var[k] = _posterior(mean[k], spread[k], value[k], variance[k])
                if not spread[k] < 1e30:
                    state[k, tilt], tilt_var[k] = 0.0, 0.0
        for k in range(n):
            if use[k]:
                m = measured[k, side]
                value[k] = m[2] - state[k, tilt] * m[1]
                variance[k] = noise_var * texture[k] / m[0]
        fraction(value, variance, use, SHARED, mean, spread)
        for k in range(n):
            if use[k]:
                # Texture shared with the neighbours does not average out.
                best, var = _posterior(mean[k], spread[k] + uneven[k], value[k], variance[k])
                var += measured[k, side, 1] ** 2 * tilt_var[k]
                prior[k, side] = best
                prior[k, 2 + side] = noise_var / max(var, 1e-6 * noise_var)


@kernel
def _residual_noise(state, use, noise_var, value, work):
    """Median of the residual variances of the points in use; the previous value if three or fewer remain."""
    count = 0
    for k in range(state.shape[0]):
        if use[k]:
            value[count] = state[k, CHI2]
            count += 1
    return max(median(value, count, work), 0.1) if count > 3 else noise_var


@kernel(nogil=True)
def refine(
    grey, origin, direction, half, state, doubtful, noise_var, sweeps, blur_gain, min_contrast, plateau_px
):
    """Fit all points; ``state`` holds start values of T and BLUR and receives the result.

    Points that have not converged are continued separately, for up to ``MORE_SWEEPS`` sweeps.
    Returns the noise variance [grey^2] (estimated if ``noise_var`` <= 0).

    Parameters
    ----------
    grey, origin, direction
        As in :func:`start_on_edge`.
    half
        Half width of each window along the edge [px], (n,).
    state
        (n, STATES), start values of T and BLUR; receives the result.
    doubtful
        Points that may have a second edge close beyond the first, (n,).
    noise_var
        Variance of one pixel [grey levels^2]; 0: estimated.
    sweeps
        Number of passes over all points.
    blur_gain
        Fraction of a change of the blur that is applied in each pass.
    min_contrast
        Smallest usable step [grey levels].
    plateau_px
        Width of the pixels on each side from which the grey levels are estimated [px].
    """
    n = origin.shape[0]
    measured = np.zeros((n, 2, 6))
    prior = np.zeros((n, 4))
    use = np.zeros(n, np.bool_)
    value = np.empty(n)
    work = np.empty(n)
    variance = np.ones(n)
    mean = np.empty(n)
    spread = np.empty(n)
    given = noise_var > 0.0
    start_slopes(origin, direction, state[:, T].copy(), state[:, SLOPE])
    state[:, CURVE] = 0.0
    state[:, LOW_SLOPE] = 0.0
    state[:, HIGH_SLOPE] = 0.0
    state[:, STATUS] = OK
    state[:, NEXT_STEP] = 0.0
    far, searched, beyond = np.zeros(n, np.bool_), np.zeros(n, np.bool_), np.zeros((n, 3))
    single = not doubtful.any()
    at = np.full(n, 1e9)
    blur_then = np.zeros(n)
    curve_then = np.zeros(n)
    going = np.ones(n, np.bool_)
    trust = np.zeros(n)
    for sweep in range(sweeps + MORE_SWEEPS):
        if sweep >= sweeps:
            left = 0
            for k in range(n):
                # A new curvature shifts the mean of a parabola over the point's width.
                ahead = abs(state[k, CURVE] - curve_then[k]) * half[k] * half[k] / 6.0
                going[k] = (
                    state[k, STATUS] == OK and max(abs(state[k, MOVED]), ahead) > SETTLED * state[k, BLUR]
                )
                left += going[k]
            if left == 0:
                break
        for k in range(n):
            far[k] = abs(state[k, T] - at[k]) > 0.6 * state[k, BLUR] or state[k, BLUR] > 1.1 * blur_then[k]
            searched[k] = far[k] and going[k] and doubtful[k] and state[k, STATUS] != BORDER
        if not single:
            next_edges(
                grey, origin, direction, half, state, NEAR, plateau_px, max(noise_var, 1.0), min_contrast, searched,
                beyond,
            )  # fmt: skip
        for k in range(n):
            if not going[k]:
                continue
            if state[k, STATUS] == BORDER:
                use[k] = False
                continue
            moved = state[k, T] - at[k]
            if far[k]:
                if not plateaus(
                    grey, origin[k], direction[k], half[k], state[k], NEAR, plateau_px, measured[k]
                ):
                    state[k, STATUS] = BORDER
                    use[k] = False
                    continue
                blur_then[k] = state[k, BLUR]
            else:
                shift = moved / math.sqrt(1.0 + state[k, SLOPE] ** 2)
                measured[k, 0, 1] -= shift
                measured[k, 1, 1] -= shift
                beyond[k, 0] -= shift
                state[k, NEXT] -= shift
            at[k] = state[k, T]
            if sweep == 0:
                state[k, LOW], state[k, HIGH] = measured[k, 0, 2], measured[k, 1, 2]
                use[k] = abs(state[k, HIGH] - state[k, LOW]) >= min_contrast
        if sweep == 0 and not given:
            for k in range(n):
                value[k] = min(measured[k, 0, 5], measured[k, 1, 5])
            noise_var = max(median(value, n, work), 0.1)
        elif not given:
            noise_var = _residual_noise(state, use, noise_var, value, work)
        _levels(measured, state, use, noise_var, prior)
        for k in range(n):
            if state[k, STATUS] == BORDER or not going[k]:
                continue
            if not use[k]:
                for side in range(2):
                    prior[k, side] = measured[k, side, 2]
                    prior[k, 2 + side] = measured[k, side, 0]
            state[k, LOW], state[k, HIGH] = prior[k, 0], prior[k, 1]
            for _turn in range(3 if sweep == 0 else 2):
                step_fit(grey, origin[k], direction[k], half[k], NEAR, prior[k], state[k])
                if (
                    state[k, STATUS] != OK
                    or abs(state[k, MOVED]) < (0.25 if sweep == 0 else 0.05) * state[k, BLUR]
                ):
                    break
        for k in range(n):
            height = abs(state[k, HIGH] - state[k, LOW])
            poor = state[k, CHI2] / (6.0 * noise_var + 0.01 * height * height)
            use[k] = state[k, STATUS] == OK and height >= min_contrast and poor < 1.0
            seen = state[k, STATUS] == OK and height >= min_contrast
            excess = max(state[k, CHI2] - noise_var, 0.0) / max(height * height, 1.0)
            trust[k] = min(max(2.0 - excess / KINK, 0.0), 1.0) if seen else 0.0
            if use[k]:
                b = state[k, BLUR]
                value[k] = b + min(max(state[k, BLUR_STEP], -0.3 * b), 0.5 * b)
                variance[k] = noise_var / state[k, BLUR_INFO]
        fraction(value, variance, use, SHARED, mean, spread)
        for k in range(n):
            if use[k] and spread[k] < 1e30:
                best, _ = _posterior(mean[k], spread[k], value[k], variance[k])
                b = state[k, BLUR] + blur_gain * (best - state[k, BLUR])
                state[k, BLUR] = min(max(b, MIN_BLUR), MAX_BLUR)
            elif spread[k] < 1e30:
                state[k, BLUR] = min(max(mean[k], MIN_BLUR), MAX_BLUR)
        for k in range(n):
            curve_then[k] = state[k, CURVE]
        curvatures(origin, direction, state, trust, noise_var, CURVATURE_LIMIT)
    return noise_var if given else _residual_noise(state, use, noise_var, value, work)
