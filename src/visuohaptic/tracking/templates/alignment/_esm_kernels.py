"""Compiled kernels of the planar tracker: the Gauss-Newton sums, and passes on one level of the pyramid.

A template has R rows and C columns. ``x``, ``y`` are its centred coordinates in
units of half its longer side, so that both lie in about [-1, 1] and the eight
unknowns of a small homography have similar magnitudes. The eight velocity fields are

====  =========  ====  =========  ====  ==============
0     (1, 0)     3     (0, 1)     6     (-x^2, -x y)
1     (x, 0)     4     (0, x)     7     (-x y, -y^2)
2     (y, 0)     5     (0, y)
====  =========  ====  =========  ====  ==============

so that every product of two columns of the Jacobian is gx gx, gx gy or gy gy times
a monomial of degree at most four. A row therefore needs only sums over powers of
x (vectorised by the compiler); powers of y are applied once
per row, and the 10 x 10 system is assembled once per pass.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

import numpy as np

from ....core.kernels import kernel
from ..._solve_kernels import FAST, solve_step
from ._esm_row_kernels import (
    row_correlation,
    row_gradient,
    row_light,
    row_matrix,
    row_residual,
    row_vector,
)
from ._sample_kernels import sample_rows

# Field k: coefficient and powers of x and y that multiply gx, then those that multiply gy.
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


@kernel(**FAST)
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
                # The model is gain T + bias, so their columns have a minus sign.
                matrix[k, 7 + s] = -total
                matrix[7 + s, k] = -total
    matrix[8, 8] = light[2]
    matrix[8, 9] = light[1]
    matrix[9, 8] = light[1]
    matrix[9, 9] = light[0]
    vector[8] = -light[4]
    vector[9] = -light[3]


@kernel(**FAST)
def gauss_newton_sums(
    value, inside, energy, template, gradient_x, gradient_y, x, y, rows, gain, bias, cut, margin, fraction, unit,
    matrix, vector, stats, histogram,
):  # fmt: skip
    """All sums of a Gauss-Newton step over the selected rows of a template.

    Parameters
    ----------
    value, inside, energy
        Samples of the image, whether they are in it, and their mean variance, from :func:`sample_rows`.
    template, gradient_x, gradient_y
        (R, C) float32; the gradients are per unit of ``x``, ``y``.
    x, y
        Centred coordinates of columns (C,) and rows (R,).
    rows
        Rows to use; all of them are sampled, and their neighbours where ``fraction`` is not 0.
    gain, bias
        Image = gain template + bias.
    cut, margin
        Weights of the pixels, see :func:`row_residual`.
    fraction
        Fraction of the gradient taken from the warped image (0.5: ESM, 0: template only).
    unit
        Length of one unit of x in columns.
    matrix, vector
        Filled, (10, 10) and (10,).
    stats
        Filled with weighted sums 1, T, TT, r, Tr, rr, energy; then unweighted n, I, T, II, IT, TT, (13,).
    histogram
        Filled with counts of the absolute residual in half grey levels over every fourth pixel, (256,).
    """
    columns = template.shape[1]
    last = template.shape[0] - 1
    residual = np.zeros(columns, np.float32)
    weight = np.zeros(columns, np.float32)
    gx = np.zeros(columns, np.float32)
    gy = np.zeros(columns, np.float32)
    xx, xy, yy = np.zeros((5, 5)), np.zeros((5, 5)), np.zeros((5, 5))
    vx, vy = np.zeros((3, 3, 3)), np.zeros((3, 3, 3))
    row_xx, row_xy, row_yy = np.zeros(5), np.zeros(5), np.zeros(5)
    row_v = np.zeros((3, 3))
    stats[:] = 0.0
    histogram[:] = 0
    for v in rows:
        if fraction > 0.0 and (v == 0 or v == last):
            continue
        before, after = (v - 1, v + 1) if fraction > 0.0 else (v, v)
        here, seen, t = value[v], inside[v], template[v]
        row_correlation(columns, here, t, seen, stats[7:])
        row_residual(columns, here, t, seen, gain, bias, cut, margin, residual, weight)
        row_gradient(
            columns, gain, fraction, value[before], here, value[after], gradient_x[v], gradient_y[v], unit, gx, gy
        )  # fmt: skip
        row_light(columns, residual, t, weight, stats)
        for i in range(v & 3, columns, 4):
            if seen[i] > 0:
                histogram[min(255, int(2.0 * abs(residual[i])))] += 1
        row_matrix(columns, x, gx, gy, weight, row_xx, row_xy, row_yy)
        p = 1.0
        for j in range(5):
            for i in range(5):
                xx[j, i] += p * row_xx[i]
                xy[j, i] += p * row_xy[i]
                yy[j, i] += p * row_yy[i]
            p *= y[v]
        for axis in range(2):
            row_vector(columns, x, gx if axis == 0 else gy, residual, t, weight, row_v)
            target = vx if axis == 0 else vy
            p = 1.0
            for j in range(3):
                for s in range(3):
                    for i in range(3):
                        target[j, s, i] += p * row_v[s, i]
                p *= y[v]
    stats[6] = energy * stats[0]
    _assemble(xx, xy, yy, vx, vy, stats, matrix, vector)


@kernel(**FAST)
def exponential(step, result):
    """Homography of SL(3) that flows along the eight fields for unit time, by scaling and squaring.

    Parameters
    ----------
    step
        The eight parameters, (8,) or longer.
    result
        Filled, (3, 3).
    """
    a = np.zeros((3, 3))
    trace = (step[1] + step[5]) / 3.0
    a[0, 0], a[0, 1], a[0, 2] = step[1] - trace, step[2], step[0]
    a[1, 0], a[1, 1], a[1, 2] = step[4], step[5] - trace, step[3]
    a[2, 0], a[2, 1], a[2, 2] = step[6], step[7], -trace
    size = 0.0
    for k in range(9):
        size = max(size, abs(a[k // 3, k % 3]))
    halvings = 0
    while size > 0.25 and halvings < 40:
        size *= 0.5
        halvings += 1
    term, spare = np.zeros((3, 3)), np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            result[i, j] = term[i, j] = 1.0 if i == j else 0.0
    scale = 0.5**halvings
    for k in range(1, 9):
        _product(term, a, scale / k, spare)
        term, spare = spare, term
        for i in range(3):
            for j in range(3):
                result[i, j] += term[i, j]
    for _ in range(halvings):
        _product(result, result, 1.0, spare)
        for i in range(3):
            for j in range(3):
                result[i, j] = spare[i, j]


@kernel(**FAST)
def _product(a, b, scale, out):
    """out = scale a b for (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = scale * (a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j])


