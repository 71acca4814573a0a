"""Compiled kernels of the block-wise fit: apparent motions due to the image's blur, and the covariance of the fit."""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

import numpy as np

from ....core.kernels import kernel
from ..._solve_kernels import FAST, solve_step
from ._block_kernels import _fields


@kernel(**FAST)
def seen_blurs(softened, x, y, h, unit, variance, seen, mean):
    """Apparent motion of each block due to the blur of the image, whose second moments are the same in all the image.

    A tilted template is blurred more across the tilt and where it is further away: moments V in the image are those of
    J^-1 V J^-T in the template, where J is the derivative of the warp.

    Parameters
    ----------
    softened
        Apparent motion of each block due to a blur of 1 px^2 of the level along x, across, along y, and due to the curve,
        (rows, columns, 2, 4).
    x, y
        Centred coordinates of the blocks' middles, (columns,) and (rows,).
    h
        Centred coordinates to pixels of the image, (3, 3).
    unit
        Pixels of the level per unit of the centred coordinates.
    variance
        Blur of the level itself [px^2 of the level].
    seen
        Filled as the argument ``softened`` of ``block_step``; the known motion is that due to the level's blur,
        (rows, columns, 2, 5).
    mean
        Filled with the mean blur of the blocks for each of the moments [px^2 of the level], (3,).
    """
    down, across = softened.shape[:2]
    for k in range(3):
        mean[k] = 0.0
    for j in range(down):
        for i in range(across):
            depth = h[2, 0] * x[i] + h[2, 1] * y[j] + h[2, 2]
            u = (h[0, 0] * x[i] + h[0, 1] * y[j] + h[0, 2]) / depth
            v = (h[1, 0] * x[i] + h[1, 1] * y[j] + h[1, 2]) / depth
            size = depth * unit
            a, b = (h[0, 0] - u * h[2, 0]) / size, (h[0, 1] - u * h[2, 1]) / size
            c, d = (h[1, 0] - v * h[2, 0]) / size, (h[1, 1] - v * h[2, 1]) / size
            scale = 1.0 / (a * d - b * c) ** 2
            mean[0] += 0.5 * scale * (d * d + c * c) / (down * across)
            mean[1] -= scale * (b * d + a * c) / (down * across)
            mean[2] += 0.5 * scale * (b * b + a * a) / (down * across)
            for k in range(2):
                xx, xy, yy = softened[j, i, k, 0], softened[j, i, k, 1], softened[j, i, k, 2]
                seen[j, i, k, 0] = scale * (d * d * xx - c * d * xy + c * c * yy)
                seen[j, i, k, 1] = scale * (-2.0 * b * d * xx + (a * d + b * c) * xy - 2.0 * a * c * yy)
                seen[j, i, k, 2] = scale * (b * b * xx - a * b * xy + a * a * yy)
                seen[j, i, k, 3] = softened[j, i, k, 3]
                seen[j, i, k, 4] = -variance * (xx + yy)


@kernel(**FAST)
def block_covariance(x, y, softened, noise, variance, blur, count, step, probability, fits, covariance):
    """Covariance of the step from the scatter of the blocks' own motions about it, each about a fit without this block.

    Returns its mean ratio to that of independent pixels; 0 if the blocks do not determine the step.

    Parameters
    ----------
    x, y, softened, noise, blur, probability, fits
        As in :func:`block_step`, after it.
    variance
        Pixel variance of the blocks that show the template, a result of :func:`block_step`.
    count
        Number of unknowns: 12, or the first 8 alone.
    step
        The step about which they scatter, (12,).
    covariance
        Filled with the covariance, 0 beyond the unknowns, (12, 12).
    """
    down, across = fits.shape[:2]
    matrix, inverse = np.zeros((12, 12)), np.zeros((12, 12))
    field, spread = np.zeros((12, 2)), np.zeros((12, 2))
    vector = np.zeros(12)
    active = np.zeros(12, np.bool_)
    for k in range(count):
        active[k] = True
    for k in range(8, 12):
        matrix[k, k] = 1.0 / (blur * blur) if k < 11 else 1.0
    prior = matrix.copy()
    for j in range(down):
        for i in range(across):
            fit = fits[j, i]
            if fit[6] <= 0.0:
                continue
            _fields(x[i], y[j], softened[j, i], field)
            weight = probability[j, i] / (noise * max(fit[6], variance))
            for k in range(count):
                u = weight * (fit[0] * field[k, 0] + fit[1] * field[k, 1])
                w = weight * (fit[1] * field[k, 0] + fit[2] * field[k, 1])
                for m in range(count):
                    matrix[k, m] += u * field[m, 0] + w * field[m, 1]
    for k in range(12):
        for m in range(12):
            covariance[k, m] = 0.0
    for k in range(count):
        vector[k] = -1.0
        if not solve_step(matrix, vector, active, 0.0, inverse[k]):
            return 0.0
        vector[k] = 0.0
        for m in range(count):
            for n in range(count):
                covariance[m, n] += prior[k, k] * inverse[k, m] * inverse[k, n]
    for j in range(down):
        for i in range(across):
            fit = fits[j, i]
            if fit[6] <= 0.0:
                continue
            _fields(x[i], y[j], softened[j, i], field)
            weight = probability[j, i] / (noise * max(fit[6], variance))
            p, q, r = weight * fit[0], weight * fit[1], weight * fit[2]
            dx, dy = fit[3], fit[4]
            g00 = g01 = g11 = 0.0
            for k in range(count):
                dx -= field[k, 0] * step[k]
                dy -= field[k, 1] * step[k]
                spread[k, 0] = spread[k, 1] = 0.0
                for m in range(count):
                    spread[k, 0] += inverse[k, m] * field[m, 0]
                    spread[k, 1] += inverse[k, m] * field[m, 1]
                g00 += field[k, 0] * spread[k, 0]
                g01 += field[k, 0] * spread[k, 1]
                g11 += field[k, 1] * spread[k, 1]
            # The motion of a block about the fit to the others is (1 - G W)^-1 times that about the fit to all.
            a, b = 1.0 - g00 * p - g01 * q, -g00 * q - g01 * r
            c, d = -g01 * p - g11 * q, 1.0 - g01 * q - g11 * r
            det = max(a * d - b * c, 1e-6)
            dx, dy = (d * dx - b * dy) / det, (a * dy - c * dx) / det
            u, w = p * dx + q * dy, q * dx + r * dy
            for k in range(count):
                vector[k] = spread[k, 0] * u + spread[k, 1] * w
            for k in range(count):
                for m in range(count):
                    covariance[k, m] += vector[k] * vector[m]
    ratio = 0.0
    for k in range(count):
        for m in range(count):
            ratio += matrix[k, m] * covariance[k, m]
    return ratio / count
