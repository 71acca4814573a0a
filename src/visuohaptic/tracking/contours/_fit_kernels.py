"""Compiled kernels of the sub-pixel fit: blurred steps on raw pixels, parameters shared along the contour.

Symbols, per point: ``t`` position on the line, ``m = dt/ds`` slope and ``kappa``
curvature of the edge (s runs across the lines), ``z`` distance of a pixel from the
edge along its normal, ``b`` blur including the pixel's own 1/12 px^2, ``q`` arc
length along the edge, ``N`` pixels per unit of z. A second edge beyond the first one, ``NEXT`` away and with the
step ``NEXT_STEP`` (0: there is none), is that of another body: it is subtracted from the pixels.
"""

# mypy: disable-error-code="no-untyped-def, assignment"
# Kernels are typed by numba at the call; their arrays are described in the docstrings.
from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel

#: Rows of the per-point state; see ``edge_fit.fit_edges``.
T, SLOPE, CURVE, BLUR, LOW, HIGH, LOW_SLOPE, HIGH_SLOPE, VAR, CHI2 = range(10)
SPREAD, COUNT, MOVED, STATUS, BLUR_STEP, BLUR_INFO, TEXTURE, NEXT, NEXT_STEP = range(10, 19)
STATES = 19
OK, BORDER, FLAT = 0.0, 1.0, 2.0

STEPS = 32  # table entries per unit of z / b
REACH = 6  # table from -REACH to REACH
_x = (np.arange(2 * REACH * STEPS + 1) / STEPS - REACH).astype(np.float64)
NORMAL = np.exp(-0.5 * _x * _x) / math.sqrt(2.0 * math.pi)
STEP = np.array([0.5 * math.erfc(-v / math.sqrt(2.0)) for v in _x])


@kernel(fastmath=True, nogil=True)
def above(x):
    """Fraction of a Gaussian edge below a position.

    Parameters
    ----------
    x
        Position relative to the edge [blurs].
    """
    at = min(max((x + REACH) * STEPS, 0.0), 2.0 * REACH * STEPS - 1.0)
    i = int(at)
    return STEP[i] + (at - i) * (STEP[i + 1] - STEP[i])


@kernel(fastmath=True, nogil=True)
def frame(origin, direction, t, m, kappa):
    """The edge at one point in image axes: v = p_v + M (u - p_u) + C (u - p_u)^2 / 2.

    u is the image axis along the edge, v the one across it; ``nv`` is the v component of
    the normal that points to larger t, ``cu`` the arc length per unit of u.

    Parameters
    ----------
    origin, direction
        Origin (x, y) [px] and unit direction of the line, (2,).
    t
        Position of the edge along the line [px].
    m
        Slope dt/ds of the edge.
    kappa
        Its curvature [1/px].
    """
    dx, dy = direction[0], direction[1]
    tx, ty = -dy + m * dx, dx + m * dy
    px, py = origin[0] + t * dx, origin[1] + t * dy
    length = math.sqrt(1.0 + m * m)
    nx, ny = (dx + m * dy) / length, (dy - m * dx) / length
    if abs(ny) >= abs(nx):
        return True, px, py, ty / tx, kappa * (tx * dy - ty * dx) / tx**3, ny, tx
    return False, py, px, tx / ty, kappa * (ty * dx - tx * dy) / ty**3, nx, ty