@kernel(**FAST)
def _spread(histogram, fraction, sigmas):
    """Standard deviation of a normal distribution with ``fraction`` within ``sigmas``, from the |residual| histogram."""
    total = 0
    for k in range(256):
        total += histogram[k]
    if total == 0:
        return 1.0
    seen = 0
    for k in range(256):
        if seen + histogram[k] >= fraction * total:
            part = (fraction * total - seen) / max(1, histogram[k])
            return max(0.3, 0.5 * (k + part) / sigmas)
        seen += histogram[k]
    return 190.0


@kernel(**FAST)
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


@kernel(**FAST)
def refine_level(
    image, template, gradient_x, gradient_y, x, y, rows, offset, h, light, fraction, unit, cubic, cut, damping,
    passes, tolerance, samples, matrix, stats,
):  # fmt: skip
    """Gauss-Newton passes on one level of the pyramid, in place on ``h`` and ``light``.

    Returns the last motion of the corners [px], infinite
    if the system was singular or the template was turned inside out.

    Parameters
    ----------
    image, offset, cubic
        As in :func:`sample_rows`.
    template, gradient_x, gradient_y, x, y, rows, fraction, unit, matrix, stats
        As in :func:`gauss_newton_sums`.
    h
        Centred coordinates to image pixels of the level, changed in place; and filled with those before the last
        step, (2, 3, 3).
    light
        Gain, bias, standard deviation of the residual, that of noise alone, and the fraction of the
        squared residual that remains after the last step; changed in place, (5,).
    cut
        Number of standard deviations beyond which residuals are down-weighted, and ``margin`` of
        :func:`gauss_newton_sums`, (2,).
    damping
        Relative to the diagonal.
    passes
        Maximum number of passes.
    tolerance
        Iteration stops when a pass moves the corners by less [px].
    samples
        Filled with ``value`` and ``inside`` of :func:`sample_rows` in the last pass, (2, R, C).
    """
    vector = np.zeros(10)
    step = np.zeros(10)
    active = np.ones(10, np.bool_)
    histogram = np.zeros(256, np.int64)
    growth, moved, to_pixels = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    to_centred = np.zeros((3, 3))
    to_centred[0, 0] = 1.0 / unit
    to_centred[1, 1] = 1.0 / unit
    to_centred[2, 2] = 1.0
    to_centred[0, 2] = x[0]
    to_centred[1, 2] = y[0]
    shift = np.inf
    here, sampled, value, inside = h[0], h[1], samples[0], samples[1]
    for _ in range(passes):
        for i in range(3):
            for j in range(3):
                sampled[i, j] = here[i, j]
        _product(here, to_centred, 1.0, to_pixels)
        energy = sample_rows(image, to_pixels, offset, rows, cubic, value, inside)
        gauss_newton_sums(
            value, inside, energy, template, gradient_x, gradient_y, x, y, rows, light[0], light[1],
            cut[0] * light[2], cut[1], fraction, unit, matrix, vector, stats, histogram,
        )  # fmt: skip
        light[2] = _spread(histogram, 0.5, 0.67449)
        # Residuals are concentrated at edges: the smoothest quarter of the pixels gives the noise alone.
        light[3] = _spread(histogram, 0.25, 0.31864)
        if not solve_step(matrix, vector, active, damping, step):
            return np.inf
        # The reduction of the residual by the step, including illumination, is not noise (linear, as the step itself).
        taken = 0.0
        for k in range(10):
            taken -= vector[k] * step[k]
        light[4] = max(0.0, 1.0 - taken / max(stats[5], 1e-9))
        light[3] *= np.sqrt(light[4])
        exponential(step, growth)
        _product(here, growth, 1.0, moved)
        shift = _corner_shift(here, moved, x[-1], y[-1])
        if not shift < 1e6:
            return np.inf
        for i in range(3):
            for j in range(3):
                here[i, j] = moved[i, j] / moved[2, 2]
        light[0] = max(0.02, light[0] + step[8])
        light[1] += step[9]
        if shift < tolerance:
            break
    return shift
