"""Compiled kernels for one row of a template: weights, gradients, and sums over powers of x.

Each loop is simple enough for the compiler to vectorise.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

import numpy as np

from ....core.kernels import kernel
from ..._solve_kernels import FAST


@kernel(**FAST)
def row_correlation(columns, value, template, inside, sums):
    """Unweighted sums for the correlation: n, I, T, I I, I T, T T.

    Parameters
    ----------
    columns
        Number of columns.
    value, template, inside
        Samples of the image, the template, and the validity mask, (C,).
    sums
        Added to, (6,).
    """
    s0 = s1 = s2 = s3 = s4 = s5 = np.float32(0.0)
    for i in range(columns):
        m = inside[i]
        a, b = m * value[i], m * template[i]
        s0 += m
        s1 += a
        s2 += b
        s3 += a * a
        s4 += a * b
        s5 += b * b
    sums[0] += s0
    sums[1] += s1
    sums[2] += s2
    sums[3] += s3
    sums[4] += s4
    sums[5] += s5


@kernel(**FAST)
def row_residual(columns, value, template, inside, gain, bias, cut, margin, residual, weight):
    """Residual I - (gain T + bias) and its robust weight: 1 up to ``cut``, then (cut/r)^4.

    Pixels whose predicted value is within ``margin`` of 0 or 255 have zero weight: their noise is
    clipped on one side. The selection depends on the model alone, so it causes no bias.

    Parameters
    ----------
    columns
        Number of columns.
    value, template, inside
        Samples of the image, the template, and the validity mask, (C,).
    gain, bias
        Image = gain template + bias.
    cut
        Residual up to which a pixel has full weight [grey levels].
    margin
        Distance from 0 and 255 within which a pixel has zero weight [grey levels].
    residual, weight
        Filled, (C,).
    """
    a, b, one = np.float32(gain), np.float32(bias), np.float32(1.0)
    scale = np.float32(1.0 / (cut * cut))
    low, high = np.float32(margin), np.float32(255.0 - margin)
    zero = np.float32(0.0)
    for i in range(columns):
        p = a * template[i] + b
        r = value[i] - p
        z = one / max(one, r * r * scale)
        residual[i] = r
        weight[i] = inside[i] * z * z if (p >= low) & (p <= high) else zero


@kernel(**FAST)
def row_gradient(columns, gain, fraction, before, here, after, tx, ty, scale, gx, gy):
    """Jacobian directions: (1 - fraction) gain grad T + fraction grad I of the warped image.

    Parameters
    ----------
    columns
        Number of columns.
    gain
        Image = gain template + bias.
    fraction
        Fraction taken from the warped image.
    before, here, after
        Samples of the image in the previous, current and next row, (C,).
    tx, ty
        Gradients of the template, (C,).
    scale
        Conversion factor from sample differences to the unit of the gradients.
    gx, gy
        Filled, (C,).
    """
    a = np.float32((1.0 - fraction) * gain)
    b = np.float32(0.5 * fraction * scale)
    for i in range(columns):
        gy[i] = a * ty[i] + b * (after[i] - before[i])
    for i in range(1, columns - 1):
        gx[i] = a * tx[i] + b * (here[i + 1] - here[i - 1])
    c = np.float32(gain)
    gx[0] = c * tx[0]
    gx[columns - 1] = c * tx[columns - 1]


@kernel(**FAST)
def row_matrix(columns, x, gx, gy, w, xx, xy, yy):
    """Sums over one row of w gx gx x^i, w gx gy x^i, w gy gy x^i, i = 0..4.

    Parameters
    ----------
    columns
        Number of columns.
    x
        Centred column coordinates, (C,).
    gx, gy, w
        Gradients and weights, (C,).
    xx, xy, yy
        Filled, (5,).
    """
    a0 = a1 = a2 = a3 = a4 = np.float32(0.0)
    b0 = b1 = b2 = b3 = b4 = np.float32(0.0)
    c0 = c1 = c2 = c3 = c4 = np.float32(0.0)
    for i in range(columns):
        p = x[i]
        wx, wy = w[i] * gx[i], w[i] * gy[i]
        a, b, c = wx * gx[i], wx * gy[i], wy * gy[i]
        a0 += a
        b0 += b
        c0 += c
        a, b, c = a * p, b * p, c * p
        a1 += a
        b1 += b
        c1 += c
        a, b, c = a * p, b * p, c * p
        a2 += a
        b2 += b
        c2 += c
        a, b, c = a * p, b * p, c * p
        a3 += a
        b3 += b
        c3 += c
        a4 += a * p
        b4 += b * p
        c4 += c * p
    xx[0], xx[1], xx[2], xx[3], xx[4] = a0, a1, a2, a3, a4
    xy[0], xy[1], xy[2], xy[3], xy[4] = b0, b1, b2, b3, b4
    yy[0], yy[1], yy[2], yy[3], yy[4] = c0, c1, c2, c3, c4


@kernel(**FAST)
def row_vector(columns, x, g, r, t, w, out):
    """Sums over one row of w g {r, T, 1} x^i, i = 0..2, for one direction of the gradient.

    Parameters
    ----------
    columns
        Number of columns.
    x
        Centred column coordinates, (C,).
    g, r, t, w
        Gradient, residual, template and weight, (C,).
    out
        Filled, (3, 3).
    """
    a0 = a1 = a2 = np.float32(0.0)
    b0 = b1 = b2 = np.float32(0.0)
    c0 = c1 = c2 = np.float32(0.0)
    for i in range(columns):
        p = x[i]
        c = w[i] * g[i]
        a, b = c * r[i], c * t[i]
        a0 += a
        b0 += b
        c0 += c
        a, b, c = a * p, b * p, c * p
        a1 += a
        b1 += b
        c1 += c
        a2 += a * p
        b2 += b * p
        c2 += c * p
    out[0, 0], out[0, 1], out[0, 2] = a0, a1, a2
    out[1, 0], out[1, 1], out[1, 2] = b0, b1, b2
    out[2, 0], out[2, 1], out[2, 2] = c0, c1, c2


@kernel(**FAST)
def row_light(columns, r, t, w, sums):
    """Sums of w {1, T, T T, r, T r, r r}.

    Parameters
    ----------
    columns
        Number of columns.
    r, t, w
        Residual, template and weight, (C,).
    sums
        Added to, (6,).
    """
    s0 = s1 = s2 = s3 = s4 = s5 = np.float32(0.0)
    for i in range(columns):
        c = w[i]
        a, b = c * t[i], c * r[i]
        s0 += c
        s1 += a
        s2 += a * t[i]
        s3 += b
        s4 += a * r[i]
        s5 += b * r[i]
    sums[0] += s0
    sums[1] += s1
    sums[2] += s2
    sums[3] += s3
    sums[4] += s4
    sums[5] += s5