@kernel(fastmath=True, nogil=True)
def plateaus(grey, origin, direction, half, state, near, length, out):
    """Line fits to the grey levels in front of and behind the edge.

    ``out`` (2, 6): pixels, mean of z, mean level, slope of the level, variance of z,
    residual variance. Returns False when the window leaves the image.

    Parameters
    ----------
    grey
        Grey image.
    origin, direction
        Origin (x, y) [px] and unit direction of the line, (2,).
    half
        Half width of the window along the edge [px].
    state
        Row of the point, columns as above.
    near, length
        Distance of the plateaus from the edge [blurs], and their length [px].
    out
        Filled, (2, 6), in front and behind.
    """
    flat, pu, pv, slope, curve, nv, tu = frame(origin, direction, state[T], state[SLOPE], state[CURVE])
    rows, columns = grey.shape
    size_u, size_v = (columns, rows) if flat else (rows, columns)
    pixels = grey.reshape(-1)
    step_u, step_v = (1, columns) if flat else (columns, 1)
    reach = half * abs(tu)
    u_first, u_last = int(math.floor(pu - reach)) + 1, int(math.floor(pu + reach))
    gap = int(math.ceil(near * state[BLUR] / abs(nv)))
    run = int(math.ceil(length / abs(nv)))
    bend = abs(slope) * reach + 0.5 * abs(curve) * reach * reach
    if u_first < 0 or u_last >= size_u or pv - bend - gap - run < 1 or pv + bend + gap + run > size_v - 2:
        return False
    for side in range(2):
        s1, sz, szz, si, siz, sii = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        upper = (side == 1) == (nv > 0.0)
        for u in range(u_first, u_last + 1):
            ve = pv + (u - pu) * (slope + 0.5 * curve * (u - pu))
            v0 = int(math.floor(ve))
            begin = v0 + 1 + gap if upper else v0 - gap - run + 1
            total = 0
            square = 0
            moment = 0
            at = begin * step_v + u * step_u
            z0 = (begin - ve) * nv
            for j in range(run):
                value = np.int64(pixels[at + j * step_v])
                total += value
                square += value * value
                moment += j * value
            s1 += run
            sz += run * z0 + nv * 0.5 * run * (run - 1)
            szz += run * z0 * z0 + z0 * nv * run * (run - 1) + nv * nv * (run - 1) * run * (2 * run - 1) / 6.0
            si += total
            siz += total * z0 + nv * moment
            sii += square
            if side == 1 and state[NEXT_STEP] != 0.0:
                for j in range(run):
                    value = np.int64(pixels[at + j * step_v])
                    over = state[NEXT_STEP] * above((z0 + j * nv - state[NEXT]) / state[BLUR])
                    si -= over
                    siz -= over * (z0 + j * nv)
                    sii -= over * (2.0 * value - over)
        mean = si / s1
        centre = sz / s1
        var = szz / s1 - centre * centre
        tilt = (siz / s1 - centre * mean) / var
        out[side, 0] = s1
        out[side, 1] = centre
        out[side, 2] = mean
        out[side, 3] = tilt
        out[side, 4] = var
        out[side, 5] = max(sii / s1 - mean * mean - tilt * tilt * var, 0.0) * s1 / max(s1 - 2.0, 1.0)
        if side == 1 and state[NEXT_STEP] != 0.0:
            # Pixels beyond a second edge show its step, not this level.
            out[side, 0] *= min(max((state[NEXT] - gap * abs(nv)) / (run * abs(nv)), 1.0 / run), 1.0)
    return True


