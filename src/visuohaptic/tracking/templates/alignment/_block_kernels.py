"""Compiled kernels of the block-wise fit: sums over each block of a template, and a robust step from all blocks."""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

import math

import numpy as np

from ....core.kernels import kernel
from ..._solve_kernels import FAST, solve_step

#: Indices of the diagonal in an upper triangle of seven rows.
_DIAGONAL = np.array([0, 7, 13, 18, 22, 25, 27], dtype=np.int64)


@kernel(**FAST)
def template_sums(template, gradient_x, gradient_y, side, border, sums):
    """Sums over every block of a template of the products that do not depend on the image, see :func:`block_sums`.

    Parameters
    ----------
    template, gradient_x, gradient_y, side, border
        As in :func:`block_sums`.
    sums
        Filled where the image takes no part, (rows, columns, 28).
    """
    rows, columns = template.shape
    down, across = sums.shape[0], sums.shape[1]
    field, total = np.zeros((6, columns), np.float32), np.zeros((28, columns), np.float32)
    x = np.zeros(columns, np.float32)
    for i in range(across):
        end = columns if i == across - 1 else (i + 1) * side
        for u in range(i * side, end):
            x[u] = np.float32((u - 0.5 * (i * side + end - 1)) / side)
    for u in range(border, columns - border):
        field[0, u] = np.float32(1.0)
    for j in range(down):
        end = rows if j == down - 1 else (j + 1) * side
        total[:] = np.float32(0.0)
        for v in range(max(j * side, border), min(end, rows - border)):
            y = np.float32((v - 0.5 * (j * side + end - 1)) / side)
            for u in range(border, columns - border):
                field[3, u], field[4, u], field[5, u] = template[v, u], gradient_x[v, u], gradient_y[v, u]
            for u in range(border, columns - border):
                field[1, u], field[2, u] = x[u] * field[3, u], y * field[3, u]
            n = 0
            for k in range(6):
                for m in range(k, 6):
                    first, second, out = field[k], field[m], total[n]
                    for u in range(columns):
                        out[u] += first[u] * second[u]
                    n += 1
                n += 1
        for i in range(across):
            for n in range(28):
                value = np.float32(0.0)
                for u in range(i * side, columns if i == across - 1 else (i + 1) * side):
                    value += total[n, u]
                sums[j, i, n] = value


@kernel(**FAST)
def block_sums(value, inside, template, gradient_x, gradient_y, fixed, side, border, sums):
    """Sums over the pixels of every block of a template, needed to fit illumination and motion.

    Parameters
    ----------
    value, inside
        Samples of the image, and 1 inside of it, 0 outside, (R, C).
    template, gradient_x, gradient_y
        (R, C) float32; the gradients are per unit of the centred coordinates.
    fixed
        From :func:`template_sums`, (rows, columns, 28).
    side
        Side of a block [px of the template]; the last ones of a row or column are up to twice as large.
    border
        Pixels along the sides of the template that are excluded.
    sums
        Filled with the products of 1, xT, yT, T, gradient x, gradient y and the image, where x and y are
        relative to the centre of the block, in units of its side; upper triangle, row by row, (rows, columns, 28).
    """
    rows, columns = template.shape
    down, across = sums.shape[0], sums.shape[1]
    total = np.zeros((6, columns), np.float32)
    # From 0 on, and with few arrays: other indices are checked, and each pair of arrays is compared.
    sum_i, sum_t, sum_y, sum_gx, sum_gy, sum_ii = total[0], total[1], total[2], total[3], total[4], total[5]
    for j in range(down):
        end = rows if j == down - 1 else (j + 1) * side
        total[:] = np.float32(0.0)
        for i in range(across):
            for k in range(28):
                sums[j, i, k] = fixed[j, i, k]
        for v in range(max(j * side, border), min(end, rows - border)):
            y = np.float32((v - 0.5 * (j * side + end - 1)) / side)
            shown, seen = value[v], inside[v]
            t, across_x, across_y = template[v], gradient_x[v], gradient_y[v]
            count = np.float32(0.0)
            for u in range(columns):
                w = seen[u] * shown[u]
                sum_i[u] += w
                sum_ii[u] += w * shown[u]
                count += seen[u]
            for u in range(columns):
                w = seen[u] * shown[u] * t[u]
                sum_t[u] += w
                sum_y[u] += w * y
            for u in range(columns):
                w = seen[u] * shown[u]
                sum_gx[u] += w * across_x[u]
                sum_gy[u] += w * across_y[u]
            if count < columns - 0.5:
                _without(seen, t, across_x, across_y, y, side, border, sums[j])
        for i in range(across):
            end = columns if i == across - 1 else (i + 1) * side
            middle = np.float32(0.5 * (i * side + end - 1))
            s0 = s1 = s2 = s3 = s4 = s5 = s6 = np.float32(0.0)
            for u in range(max(i * side, border), min(end, columns - border)):
                s0 += sum_i[u]
                s1 += (np.float32(u) - middle) * sum_t[u]
                s2 += sum_y[u]
                s3 += sum_t[u]
                s4 += sum_gx[u]
                s5 += sum_gy[u]
                s6 += sum_ii[u]
            s = sums[j, i]
            s[6], s[12], s[17], s[21], s[24], s[26], s[27] = s0, s1 / side, s2, s3, s4, s5, s6


@kernel(**FAST)
def _without(seen, t, across_x, across_y, y, side, border, sums):
    """Subtract the products of the pixels of one row that are outside of the image from those of the template."""
    columns = len(seen)
    across = sums.shape[0]
    field = np.zeros(6)
    for u in range(border, columns - border):
        if seen[u] > 0:
            continue
        i = min(u // side, across - 1)
        end = columns if i == across - 1 else (i + 1) * side
        x = (u - 0.5 * (i * side + end - 1)) / side
        field[0], field[1], field[2], field[3] = 1.0, x * t[u], y * t[u], t[u]
        field[4], field[5] = across_x[u], across_y[u]
        n = 0
        for k in range(6):
            for m in range(k, 6):
                sums[i, n] -= field[k] * field[m]
                n += 1
            n += 1


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
                    for m in range(k + 1):
                        matrix[k, m] += u * field[m, 0] + w * field[m, 1]
                    vector[k] -= u * fit[3] + w * fit[4]
        for k in range(12):
            for m in range(k):
                matrix[m, k] = matrix[k, m]
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
