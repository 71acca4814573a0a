"""Compiled kernels that sample an image at the warped pixels of a template.

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
def row_bilinear(image, width, columns, index, fx, fy, value):
    """Bilinear samples of one row.

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
    value
        Filled, (C,).
    """
    right, down, both = np.uint32(1), np.uint32(width), np.uint32(width + 1)
    for i in range(columns):
        k = np.uint32(index[i])
        f, g = fx[i], fy[i]
        p, q = image[k], image[k + right]
        r, s = image[k + down], image[k + both]
        t = p + f * (q - p)
        value[i] = t + g * (r + f * (s - r) - t)


@kernel(**FAST)
def row_cubic(coefficients, width, columns, index, fx, fy, weights, sums, value):
    """Cubic-spline samples of one row from B-spline coefficients.

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
    weights, sums
        Scratch for the weights of the rows, and the sums over them, (4, C).
    value
        Filled, (C,).
    """
    two, three, four, sixth = np.float32(2.0), np.float32(3.0), np.float32(4.0), np.float32(1.0 / 6.0)
    one = np.float32(1.0)
    down = np.uint32(width)
    u1, u2, u3 = np.uint32(1), np.uint32(2), np.uint32(3)
    c = coefficients
    for i in range(columns):
        f = fy[i]
        g = one - f
        b0, b3 = sixth * g * g * g, sixth * f * f * f
        b1 = sixth * (four - three * f * f * (two - f))
        weights[0, i], weights[1, i], weights[2, i], weights[3, i] = b0, b1, one - b0 - b1 - b3, b3
    # Three loops: only the middle one, which reads single pixels, is not vectorised by the compiler.
    for i in range(columns):
        k = np.uint32(index[i]) - down - u1
        m = k + down
        n = m + down
        o = n + down
        b0, b1, b2, b3 = weights[0, i], weights[1, i], weights[2, i], weights[3, i]
        sums[0, i] = b0 * c[k] + b1 * c[m] + b2 * c[n] + b3 * c[o]
        sums[1, i] = b0 * c[k + u1] + b1 * c[m + u1] + b2 * c[n + u1] + b3 * c[o + u1]
        sums[2, i] = b0 * c[k + u2] + b1 * c[m + u2] + b2 * c[n + u2] + b3 * c[o + u2]
        sums[3, i] = b0 * c[k + u3] + b1 * c[m + u3] + b2 * c[n + u3] + b3 * c[o + u3]
    for i in range(columns):
        f = fx[i]
        g = one - f
        a0, a3 = sixth * g * g * g, sixth * f * f * f
        a1 = sixth * (four - three * f * f * (two - f))
        value[i] = a0 * sums[0, i] + a1 * sums[1, i] + (one - a0 - a1 - a3) * sums[2, i] + a3 * sums[3, i]


@kernel(**FAST)
def row_energy(columns, fx, fy, cubic):
    """Mean variance of the samples of one row, where pixels are independent with variance 1.

    Of bilinear samples it is the sum of the squared weights. Of a cubic spline it is ``b^T R b`` along each axis, with the
    four B-spline weights b and the autocorrelation R of the prefilter ``h[k] = sqrt(3) z^|k|``, ``z = sqrt(3) - 2``,
    which is ``3 z^|k| ((1 + z^2) / (1 - z^2) + |k|)``.

    Parameters
    ----------
    columns
        Number of columns.
    fx, fy
        From :func:`row_positions`, (C,).
    cubic
        Whether the samples are those of a cubic spline.
    """
    total = np.float32(0.0)
    for i in range(columns):
        total += _energy(fx[i], cubic) * _energy(fy[i], cubic)
    return total / np.float32(columns)


@kernel(**FAST)
def _energy(f, cubic):
    """Variance of a sample a fraction ``f`` of a pixel beyond one, along one axis."""
    one, two, three, sixth = np.float32(1.0), np.float32(2.0), np.float32(3.0), np.float32(1.0 / 6.0)
    g = one - f
    a0, a3 = sixth * g * g * g, sixth * f * f * f
    a1 = sixth * (np.float32(4.0) - three * f * f * (two - f))
    a2 = one - a0 - a1 - a3
    spline = np.float32(3.464102) * (a0 * a0 + a1 * a1 + a2 * a2 + a3 * a3)
    spline -= np.float32(3.464102) * (a0 * a1 + a1 * a2 + a2 * a3)
    spline += np.float32(1.358984) * (a0 * a2 + a1 * a3) - np.float32(0.480948) * a0 * a3
    return spline if cubic else one - two * f * g


@kernel(**FAST)
def sample_rows(image, h, offset, rows, cubic, value, inside):
    """Samples of an image at the warped pixels of a template.

    Returns the mean variance of a sample where the pixels of the image are independent with variance 1.

    Parameters
    ----------
    image
        (height, width) float32, B-spline coefficients where ``cubic``.
    h
        Column, row, 1 to the image, (3, 3).
    offset
        (2, R, C), added to the warped position [px]; (2, 1, 1): none.
    rows
        Rows to sample.
    cubic
        Use cubic-spline interpolation.
    value, inside
        Filled with the samples, and with 1 inside of the image, 0 outside, (R, C).
    """
    height, width = image.shape
    columns = value.shape[1]
    flat = image.reshape(-1)
    index = np.zeros(columns, np.int32)
    fx, fy, nothing = (
        np.zeros(columns, np.float32),
        np.zeros(columns, np.float32),
        np.zeros(columns, np.float32),
    )
    weights, sums = np.zeros((4, columns), np.float32), np.zeros((4, columns), np.float32)
    moved = offset.shape[1] > 1
    energy, count = 0.0, 0
    for k in range(len(rows)):
        v = rows[k]
        ox = offset[0, v] if moved else nothing
        oy = offset[1, v] if moved else nothing
        row_positions(h, v, columns, width, height, ox, oy, index, fx, fy, inside[v])
        if cubic:
            row_cubic(flat, width, columns, index, fx, fy, weights, sums, value[v])
        else:
            row_bilinear(flat, width, columns, index, fx, fy, value[v])
        # A third of the rows tells the mean: their fractions differ unless all are the same.
        if k % 3 == 0:
            energy += row_energy(columns, fx, fy, cubic)
            count += 1
    return energy / max(count, 1)