@kernel(fastmath=True, nogil=True)
def step_fit(grey, origin, direction, half, near, prior, state):
    """One scoring step of the maximum-likelihood fit (position, tilt, two levels) of one point.

    ``prior`` (4): level in front, level behind, and their weights in pixels. The
    gradient is exact, the information matrix is the integral over a finely sampled
    edge: its relative error is exp(-2 pi^2 b^2 / 2), below 0.4 % for b >= 0.75 px.
    Reads and updates ``state``; VAR, SPREAD are per unit noise variance.

    Parameters
    ----------
    grey, origin, direction, half
        As in :func:`plateaus`.
    near
        Half length of the window along the line [blurs].
    prior
        Level in front, level behind, and their weights in pixels, (4,).
    state
        Row of the point; read and updated.
    """
    flat, pu, pv, slope, curve, nv, tu = frame(origin, direction, state[T], state[SLOPE], state[CURVE])
    b = state[BLUR]
    low, high = state[LOW], state[HIGH]
    height = high - low
    if abs(height) < 1.0:
        state[STATUS] = FLAT
        return
    rows, columns = grey.shape
    size_u, size_v = (columns, rows) if flat else (rows, columns)
    pixels = grey.reshape(-1)
    step_u, step_v = (1, columns) if flat else (columns, 1)
    reach = half * abs(tu)
    u_first, u_last = int(math.floor(pu - reach)) + 1, int(math.floor(pu + reach))
    run = int(math.ceil(near * b / abs(nv)))
    bend = abs(slope) * reach + 0.5 * abs(curve) * reach * reach
    if (
        u_first < 0
        or u_last >= size_u
        or pv - bend - run < 1
        or pv + bend + run > size_v - 2
        or u_last - u_first < 2
    ):
        state[STATUS] = BORDER
        return
    low_slope, high_slope, next_step = state[LOW_SLOPE], state[HIGH_SLOPE], state[NEXT_STEP]
    scale = STEPS / b
    lanes = u_last - u_first + 1
    m = state[SLOPE]
    length = math.sqrt(1.0 + m * m)
    per_u = length / tu  # signed: s may run against u
    q_mean = (0.5 * (u_first + u_last) - pu) * per_u
    sum_g, sum_qg, sum_low, sum_high = 0.0, 0.0, 0.0, 0.0
    sum_rr, sum_gg, sum_blur = 0.0, 0.0, 0.0
    for u in range(u_first, u_last + 1):
        ve = pv + (u - pu) * (slope + 0.5 * curve * (u - pu))
        begin = int(math.floor(ve)) - run + 1
        lane_g = 0.0
        lane_step = 0.0
        lane_r = 0.0
        at = begin * step_v + u * step_u
        for j in range(2 * run):
            value = np.float64(pixels[at + j * step_v])
            z = (begin + j - ve) * nv
            x = z * scale + REACH * STEPS
            i = min(max(int(x + 0.5), 0), 2 * REACH * STEPS)
            h = (x - i) * (1.0 / STEPS)
            x0 = (i - REACH * STEPS) * (1.0 / STEPS)
            g = NORMAL[i] * (1.0 - x0 * h)
            over = STEP[i] + NORMAL[i] * h * (1.0 - 0.5 * x0 * h)
            r = value - (low + low_slope * z) - (height + (high_slope - low_slope) * z) * over
            if next_step != 0.0:
                r -= next_step * above((z - state[NEXT]) / b)
            lane_g += r * g
            lane_step += r * over
            lane_r += r
            sum_blur += r * g * z
            sum_rr += r * r
        sum_g += lane_g
        sum_gg += lane_g * lane_g
        sum_qg += lane_g * ((u - pu) * per_u - q_mean)
        sum_high += lane_step
        sum_low += lane_r - lane_step
    # d I / d zeta = -height * phi(z / b) / b
    across = lanes / abs(nv)
    bump = across / (2.0 * math.sqrt(math.pi) * b)
    gradient = -height * sum_g / b
    h00 = height * height * bump
    h01 = -0.5 * height * across
    both = across * b / math.sqrt(math.pi)
    plain = lanes * run - both
    h11 = plain + prior[2]
    h22 = plain + prior[3]
    r1 = sum_low + prior[2] * (prior[0] - low)
    r2 = sum_high + prior[3] * (prior[1] - high)
    det = h11 * h22 - both * both
    # Schur complement: the information on zeta that remains if both levels are unknown.
    left = h00 - h01 * h01 * (h11 + h22 - 2.0 * both) / det
    if not left > 1e-9 * h00:
        state[STATUS] = FLAT
        return
    zeta = (gradient - h01 * ((h22 - both) * r1 + (h11 - both) * r2) / det) / left
    c1, c2 = r1 - h01 * zeta, r2 - h01 * zeta
    turn_info = height * height * bump * per_u * per_u * (lanes * lanes - 1.0) / 12.0
    turn = -height * sum_qg / b / turn_info
    limit = 2.0 * b
    zeta = min(max(zeta, -limit), limit)
    turn = min(max(turn, -0.3), 0.3)
    state[LOW] = low + (h22 * c1 - both * c2) / det
    state[HIGH] = high + (h11 * c2 - both * c1) / det
    state[MOVED] = (zeta - turn * q_mean) * length
    state[T] += state[MOVED]
    state[SLOPE] = min(max(m + turn * length * length, -4.0), 4.0)
    state[VAR] = (1.0 / left + q_mean * q_mean / turn_info) * length * length
    state[COUNT] = 2.0 * lanes * run
    state[CHI2] = sum_rr / max(state[COUNT] - 4.0, 1.0)
    # Expected scatter of the gradient between lanes: noise variance.
    state[SPREAD] = max(sum_gg - sum_g * sum_g / lanes, 0.0) / (b * b * bump) * lanes / (lanes - 1.0)
    state[BLUR_INFO] = height * height * across / (4.0 * math.sqrt(math.pi) * b)
    state[BLUR_STEP] = -height * sum_blur / (b * b) / state[BLUR_INFO]
    state[STATUS] = OK


