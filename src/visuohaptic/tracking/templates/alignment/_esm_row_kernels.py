"""Compiled kernels for one row of a template: sub-pixel sampling, weights, and sums over powers of x.

Each loop is simple enough for the compiler to vectorise. Unsigned indices
are intentional: signed ones would be checked for wrap-around, which prevents vectorisation.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

import numpy as np

from ....core.kernels import kernel
from ..._solve_kernels import FAST


@kernel(**FAST)
def row_positions(h, y, columns, width, height, offset_x, offset_y, index, fx, fy, inside):
    """Image positions of one template row: cell index, fractions, and 1 inside / 0 outside.

    Parameters
    ----------
    h
        Column, row, 1 to the image, (3, 3).
    y
        The row.
    columns
        Number of columns.
    width, height
        Size of the image [px].
    offset_x, offset_y
        Added to the positions [px], (C,).
    index, fx, fy, inside
        Filled, (C,).
    """
    h0, h3, h6 = np.float32(h[0, 0]), np.float32(h[1, 0]), np.float32(h[2, 0])
    a = np.float32(h[0, 1] * y + h[0, 2])
    b = np.float32(h[1, 1] * y + h[1, 2])
    c = np.float32(h[2, 1] * y + h[2, 2])
    one = np.float32(1.0)
    # One pixel of margin on the low side and two on the high side, for the cubic kernel.
    x_max, y_max = np.float32(width - 2.001), np.float32(height - 2.001)
    for i in range(columns):
        x = np.float32(i)
        q = one / (h6 * x + c)
        px = (h0 * x + a) * q + offset_x[i]
        py = (h3 * x + b) * q + offset_y[i]
        qx = min(max(px, one), x_max)
        qy = min(max(py, one), y_max)
        inside[i] = one if (qx == px) & (qy == py) & (q > np.float32(0.0)) else np.float32(0.0)
        ix, iy = np.int32(qx), np.int32(qy)
        fx[i] = qx - np.float32(ix)
        fy[i] = qy - np.float32(iy)
        index[i] = iy * np.int32(width) + ix


@kernel(**FAST)
def row_bilinear(image, width, columns, index, fx, fy, value, energy):
    """Bilinear samples of one row, and the sum of the squared weights of each.

    Parameters
    ----------
    image
        The image, row by row, (height * width,).
    width
        Of the image [px].
    columns
        Number of columns.
    index, fx, fy
        From :func:`row_positions`, (C,).
    value, energy
        Filled with samples and the sums of their squared weights, (C,).
    """
    one, two = np.float32(1.0), np.float32(2.0)
    right, down, both = np.uint32(1), np.uint32(width), np.uint32(width + 1)
    for i in range(columns):
        k = np.uint32(index[i])
        f, g = fx[i], fy[i]
        p, q = image[k], image[k + right]
        r, s = image[k + down], image[k + both]
        t = p + f * (q - p)
        value[i] = t + g * (r + f * (s - r) - t)
        energy[i] = (one - two * f * (one - f)) * (one - two * g * (one - g))


@kernel(**FAST)
def row_cubic(coefficients, width, columns, index, fx, fy, weights, value, energy):
    """Cubic-spline samples of one row from B-spline coefficients, and the variance of each.

    The variance is that of the sample when the pixels (before the prefilter) are
    independent with variance 1: ``b^T R b`` with the four B-spline weights b and the
    autocorrelation R of the prefilter ``h[k] = sqrt(3) z^|k|``, ``z = sqrt(3) - 2``, which is
    ``3 z^|k| ((1 + z^2) / (1 - z^2) + |k|)``.

    Parameters
    ----------
    coefficients
        B-spline coefficients, row by row, (height * width,).
    width
        Of the image [px].
    columns
        Number of columns.
    index, fx, fy
        From :func:`row_positions`, (C,).
    weights
        Scratch for the spline weights, (2, 4, C).
    value, energy
        Filled with samples and their variances, (C,).
    """
    two, three, four, sixth = np.float32(2.0), np.float32(3.0), np.float32(4.0), np.float32(1.0 / 6.0)
    one = np.float32(1.0)
    r0, r1 = np.float32(3.464102), np.float32(-1.732051)
    r2, r3 = np.float32(0.679492), np.float32(-0.240474)
    down = np.uint32(width)
    u1, u2, u3 = np.uint32(1), np.uint32(2), np.uint32(3)
    c = coefficients
    wx, wy = weights[0], weights[1]
    for i in range(columns):
        f = fx[i]
        g = one - f
        a0, a3 = sixth * g * g * g, sixth * f * f * f
        a1 = sixth * (four - three * f * f * (two - f))
        a2 = one - a0 - a1 - a3
        e = r0 * (a0 * a0 + a1 * a1 + a2 * a2 + a3 * a3) + two * r1 * (a0 * a1 + a1 * a2 + a2 * a3)
        e += two * (r2 * (a0 * a2 + a1 * a3) + r3 * a0 * a3)
        wx[0, i], wx[1, i], wx[2, i], wx[3, i] = a0, a1, a2, a3
        f = fy[i]
        g = one - f
        a0, a3 = sixth * g * g * g, sixth * f * f * f
        a1 = sixth * (four - three * f * f * (two - f))
        a2 = one - a0 - a1 - a3
        d = r0 * (a0 * a0 + a1 * a1 + a2 * a2 + a3 * a3) + two * r1 * (a0 * a1 + a1 * a2 + a2 * a3)
        d += two * (r2 * (a0 * a2 + a1 * a3) + r3 * a0 * a3)
        wy[0, i], wy[1, i], wy[2, i], wy[3, i] = a0, a1, a2, a3
        energy[i] = e * d
    # A separate loop: the four neighbours in a row are one load, four rows are four products.
    for i in range(columns):
        k = np.uint32(index[i]) - down - u1
        m = k + down
        n = m + down
        o = n + down
        b0, b1, b2, b3 = wy[0, i], wy[1, i], wy[2, i], wy[3, i]
        t0 = b0 * c[k] + b1 * c[m] + b2 * c[n] + b3 * c[o]
        t1 = b0 * c[k + u1] + b1 * c[m + u1] + b2 * c[n + u1] + b3 * c[o + u1]
        t2 = b0 * c[k + u2] + b1 * c[m + u2] + b2 * c[n + u2] + b3 * c[o + u2]
        t3 = b0 * c[k + u3] + b1 * c[m + u3] + b2 * c[n + u3] + b3 * c[o + u3]
        value[i] = wx[0, i] * t0 + wx[1, i] * t1 + wx[2, i] * t2 + wx[3, i] * t3


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
def row_light(columns, r, t, w, energy, sums):
    """Sums of w {1, T, T T, r, T r, r r, energy}.

    Parameters
    ----------
    columns
        Number of columns.
    r, t, w, energy
        Residual, template, weight and variance of each sample, (C,).
    sums
        Added to, (7,).
    """
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = np.float32(0.0)
    for i in range(columns):
        c = w[i]
        a, b = c * t[i], c * r[i]
        s0 += c
        s1 += a
        s2 += a * t[i]
        s3 += b
        s4 += a * r[i]
        s5 += b * r[i]
        s6 += c * energy[i]
    sums[0] += s0
    sums[1] += s1
    sums[2] += s2
    sums[3] += s3
    sums[4] += s4
    sums[5] += s5
    sums[6] += s6
