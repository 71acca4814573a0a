"""Kernels of :mod:`.rbf`: sums of r^3 over centres at points, and grid nodes near the zero level set."""

from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel


@kernel(fastmath=True)
def cubic_values(points, centers, weights, poly, out):
    """``out = poly(x) + sum_i w_i |x - x_i|^3``; ``centers`` is (3, n) so that the loop vectorises.

    Computes in the type of its arguments, float32 on grids and float64 elsewhere.

    Parameters
    ----------
    points
        Points (m, 3).
    centers
        Centres in columns (3, n).
    weights
        Weights (n).
    poly
        Constant and linear coefficients (4).
    out
        Values (m), filled.
    """
    xs, ys, zs = centers[0], centers[1], centers[2]
    for p in range(points.shape[0]):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        total = poly[0] + poly[1] * x + poly[2] * y + poly[3] * z
        for i in range(xs.size):
            dx, dy, dz = x - xs[i], y - ys[i], z - zs[i]
            square = dx * dx + dy * dy + dz * dz
            total += weights[i] * square * math.sqrt(square)
        out[p] = total


@kernel(fastmath=True)
def cubic_gradients(points, centers, weights, poly, out):
    """Gradient of :func:`cubic_values` at points.

    Parameters
    ----------
    points, centers, weights, poly
        As of :func:`cubic_values`.
    out
        Gradients (m, 3), filled.
    """
    xs, ys, zs = centers[0], centers[1], centers[2]
    for p in range(points.shape[0]):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        gx, gy, gz = poly[1], poly[2], poly[3]
        for i in range(xs.size):
            dx, dy, dz = x - xs[i], y - ys[i], z - zs[i]
            factor = 3.0 * weights[i] * math.sqrt(dx * dx + dy * dy + dz * dz)
            gx += factor * dx
            gy += factor * dy
            gz += factor * dz
        out[p, 0], out[p, 1], out[p, 2] = gx, gy, gz


@kernel
def cubic_matrix(a, b, out):
    """``out[i, j] = |a_i - b_j|^3``; rows are points.

    Parameters
    ----------
    a, b
        Points (m, 3) and (n, 3).
    out
        Matrix (m, n), filled.
    """
    for i in range(a.shape[0]):
        for j in range(b.shape[0]):
            dx, dy, dz = a[i, 0] - b[j, 0], a[i, 1] - b[j, 1], a[i, 2] - b[j, 2]
            square = dx * dx + dy * dy + dz * dz
            out[i, j] = square * math.sqrt(square)


@kernel
def band_nodes(coarse, stride, band, values, wanted, nodes):
    """Trilinear interpolation at every fine node, and selection of requested nodes within a band around zero.

    Returns the number of rows of ``nodes`` that were set; ``values`` contains the
    interpolated values.

    Parameters
    ----------
    coarse
        Values at every ``stride``-th node.
    stride
        Ratio of the coarse to the fine step.
    band
        Half width of the band, in the unit of the values.
    values
        Interpolated values (x, y, z), filled.
    wanted
        Mask of the requested fine nodes (x, y, z).
    nodes
        Indices of the nodes in the band, filled from the first row.
    """
    count = 0
    nx, ny, nz = values.shape
    step = np.float32(1.0) / np.float32(stride)
    one = np.float32(1.0)
    for i in range(nx):
        a = min(i // stride, coarse.shape[0] - 2)
        fa = np.float32(i - a * stride) * step
        for j in range(ny):
            b = min(j // stride, coarse.shape[1] - 2)
            fb = np.float32(j - b * stride) * step
            for k in range(nz):
                c = min(k // stride, coarse.shape[2] - 2)
                fc = np.float32(k - c * stride) * step
                low = (one - fa) * ((one - fb) * coarse[a, b, c] + fb * coarse[a, b + 1, c]) + fa * (
                    (one - fb) * coarse[a + 1, b, c] + fb * coarse[a + 1, b + 1, c]
                )
                high = (one - fa) * ((one - fb) * coarse[a, b, c + 1] + fb * coarse[a, b + 1, c + 1]) + fa * (
                    (one - fb) * coarse[a + 1, b, c + 1] + fb * coarse[a + 1, b + 1, c + 1]
                )
                guess = (one - fc) * low + fc * high
                values[i, j, k] = guess
                if wanted[i, j, k] and abs(guess) < band:
                    nodes[count, 0], nodes[count, 1], nodes[count, 2] = i, j, k
                    count += 1
    return count
