"""Compiled kernels that sample an image at the warped pixels of a template.

Each loop is simple enough for the compiler to vectorise. Unsigned indices
are intentional: signed ones would be checked for wrap-around, which prevents vectorisation.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic

from ....core.kernels import kernel
from ..._solve_kernels import FAST


@kernel(**FAST)
def row_positions(h, y, columns, width, height, offset_x, offset_y, index, fx, fy, inside):
    """Image positions of one template row: cell index, fractions, and 1 inside / 0 outside.

    The 4 x 4 pixels around every cell are pixels of the image, whatever the positions are.

    Parameters
    ----------
    h
        Column, row, 1 to the image, (3, 3).
    y
        The row.
    columns
        Number of columns.
    width, height
        Size of the image, at least 4 [px].
    offset_x, offset_y
        Added to the positions [px], (C,).
    index, fx, fy, inside
        Filled, (C,).
    """
    h0, h3, h6 = np.float32(h[0, 0]), np.float32(h[1, 0]), np.float32(h[2, 0])
    a = np.float32(h[0, 1] * y + h[0, 2])
    b = np.float32(h[1, 1] * y + h[1, 2])
    c = np.float32(h[2, 1] * y + h[2, 2])
    one, least = np.float32(1.0), np.float32(1e-9)
    # One pixel of margin on the low side and two on the high side, for the cubic kernel.
    x_max, y_max = np.float32(width - 2.001), np.float32(height - 2.001)
    for i in range(columns):
        x = np.float32(i)
        depth = h6 * x + c
        q = one / max(depth, least)
        px = (h0 * x + a) * q + offset_x[i]
        py = (h3 * x + b) * q + offset_y[i]
        qx = min(max(px, one), x_max)
        qy = min(max(py, one), y_max)
        inside[i] = one if (qx == px) & (qy == py) & (depth >= least) else np.float32(0.0)
        # Whole numbers hold what rounding and positions that are no number would pass.
        ix = min(max(np.int32(qx), np.int32(1)), np.int32(width - 3))
        iy = min(max(np.int32(qy), np.int32(1)), np.int32(height - 3))
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


@intrinsic
def _vector_sum(context: Any, coefficients: Any, first: Any, width: Any, across: Any, down: Any) -> Any:
    """Sum of 4 x 4 neighbours times their weights, a row of four by one instruction: numba's compiler vectorises loops alone.

    Parameters
    ----------
    context
        Numba's.
    coefficients
        Image, row by row, (height * width,) float32.
    first
        Index of the first neighbour.
    width
        Of the image [px].
    across, down
        Four weights each.
    """
    four, index = ir.VectorType(ir.FloatType(), 4), ir.IntType(32)
    unknown = ir.Constant(four, ir.Undefined)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        image, place, width, across, down = arguments
        data = context.make_array(signature.args[0])(context, builder, image).data
        weights, total = unknown, None
        for k in range(4):
            row = builder.load(builder.bitcast(builder.gep(data, [place]), four.as_pointer()), align=4)
            weight = builder.insert_element(unknown, builder.extract_value(down, k), index(0))
            weight = builder.shuffle_vector(weight, unknown, ir.Constant(ir.VectorType(index, 4), [0] * 4))
            row = builder.fmul(row, weight, flags=("fast",))
            total = row if total is None else builder.fadd(total, row, flags=("fast",))
            weights = builder.insert_element(weights, builder.extract_value(across, k), index(k))
            place = builder.add(place, width)
        total = builder.fmul(total, weights, flags=("fast",))
        a, b, c, d = (builder.extract_element(total, index(k)) for k in range(4))
        left, right = builder.fadd(a, c, flags=("fast",)), builder.fadd(b, d, flags=("fast",))
        return builder.fadd(left, right, flags=("fast",))

    return types.float32(coefficients, types.uint64, types.uint64, across, down), generate


def _plain_sum(coefficients, first, width, across, down):
    """The sum of :func:`_vector_sum` in Python."""
    places = [int(first) + k * int(width) for k in range(4)]
    return sum(down[k] * np.dot(across, coefficients[place : place + 4]) for k, place in enumerate(places))


#: Without its compiler (``NUMBA_DISABLE_JIT``), numba's instructions cannot be called.
_weighted: Any = _plain_sum if config.DISABLE_JIT else _vector_sum


@kernel(**FAST)
def row_cubic(coefficients, width, columns, index, fx, fy, across, down, value):
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
    across, down
        Scratch for the weights along x and y, (4, C).
    value
        Filled, (C,).
    """
    _spline_weights(fx, across)
    _spline_weights(fy, down)
    beyond = np.uint64(width)
    for i in range(columns):
        first = np.uint64(index[i]) - beyond - np.uint64(1)
        a = across[0, i], across[1, i], across[2, i], across[3, i]
        b = down[0, i], down[1, i], down[2, i], down[3, i]
        value[i] = _weighted(coefficients, first, beyond, a, b)


@kernel(**FAST)
def _spline_weights(fractions, weights):
    """Weights of the four neighbours of each place, a fraction of a pixel beyond the second, (4, C)."""
    one, two, three = np.float32(1.0), np.float32(2.0), np.float32(3.0)
    four, sixth = np.float32(4.0), np.float32(1.0 / 6.0)
    for i in range(len(fractions)):
        f = fractions[i]
        g = one - f
        a, d = sixth * g * g * g, sixth * f * f * f
        b = sixth * (four - three * f * f * (two - f))
        weights[0, i], weights[1, i], weights[2, i], weights[3, i] = a, b, one - a - b - d, d


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
    across, down = np.zeros((4, columns), np.float32), np.zeros((4, columns), np.float32)
    moved = offset.shape[1] > 1
    energy, count = 0.0, 0
    for k in range(len(rows)):
        v = rows[k]
        ox = offset[0, v] if moved else nothing
        oy = offset[1, v] if moved else nothing
        row_positions(h, v, columns, width, height, ox, oy, index, fx, fy, inside[v])
        if cubic:
            row_cubic(flat, width, columns, index, fx, fy, across, down, value[v])
        else:
            row_bilinear(flat, width, columns, index, fx, fy, value[v])
        # A third of the rows tells the mean: their fractions differ unless all are the same.
        if k % 3 == 0:
            energy += row_energy(columns, fx, fy, cubic)
            count += 1
    return energy / max(count, 1)
