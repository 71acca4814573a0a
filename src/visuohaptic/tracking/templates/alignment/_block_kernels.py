"""Compiled kernels of the block-wise fit: sums over each block of a template, and a robust step from all blocks."""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

import math

import numpy as np

from ....core.kernels import kernel
from ..._solve_kernels import FAST, solve_step
from ._esm_row_kernels import row_bilinear, row_cubic, row_positions

#: Indices of the diagonal in an upper triangle of seven rows.
_DIAGONAL = np.array([0, 7, 13, 18, 22, 25, 27], dtype=np.int64)


@kernel(**FAST)
def block_sums(image, template, gradient_x, gradient_y, offset, h, cubic, side, border, sums):
    """Sums over the pixels of every block of a template, needed to fit illumination and motion.

    Parameters
    ----------
    image
        (height, width) float32, B-spline coefficients where ``cubic``.
    template, gradient_x, gradient_y
        (R, C) float32; the gradients are per unit of the centred coordinates.
    offset
        (2, R, C), added to the warped position [px]; (2, 1, 1): none.
    h
        Column, row, 1 to the image, (3, 3).
    cubic
        Use cubic-spline interpolation.
    side
        Side of a block [px of the template]; the last ones of a row or column are up to twice as large.
    border
        Pixels along the sides of the template that are excluded.
    sums
        Filled with the products of 1, xT, yT, T, gradient x, gradient y and the image, where x and y are
        relative to the centre of the block, in units of its side; upper triangle, row by row, (rows, columns, 28).
    """
    height, width = image.shape
    rows, columns = template.shape
    down, across = sums.shape[0], sums.shape[1]
    flat = image.reshape(-1)
    index = np.zeros(columns, np.int32)
    fx = np.zeros(columns, np.float32)
    fy = np.zeros(columns, np.float32)
    inside = np.zeros(columns, np.float32)
    value = np.zeros(columns, np.float32)
    energy = np.zeros(columns, np.float32)
    weights = np.zeros((2, 4, columns), np.float32)
    nothing = np.zeros(columns, np.float32)
    moved = offset.shape[1] > 1
    zero, scale = np.float32(0.0), np.float32(1.0 / side)
    for j in range(down):
        for i in range(across):
            for k in range(28):
                sums[j, i, k] = 0.0
    for v in range(border, rows - border):
        ox = offset[0, v] if moved else nothing
        oy = offset[1, v] if moved else nothing
        row_positions(h, v, columns, width, height, ox, oy, index, fx, fy, inside)
        for u in range(border):
            inside[u] = inside[columns - 1 - u] = zero
        if cubic:
            row_cubic(flat, width, columns, index, fx, fy, weights, value, energy)
        else:
            row_bilinear(flat, width, columns, index, fx, fy, value, energy)
        t, across_x, across_y = template[v], gradient_x[v], gradient_y[v]
        j = min(v // side, down - 1)
        below = rows if j == down - 1 else (j + 1) * side
        y = np.float32((v - 0.5 * (j * side + below - 1)) / side)
        for i in range(across):
            end = columns if i == across - 1 else (i + 1) * side
            middle = np.float32(0.5 * (i * side + end - 1))
            s00 = s01 = s02 = s03 = s04 = s05 = s06 = zero
            s11 = s12 = s13 = s14 = s15 = s16 = s22 = zero
            s23 = s24 = s25 = s26 = s33 = s34 = s35 = zero
            s36 = s44 = s45 = s46 = s55 = s56 = s66 = zero
            for u in range(i * side, end):
                w = inside[u]
                x = (np.float32(u) - middle) * scale
                q0, q3, q4, q5, q6 = w, w * t[u], w * across_x[u], w * across_y[u], w * value[u]
                q1, q2 = x * q3, y * q3
                xt, yt = x * t[u], y * t[u]
                s00 += q0
                s01 += q1
                s02 += q2
                s03 += q3
                s04 += q4
                s05 += q5
                s06 += q6
                s11 += q1 * xt
                s12 += q1 * yt
                s13 += q1 * t[u]
                s14 += q1 * across_x[u]
                s15 += q1 * across_y[u]
                s16 += q1 * value[u]
                s22 += q2 * yt
                s23 += q2 * t[u]
                s24 += q2 * across_x[u]
                s25 += q2 * across_y[u]
                s26 += q2 * value[u]
                s33 += q3 * t[u]
                s34 += q3 * across_x[u]
                s35 += q3 * across_y[u]
                s36 += q3 * value[u]
                s44 += q4 * across_x[u]
                s45 += q4 * across_y[u]
                s46 += q4 * value[u]
                s55 += q5 * across_y[u]
                s56 += q5 * value[u]
                s66 += q6 * value[u]
            s = sums[j, i]
            s[0] += s00
            s[1] += s01
            s[2] += s02
            s[3] += s03
            s[4] += s04
            s[5] += s05
            s[6] += s06
            s[7] += s11
            s[8] += s12
            s[9] += s13
            s[10] += s14
            s[11] += s15
            s[12] += s16
            s[13] += s22
            s[14] += s23
            s[15] += s24
            s[16] += s25
            s[17] += s26
            s[18] += s33
            s[19] += s34
            s[20] += s35
            s[21] += s36
            s[22] += s44
            s[23] += s45
            s[24] += s46
            s[25] += s55
            s[26] += s56
            s[27] += s66


@kernel(**FAST)
def _block_fit(s, m, fit):
    """Motion of one block, estimated jointly with its gain, its slopes and its bias.

    Parameters
    ----------
    s
        Sums of the block, (28,).
    m
        Scratch, (7, 7).
    fit
        Filled with the products of the gradients xx, xy, yy times the squared gain, the motion x, y, the squared
        correlation after removal of bias and slopes, the variance of a pixel, the gain, and the sum that determines it; all 0
        if the block is uninformative, (9,).
    """
    k = 0
    for i in range(9):
        fit[i] = 0.0
    for i in range(7):
        for j in range(i, 7):
            m[i, j] = m[j, i] = s[k]
            k += 1
    gain = 0.0
    for k in range(4):
        if m[k, k] <= 1e-6 * s[_DIAGONAL[k]] + 1e-6:
            return
        if k == 3:
            gain = m[3, 6] / m[3, 3]
            if gain <= 0.0 or m[6, 6] <= 1e-3 * s[0]:
                return
            fit[7], fit[8] = gain, m[3, 3]
            fit[5] = min(gain * m[3, 6] / m[6, 6], 1.0 - 1e-6)
        for i in range(k + 1, 7):
            factor = m[i, k] / m[k, k]
            for j in range(k + 1, 7):
                m[i, j] -= factor * m[k, j]
    # A hundred-thousandth keeps a block with edges in one direction solvable; no information across them.
    damp = 1e-5 * (m[4, 4] + m[5, 5]) + 1e-9
    p, q, r = m[4, 4] + damp, m[4, 5], m[5, 5] + damp
    det = p * r - q * q
    x, y = (r * m[4, 6] - q * m[5, 6]) / det, (p * m[5, 6] - q * m[4, 6]) / det
    # Grey levels are integers: a variance of 1 / 12.
    fit[6] = max((m[6, 6] - x * m[4, 6] - y * m[5, 6]) / max(s[0] - 6.0, 1.0), 1.0 / 12.0)
    factor = gain * gain
    fit[0], fit[1], fit[2] = factor * p, factor * q, factor * r
    fit[3], fit[4] = -x / gain, -y / gain


@kernel(**FAST)
def _fields(x, y, softened, field):
    """The eight velocity fields at one point, and the apparent motion of three blurs and the curve there, (12, 2)."""
    field[0, 0], field[1, 0], field[2, 0] = 1.0, x, y
    field[3, 1], field[4, 1], field[5, 1] = 1.0, x, y
    field[6, 0], field[6, 1] = -x * x, -x * y
    field[7, 0], field[7, 1] = -x * y, -y * y
    for k in range(4):
        field[8 + k, 0], field[8 + k, 1] = softened[0, k], softened[1, k]


@kernel(**FAST)
def block_step(sums, x, y, softened, independent, full, noise, blur, passes, step, matrix, probability, fits):
    """Robust step of the homography from all blocks: expectation-maximisation over template or other content.

    Returns the log-odds that the template is present, and the pixel variance of the blocks that show it.

    Parameters
    ----------
    sums
        From :func:`block_sums`, (rows, columns, 28).
    x, y
        Centred coordinates of the blocks' middles, (columns,) and (rows,).
    softened
        Apparent motion of each block due to a blur of 1 px^2 of the image, along x, across, along y, due to the curve, and
        a known one, (rows, columns, 2, 5).
    independent
        Number of independent values in a block, (rows, columns).
    full
        Minimum number of valid pixels of a block [px].
    noise
        Variance of a sum over pixels, relative to that of independent ones.
    blur
        Standard deviation of the blur relative to the template [px^2]; that of the curve is 1.
    passes
        Number of expectation-maximisation passes.
    step
        Filled with the eight parameters of the small homography, three of the blur [px^2] and the curve, (12,).
    matrix
        Filled with the information on them, (12, 12).
    probability
        Filled with the probability that a block shows the template, (rows, columns).
    fits
        Filled with the fit of each block as described in :func:`_block_fit`, (rows, columns, 9).
    """
    down, across = sums.shape[0], sums.shape[1]
    scratch = np.zeros((7, 7))
    chance = np.zeros((down, across))
    vector = np.zeros(12)
    active = np.ones(12, np.bool_)
    field = np.zeros((12, 2))
    rest, count = 0.0, 0.0
    for j in range(down):
        for i in range(across):
            probability[j, i] = 0.0
            fit = fits[j, i]
            fit[6] = 0.0
            if sums[j, i, 0] < full:
                continue
            _block_fit(sums[j, i], scratch, fit)
            fit[3] += softened[j, i, 0, 4]
            fit[4] += softened[j, i, 1, 4]
            m = max(independent[j, i] - 2.0, 3.0)
            # Density of a chance correlation; for the template, with unknown noise and blur, it is 1.
            beta = math.lgamma(0.5) + math.lgamma(0.5 * (m - 2.0)) - math.lgamma(0.5 * (m - 1.0))
            chance[j, i] = beta - 0.5 * (m - 4.0) * np.log(1.0 - fit[5]) if fit[5] > 0.0 else -5.0
            probability[j, i] = 1.0 / (1.0 + np.exp(-chance[j, i]))
            if fit[6] > 0.0:
                rest += probability[j, i] * sums[j, i, 0] * fit[6]
                count += probability[j, i] * sums[j, i, 0]
    odds, variance, scatter = 0.0, rest / max(count, 1e-9), 1.0
    for _ in range(passes):
        for k in range(12):
            vector[k] = 0.0
            for m in range(12):
                matrix[k, m] = 0.0
        for k in range(8, 11):
            matrix[k, k] = 1.0 / (blur * blur)
        matrix[11, 11] = 1.0
        for j in range(down):
            for i in range(across):
                fit = fits[j, i]
                if fit[6] <= 0.0:
                    continue
                _fields(x[i], y[j], softened[j, i], field)
                p = probability[j, i] / (noise * scatter * max(fit[6], variance))
                for k in range(12):
                    u = p * (fit[0] * field[k, 0] + fit[1] * field[k, 1])
                    w = p * (fit[1] * field[k, 0] + fit[2] * field[k, 1])
                    for m in range(12):
                        matrix[k, m] += u * field[m, 0] + w * field[m, 1]
                    vector[k] -= u * fit[3] + w * fit[4]
        if not solve_step(matrix, vector, active, 0.0, step):
            return -np.inf, 0.0
        total, motions, odds, rest, count = 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(down):
            for i in range(across):
                fit = fits[j, i]
                if fit[6] <= 0.0:
                    continue
                _fields(x[i], y[j], softened[j, i], field)
                dx, dy = fit[3], fit[4]
                for k in range(12):
                    dx -= field[k, 0] * step[k]
                    dy -= field[k, 1] * step[k]
                chi2 = fit[0] * dx * dx + 2.0 * fit[1] * dx * dy + fit[2] * dy * dy
                chi2 /= noise * scatter * max(fit[6], variance)
                total += probability[j, i] * chi2
                motions += probability[j, i]
                # The motion of a chance match is that of few independent values instead of many pixels.
                wider = sums[j, i, 0] / max(independent[j, i], 3.0)
                ratio = chance[j, i] + np.log(wider) + 0.5 * chi2 * (1.0 / wider - 1.0)
                ratio = min(max(ratio, -30.0), 30.0)
                odds += np.log(0.5 + 0.5 * np.exp(ratio))
                probability[j, i] = 1.0 / (1.0 + np.exp(-ratio))
                rest += probability[j, i] * sums[j, i, 0] * fit[6]
                count += probability[j, i] * sums[j, i, 0]
        variance = rest / max(count, 1e-9)
        # Scatter of the motions beyond noise: compression, aliasing, paper that is not flat.
        scatter = max(scatter * total / max(2.0 * motions - 12.0, 1.0), 1.0)
    return odds, variance