@kernel(fastmath=True, nogil=True)
def fraction(value, variance, use, half, mean, spread):
    """Prediction of each point from its neighbours: local line fit without the point itself.

    Neighbours ``k - half .. k + half`` with ``use``. ``mean`` is the fitted value,
    ``spread`` its variance: the scatter of the neighbours beyond their own
    ``variance`` (empirical Bayes) plus the variance of the fit; infinite if
    fewer than four neighbours are available.

    Parameters
    ----------
    value, variance
        Value and variance of each point, (n,).
    use
        Points to use, (n,).
    half
        Number of neighbours on each side.
    mean, spread
        Filled with the fitted value and its variance, (n,).
    """
    n = value.shape[0]
    sums = np.zeros((n + 1, 7))
    for k in range(n):
        for i in range(7):
            sums[k + 1, i] = sums[k, i]
        if use[k]:
            x, y = float(k), value[k]
            sums[k + 1, 0] += 1.0
            sums[k + 1, 1] += x
            sums[k + 1, 2] += x * x
            sums[k + 1, 3] += y
            sums[k + 1, 4] += x * y
            sums[k + 1, 5] += y * y
            sums[k + 1, 6] += variance[k]
    for k in range(n):
        lo, hi = max(k - half, 0), min(k + half + 1, n)
        own = 1.0 if use[k] else 0.0
        x, y = float(k), value[k] if use[k] else 0.0
        w = sums[hi, 0] - sums[lo, 0] - own
        if w < 4.0:
            mean[k] = value[k]
            spread[k] = np.inf
            continue
        sx = sums[hi, 1] - sums[lo, 1] - own * x
        sxx = sums[hi, 2] - sums[lo, 2] - own * x * x
        sy = sums[hi, 3] - sums[lo, 3] - own * y
        sxy = sums[hi, 4] - sums[lo, 4] - own * x * y
        syy = sums[hi, 5] - sums[lo, 5] - own * y * y
        sv = sums[hi, 6] - sums[lo, 6] - own * (variance[k] if use[k] else 0.0)
        mx, my = sx / w, sy / w
        vx = max(sxx / w - mx * mx, 1e-9)
        b = (sxy / w - mx * my) / vx
        scatter = max(syy / w - my * my - b * b * vx, 0.0) * w / (w - 2.0)
        # One standard deviation of the estimate is tolerated: otherwise chance alone costs a fifth.
        excess = max(scatter - sv / w * (1.0 + math.sqrt(2.0 / w)), 0.0)
        mean[k] = my + b * (x - mx)
        spread[k] = excess + max(scatter, sv / w) / w * (1.0 + (x - mx) * (x - mx) / vx)


@kernel(fastmath=True, nogil=True)
def curvatures(origin, direction, state, trust, noise_var, limit):
    """Curvature of the parabola through each point and its two neighbours, in the frame of its line.

    Shrunk to zero below two standard deviations: the remaining uncorrected error is then a fifth
    of the noise of the point, while a correction by pure noise would increase the noise by 9 %.
    ``trust`` (n), 0 to 1, is the weight of each position. The curvature is reduced with it, and, where it
    is too sharp for a curve, blended into that of its neighbours: a threshold would let noise switch between two edges.

    Parameters
    ----------
    origin, direction
        Origins (x, y) [px] and unit directions of n lines, (n, 2).
    state
        Rows of the points; the curvature is written.
    trust
        Weight of each position, 0 to 1, (n,).
    noise_var
        Variance of one pixel [grey levels^2].
    limit
        Maximum curvature that is corrected [1/px].
    """
    n = origin.shape[0]
    weight = np.zeros(n)
    arc = np.zeros(n)
    for k in range(1, n - 1):
        fraction = min(trust[k - 1], trust[k], trust[k + 1])
        if fraction <= 0.0:
            continue
        dx, dy = direction[k, 0], direction[k, 1]
        x = origin[k, 0] + state[k, T] * dx
        y = origin[k, 1] + state[k, T] * dy
        ax = origin[k - 1, 0] + state[k - 1, T] * direction[k - 1, 0] - x
        ay = origin[k - 1, 1] + state[k - 1, T] * direction[k - 1, 1] - y
        bx = origin[k + 1, 0] + state[k + 1, T] * direction[k + 1, 0] - x
        by = origin[k + 1, 1] + state[k + 1, T] * direction[k + 1, 1] - y
        s1, t1 = -ax * dy + ay * dx, ax * dx + ay * dy
        s2, t2 = -bx * dy + by * dx, bx * dx + by * dy
        if s1 * s2 >= -1.0:
            continue
        kappa = 2.0 * (t2 / s2 - t1 / s1) / (s2 - s1)
        base = 2.0 / (s2 - s1)
        own = 1.0 / s2 - 1.0 / s1
        var = base * base * noise_var
        var *= state[k - 1, VAR] / (s1 * s1) + state[k, VAR] * own * own + state[k + 1, VAR] / (s2 * s2)
        kappa *= max(0.0, 1.0 - 4.0 * var / max(kappa * kappa, 1e-20))
        # Larger curvatures indicate a jump to another edge, not a curve.
        bent = (1.0 + state[k, SLOPE] ** 2) ** 1.5
        sharp = abs(kappa) / (limit * bent)
        weight[k] = fraction * min(max(2.0 - sharp, 0.0), 1.0)
        # The curvature per arc length is constant where the slope changes.
        arc[k] = min(max(kappa, -limit), limit) / bent
    for k in range(n):
        kappa = weight[k] * arc[k]
        if weight[k] < 1.0:
            # Ends and neighbours of lost points: use the adjacent curvature.
            total = 0.0
            sides = 0.0
            for i in range(max(k - 1, 0), min(k + 2, n)):
                if i != k:
                    total += weight[i] * arc[i]
                    sides += weight[i]
            kappa += (1.0 - weight[k]) * total / max(sides, 1.0)
        kappa *= (1.0 + state[k, SLOPE] ** 2) ** 1.5
        state[k, CURVE] = min(max(kappa, -limit), limit)
