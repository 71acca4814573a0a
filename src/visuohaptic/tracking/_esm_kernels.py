"""Compiled loops of the planar tracker: sub-pixel sampling and the Gauss-Newton sums.

A template has R rows and C columns. ``x``, ``y`` are its centred coordinates in
units of half its longer side, so that both lie in about [-1, 1] and the eight
unknowns of a small homography have the same size. The eight velocity fields are

====  =========  ====  =========  ====  ==============
0     (1, 0)     3     (0, 1)     6     (-x^2, -x y)
1     (x, 0)     4     (0, x)     7     (-x y, -y^2)
2     (y, 0)     5     (0, y)
====  =========  ====  =========  ====  ==============

so that every product of two columns of the Jacobian is gx gx, gx gy or gy gy times
a monomial of degree four at most. A row therefore needs only sums over powers of
x (which the compiler turns into vector instructions); powers of y are applied once
per row, and the 10 x 10 system is put together once per pass.

Unsigned indices are on purpose: signed ones would be checked for wrap-around,
which keeps the loops from being vectorised.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

import numba as nb
import numpy as np

__all__ = ["gauss_newton_sums", "refine_level", "solve_step"]

_JIT = {"cache": True, "fastmath": True, "error_model": "numpy", "nogil": True}

# Field k: coefficient and powers of x and y that go with gx, then those with gy.
_FIELDS = np.array(
    [
        [1, 0, 0, 0, 0, 0],
        [1, 1, 0, 0, 0, 0],
        [1, 0, 1, 0, 0, 0],
        [0, 0, 0, 1, 0, 0],
        [0, 0, 0, 1, 1, 0],
        [0, 0, 0, 1, 0, 1],
        [-1, 2, 0, -1, 1, 1],
        [-1, 1, 1, -1, 0, 2],
    ],
    dtype=np.int64,
)


@nb.njit(**_JIT)
def _row_positions(h, y, columns, width, height, offset_x, offset_y, index, fx, fy, inside):
    """Where one template row falls in the image: cell index, fractions, and 1 inside / 0 outside."""
    h0, h3, h6 = np.float32(h[0]), np.float32(h[3]), np.float32(h[6])
    a = np.float32(h[1] * y + h[2])
    b = np.float32(h[4] * y + h[5])
    c = np.float32(h[7] * y + h[8])
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


@nb.njit(**_JIT)
def _row_bilinear(image, width, columns, index, fx, fy, value, energy):
    """Bilinear samples of one row, and the sum of the squared weights of each."""
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


@nb.njit(**_JIT)
def _row_cubic(coefficients, width, columns, index, fx, fy, value, energy):
    """Cubic-spline samples of one row from B-spline coefficients, and the variance of each.

    The variance is that of the sample when the pixels (before the prefilter) are
    independent with variance 1: ``b^T R b`` with the four B-spline weights b and the
    autocorrelation R of the prefilter ``h[k] = sqrt(3) z^|k|``, ``z = sqrt(3) - 2``, which is
    ``3 z^|k| ((1 + z^2) / (1 - z^2) + |k|)``.
    """
    two, three, four, sixth = np.float32(2.0), np.float32(3.0), np.float32(4.0), np.float32(1.0 / 6.0)
    one = np.float32(1.0)
    r0, r1 = np.float32(3.464102), np.float32(-1.732051)
    r2, r3 = np.float32(0.679492), np.float32(-0.240474)
    down = np.uint32(width)
    u1, u2, u3 = np.uint32(1), np.uint32(2), np.uint32(3)
    c = coefficients
    for i in range(columns):
        k = np.uint32(index[i]) - down - u1
        f = fx[i]
        g = one - f
        a0, a3 = sixth * g * g * g, sixth * f * f * f
        a1 = sixth * (four - three * f * f * (two - f))
        a2 = one - a0 - a1 - a3
        e = r0 * (a0 * a0 + a1 * a1 + a2 * a2 + a3 * a3) + two * r1 * (a0 * a1 + a1 * a2 + a2 * a3)
        e += two * (r2 * (a0 * a2 + a1 * a3) + r3 * a0 * a3)
        f = fy[i]
        g = one - f
        b0, b3 = sixth * g * g * g, sixth * f * f * f
        b1 = sixth * (four - three * f * f * (two - f))
        b2 = one - b0 - b1 - b3
        d = r0 * (b0 * b0 + b1 * b1 + b2 * b2 + b3 * b3) + two * r1 * (b0 * b1 + b1 * b2 + b2 * b3)
        d += two * (r2 * (b0 * b2 + b1 * b3) + r3 * b0 * b3)
        total = b0 * (a0 * c[k] + a1 * c[k + u1] + a2 * c[k + u2] + a3 * c[k + u3])
        k += down
        total += b1 * (a0 * c[k] + a1 * c[k + u1] + a2 * c[k + u2] + a3 * c[k + u3])
        k += down
        total += b2 * (a0 * c[k] + a1 * c[k + u1] + a2 * c[k + u2] + a3 * c[k + u3])
        k += down
        total += b3 * (a0 * c[k] + a1 * c[k + u1] + a2 * c[k + u2] + a3 * c[k + u3])
        value[i] = total
        energy[i] = e * d


@nb.njit(**_JIT)
def _row_correlation(columns, value, template, inside, sums):
    """Unweighted sums for the correlation: n, I, T, I I, I T, T T."""
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


@nb.njit(**_JIT)
def _row_residual(columns, value, template, inside, gain, bias, cut, residual, weight):
    """Residual I - (gain T + bias) and its robust weight: 1 up to ``cut``, then (cut/r)^4."""
    a, b, one = np.float32(gain), np.float32(bias), np.float32(1.0)
    scale = np.float32(1.0 / (cut * cut))
    for i in range(columns):
        r = value[i] - a * template[i] - b
        z = one / max(one, r * r * scale)
        residual[i] = r
        weight[i] = inside[i] * z * z


@nb.njit(**_JIT)
def _row_gradient(columns, gain, share, before, here, after, tx, ty, scale, gx, gy):
    """Jacobian directions: (1 - share) gain grad T + share grad I of the warped image."""
    a = np.float32((1.0 - share) * gain)
    b = np.float32(0.5 * share * scale)
    for i in range(columns):
        gy[i] = a * ty[i] + b * (after[i] - before[i])
    for i in range(1, columns - 1):
        gx[i] = a * tx[i] + b * (here[i + 1] - here[i - 1])
    c = np.float32(gain)
    gx[0] = c * tx[0]
    gx[columns - 1] = c * tx[columns - 1]


@nb.njit(**_JIT)
def _row_matrix(columns, x, gx, gy, w, xx, xy, yy):
    """Sums over one row of w gx gx x^i, w gx gy x^i, w gy gy x^i, i = 0..4."""
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


@nb.njit(**_JIT)
def _row_vector(columns, x, g, r, t, w, out):
    """Sums over one row of w g {r, T, 1} x^i, i = 0..2, for one direction of the gradient."""
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


@nb.njit(**_JIT)
def _row_light(columns, r, t, w, energy, sums):
    """Sums of w {1, T, T T, r, T r, r r, energy}."""
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


@nb.njit(**_JIT)
def _assemble(xx, xy, yy, vx, vy, light, matrix, vector):
    """The 10 x 10 system from the moments; moments are indexed by the powers of y, then x."""
    f = _FIELDS
    for k in range(8):
        for m in range(k + 1):
            total = (
                f[k, 0] * f[m, 0] * xx[f[k, 2] + f[m, 2], f[k, 1] + f[m, 1]]
                + f[k, 0] * f[m, 3] * xy[f[k, 2] + f[m, 5], f[k, 1] + f[m, 4]]
                + f[k, 3] * f[m, 0] * xy[f[k, 5] + f[m, 2], f[k, 4] + f[m, 1]]
                + f[k, 3] * f[m, 3] * yy[f[k, 5] + f[m, 5], f[k, 4] + f[m, 4]]
            )
            matrix[k, m] = total
            matrix[m, k] = total
        for s in range(3):
            total = f[k, 0] * vx[f[k, 2], s, f[k, 1]] + f[k, 3] * vy[f[k, 5], s, f[k, 4]]
            if s == 0:
                vector[k] = total
            else:
                # The model is gain T + bias, so their columns carry a minus.
                matrix[k, 7 + s] = -total
                matrix[7 + s, k] = -total
    matrix[8, 8] = light[2]
    matrix[8, 9] = light[1]
    matrix[9, 8] = light[1]
    matrix[9, 9] = light[0]
    vector[8] = -light[4]
    vector[9] = -light[3]


@nb.njit(**_JIT)
def gauss_newton_sums(
    image,
    template,
    gradient_x,
    gradient_y,
    x,
    y,
    rows,
    offset,
    h,
    gain,
    bias,
    cut,
    share,
    unit,
    cubic,
    matrix,
    vector,
    stats,
    histogram,
):
    """One pass over the chosen rows of a template: everything a Gauss-Newton step needs.

    ``image`` (height, width; B-spline coefficients where ``cubic``), ``template``,
    ``gradient_x``, ``gradient_y`` (R, C) are float32; the gradients are per unit of ``x``, ``y``. ``rows`` are the rows to use.
    ``offset`` (2, R, C) or (2, 1, 1) is added to the warped position [px]; (2, 1, 1)
    means none. ``h`` (9,) maps column, row, 1 to the image. ``share`` is the part of
    the gradient that is taken from the warped image (0.5: ESM, 0: template only),
    ``unit`` the length of one unit of x in columns.

    Fills ``matrix`` (10, 10), ``vector`` (10,), ``histogram`` (256,) of |residual|
    in half grey levels over every fourth pixel, and ``stats`` (13,):
    weighted sums 1, T, TT, r, Tr, rr, energy; then unweighted n, I, T, II, IT, TT.
    """
    height, width = image.shape
    columns = template.shape[1]
    last = template.shape[0] - 1
    flat = image.reshape(-1)
    index = np.zeros(columns, np.int32)
    fx = np.zeros(columns, np.float32)
    fy = np.zeros(columns, np.float32)
    inside = np.zeros(columns, np.float32)
    spare = np.zeros(columns, np.float32)
    value = np.zeros((3, columns), np.float32)
    energy = np.zeros(columns, np.float32)
    residual = np.zeros(columns, np.float32)
    weight = np.zeros(columns, np.float32)
    gx = np.zeros(columns, np.float32)
    gy = np.zeros(columns, np.float32)
    nothing = np.zeros(columns, np.float32)
    xx, xy, yy = np.zeros((5, 5)), np.zeros((5, 5)), np.zeros((5, 5))
    vx, vy = np.zeros((3, 3, 3)), np.zeros((3, 3, 3))
    row_xx, row_xy, row_yy = np.zeros(5), np.zeros(5), np.zeros(5)
    row_v = np.zeros((3, 3))
    stats[:] = 0.0
    histogram[:] = 0
    moved = offset.shape[1] > 1
    for v in rows:
        if share > 0.0:
            if v == 0 or v == last:
                continue
            for k in (-1, 1):
                ox = offset[0, v + k] if moved else nothing
                oy = offset[1, v + k] if moved else nothing
                _row_positions(h, v + k, columns, width, height, ox, oy, index, fx, fy, spare)
                _row_bilinear(flat, width, columns, index, fx, fy, value[1 + k], energy)
        ox = offset[0, v] if moved else nothing
        oy = offset[1, v] if moved else nothing
        _row_positions(h, v, columns, width, height, ox, oy, index, fx, fy, inside)
        if cubic:
            _row_cubic(flat, width, columns, index, fx, fy, value[1], energy)
        else:
            _row_bilinear(flat, width, columns, index, fx, fy, value[1], energy)
        here = value[1]
        t = template[v]
        _row_correlation(columns, here, t, inside, stats[7:])
        _row_residual(columns, here, t, inside, gain, bias, cut, residual, weight)
        _row_gradient(
            columns, gain, share, value[0], here, value[2], gradient_x[v], gradient_y[v], unit, gx, gy
        )
        _row_light(columns, residual, t, weight, energy, stats)
        for i in range(v & 3, columns, 4):
            if inside[i] > 0:
                histogram[min(255, int(2.0 * abs(residual[i])))] += 1
        _row_matrix(columns, x, gx, gy, weight, row_xx, row_xy, row_yy)
        p = 1.0
        for j in range(5):
            for i in range(5):
                xx[j, i] += p * row_xx[i]
                xy[j, i] += p * row_xy[i]
                yy[j, i] += p * row_yy[i]
            p *= y[v]
        for axis in range(2):
            _row_vector(columns, x, gx if axis == 0 else gy, residual, t, weight, row_v)
            target = vx if axis == 0 else vy
            p = 1.0
            for j in range(3):
                for s in range(3):
                    for i in range(3):
                        target[j, s, i] += p * row_v[s, i]
                p *= y[v]
    _assemble(xx, xy, yy, vx, vy, stats, matrix, vector)


@nb.njit(**_JIT)
def solve_step(matrix, vector, active, damping, step):
    """Solve the damped system for the active unknowns by Cholesky; False if it is singular.

    ``step`` (10,) becomes ``-(M + damping diag M)^-1 v`` on the active unknowns, 0 elsewhere.
    """
    n = 0
    which = np.zeros(10, np.int64)
    for k in range(10):
        step[k] = 0.0
        if active[k]:
            which[n] = k
            n += 1
    lower = np.zeros((n, n))
    z = np.zeros(n)
    for i in range(n):
        for j in range(i + 1):
            total = matrix[which[i], which[j]]
            if i == j:
                diagonal = total * (1.0 + damping)
                total = diagonal
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i == j:
                if not total > 1e-10 * diagonal:
                    return False
                lower[i, i] = np.sqrt(total)
            else:
                lower[i, j] = total / lower[j, j]
        total = -vector[which[i]]
        for k in range(i):
            total -= lower[i, k] * z[k]
        z[i] = total / lower[i, i]
    for i in range(n - 1, -1, -1):
        total = z[i]
        for k in range(i + 1, n):
            total -= lower[k, i] * z[k]
        z[i] = total / lower[i, i]
        step[which[i]] = z[i]
    return True


@nb.njit(**_JIT)
def _exponential(step, result):
    """Homography of SL(3) that flows along the eight fields for unit time, by scaling and squaring."""
    a = np.zeros((3, 3))
    trace = (step[1] + step[5]) / 3.0
    a[0, 0], a[0, 1], a[0, 2] = step[1] - trace, step[2], step[0]
    a[1, 0], a[1, 1], a[1, 2] = step[4], step[5] - trace, step[3]
    a[2, 0], a[2, 1], a[2, 2] = step[6], step[7], -trace
    size = np.abs(a).max()
    halvings = 0
    while size > 0.25 and halvings < 40:
        size *= 0.5
        halvings += 1
    a /= 2.0**halvings
    result[:] = np.eye(3)
    term = np.eye(3)
    for k in range(1, 9):
        term = _product(term, a) / k
        result += term
    for _ in range(halvings):
        result[:] = _product(result, result)


@nb.njit(**_JIT)
def _product(a, b):
    c = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            c[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
    return c


@nb.njit(**_JIT)
def _spread(histogram):
    """Standard deviation of a normal law with the median of the |residual| histogram."""
    total = histogram.sum()
    if total == 0:
        return 1.0
    seen = 0
    for k in range(256):
        if 2 * (seen + histogram[k]) >= total:
            part = (0.5 * total - seen) / max(1, histogram[k])
            return max(0.3, 1.4826 * 0.5 * (k + part))
        seen += histogram[k]
    return 190.0


@nb.njit(**_JIT)
def _corner_shift(before, after, x_end, y_end):
    """Largest motion [px] of the four corners (+-x_end, +-y_end) between two homographies."""
    largest = 0.0
    for sx in (-1.0, 1.0):
        for sy in (-1.0, 1.0):
            x, y = sx * x_end, sy * y_end
            p = before[2, 0] * x + before[2, 1] * y + before[2, 2]
            q = after[2, 0] * x + after[2, 1] * y + after[2, 2]
            if not (p > 1e-9 and q > 1e-9):
                return np.inf
            dx = (before[0, 0] * x + before[0, 1] * y + before[0, 2]) / p
            dx -= (after[0, 0] * x + after[0, 1] * y + after[0, 2]) / q
            dy = (before[1, 0] * x + before[1, 1] * y + before[1, 2]) / p
            dy -= (after[1, 0] * x + after[1, 1] * y + after[1, 2]) / q
            largest = max(largest, dx * dx + dy * dy)
    return np.sqrt(largest)


@nb.njit(**_JIT)
def refine_level(
    image,
    template,
    gradient_x,
    gradient_y,
    x,
    y,
    rows,
    offset,
    h,
    light,
    active,
    share,
    unit,
    cubic,
    cut_factor,
    damping,
    passes,
    tolerance,
    matrix,
    stats,
):
    """Gauss-Newton passes on one level of the pyramid, in place on ``h`` and ``light``.

    ``h`` (3, 3) maps centred coordinates to image pixels of the level, ``light`` (3,)
    is gain, bias and spread of the residual. Other arguments as in
    :func:`gauss_newton_sums`. Returns the last motion of the corners [px], infinite
    when the system was singular or the template turned inside out.
    """
    vector = np.zeros(10)
    step = np.zeros(10)
    histogram = np.zeros(256, np.int64)
    growth = np.zeros((3, 3))
    to_centred = np.zeros((3, 3))
    to_centred[0, 0] = 1.0 / unit
    to_centred[1, 1] = 1.0 / unit
    to_centred[2, 2] = 1.0
    to_centred[0, 2] = x[0]
    to_centred[1, 2] = y[0]
    shift = np.inf
    for _ in range(passes):
        pixel_h = _product(h, to_centred).reshape(-1)
        gauss_newton_sums(
            image,
            template,
            gradient_x,
            gradient_y,
            x,
            y,
            rows,
            offset,
            pixel_h,
            light[0],
            light[1],
            cut_factor * light[2],
            share,
            unit,
            cubic,
            matrix,
            vector,
            stats,
            histogram,
        )
        light[2] = _spread(histogram)
        if not solve_step(matrix, vector, active, damping, step):
            return np.inf
        _exponential(step, growth)
        moved = _product(h, growth)
        shift = _corner_shift(h, moved, x[-1], y[-1])
        if not shift < 1e6:
            return np.inf
        h[:] = moved / moved[2, 2]
        light[0] = max(0.02, light[0] + step[8])
        light[1] += step[9]
        if shift < tolerance:
            break
    return shift
