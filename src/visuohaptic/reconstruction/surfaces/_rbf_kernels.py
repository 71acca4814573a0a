"""Kernel of :mod:`.rbf`: sums of r^3 over centres at points."""

from __future__ import annotations

import math

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
