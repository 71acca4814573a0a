"""Compiled kernels of pose refinement: projection through a lens, and Levenberg-Marquardt on six parameters.

For arrays of four points and six unknowns, NumPy takes a hundred times as long as a compiled loop. A small motion is
(x, y, z, rx, ry, rz): translation added, rotation about the axes of the camera, R' = exp([r]) R.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel
from .._solve_kernels import solve_step

_JIT = {"error_model": "numpy", "nogil": True}


@kernel(**_JIT)
def project_point(x, y, z, lens, pixel, derivative):
    """Pixel (2,) of one point in the camera frame, and its derivative (2, 3) with respect to the point [px/m].

    ``lens`` (12,): fx, fy, cx, cy, then OpenCV's k1, k2, p1, p2, k3, k4, k5, k6. False behind the camera.

    Parameters
    ----------
    x, y, z
        Point in the camera frame [m].
    lens
        fx, fy, cx, cy, then OpenCV's k1, k2, p1, p2, k3, k4, k5, k6, (12,).
    pixel, derivative
        Filled, (2,) and (2, 3).
    """
    if not z > 1e-9:
        return False
    a, b = x / z, y / z
    aa, ab, bb = a * a, a * b, b * b
    r = aa + bb
    k1, k2, p1, p2 = lens[4], lens[5], lens[6], lens[7]
    k3, k4, k5, k6 = lens[8], lens[9], lens[10], lens[11]
    above = 1.0 + r * (k1 + r * (k2 + r * k3))
    below = 1.0 + r * (k4 + r * (k5 + r * k6))
    radial = above / below
    # d radial / d r
    slope = (k1 + r * (2.0 * k2 + 3.0 * r * k3) - radial * (k4 + r * (2.0 * k5 + 3.0 * r * k6))) / below
    fx, fy = lens[0], lens[1]
    pixel[0] = fx * (a * radial + 2.0 * p1 * ab + p2 * (r + 2.0 * aa)) + lens[2]
    pixel[1] = fy * (b * radial + p1 * (r + 2.0 * bb) + 2.0 * p2 * ab) + lens[3]
    across = 2.0 * ab * slope + 2.0 * (p1 * a + p2 * b)
    ua = fx * (radial + 2.0 * aa * slope + 2.0 * p1 * b + 6.0 * p2 * a)
    vb = fy * (radial + 2.0 * bb * slope + 6.0 * p1 * b + 2.0 * p2 * a)
    ub, va = fx * across, fy * across
    derivative[0, 0], derivative[0, 1], derivative[0, 2] = ua / z, ub / z, -(ua * a + ub * b) / z
    derivative[1, 0], derivative[1, 1], derivative[1, 2] = va / z, vb / z, -(va * a + vb * b) / z
    return True


@kernel(**_JIT)
def _column_product(matrix, j, k):
    return matrix[0, j] * matrix[0, k] + matrix[1, j] * matrix[1, k] + matrix[2, j] * matrix[2, k]


@kernel(**_JIT)
def turn(rotation, rx, ry, rz):
    """``exp([r]) R``, re-orthonormalised: many small steps must not leave the group.

    Parameters
    ----------
    rotation
        R, changed in place, (3, 3).
    rx, ry, rz
        Rotation vector r [rad].
    """
    angle = np.sqrt(rx * rx + ry * ry + rz * rz)
    sine, versine = 1.0, 0.5
    if angle > 1e-8:
        sine, versine = np.sin(angle) / angle, (1.0 - np.cos(angle)) / (angle * angle)
    result = np.empty((3, 3))
    for k in range(3):
        a, b, c = rotation[0, k], rotation[1, k], rotation[2, k]
        # r x v, and r x (r x v).
        u, v, w = ry * c - rz * b, rz * a - rx * c, rx * b - ry * a
        result[0, k] = a + sine * u + versine * (ry * w - rz * v)
        result[1, k] = b + sine * v + versine * (rz * u - rx * w)
        result[2, k] = c + sine * w + versine * (rx * v - ry * u)
    for k in range(2):
        along = 0.0 if k == 0 else _column_product(result, 0, 1)
        for i in range(3):
            result[i, k] -= along * result[i, 0]
        length = np.sqrt(_column_product(result, k, k))
        for i in range(3):
            result[i, k] /= length
    result[0, 2] = result[1, 0] * result[2, 1] - result[2, 0] * result[1, 1]
    result[1, 2] = result[2, 0] * result[0, 1] - result[0, 0] * result[2, 1]
    result[2, 2] = result[0, 0] * result[1, 1] - result[1, 0] * result[0, 1]
    return result


@kernel(**_JIT)
def _residual(points, corners, whiten, lens, rotation, translation, error, jacobian):
    """Whitened residual (2n,) and Jacobian (2n, 6); its squared length, infinite behind the camera."""
    n = len(points)
    pixel, by_point = np.zeros(2), np.zeros((2, 3))
    plain, slope = np.zeros(2 * n), np.zeros((2 * n, 6))
    for i in range(n):
        p = points[i]
        tx = rotation[0, 0] * p[0] + rotation[0, 1] * p[1] + rotation[0, 2] * p[2]
        ty = rotation[1, 0] * p[0] + rotation[1, 1] * p[1] + rotation[1, 2] * p[2]
        tz = rotation[2, 0] * p[0] + rotation[2, 1] * p[1] + rotation[2, 2] * p[2]
        if not project_point(
            tx + translation[0], ty + translation[1], tz + translation[2], lens, pixel, by_point
        ):
            return np.inf
        for a in range(2):
            d = by_point[a]
            k = 2 * i + a
            plain[k] = pixel[a] - corners[i, a]
            slope[k, 0], slope[k, 1], slope[k, 2] = d[0], d[1], d[2]
            # d(w x t) / dw = -[t]x
            slope[k, 3] = d[2] * ty - d[1] * tz
            slope[k, 4] = d[0] * tz - d[2] * tx
            slope[k, 5] = d[1] * tx - d[0] * ty
    total = 0.0
    for i in range(2 * n):
        value = 0.0
        for k in range(2 * n):
            value += whiten[i, k] * plain[k]
        error[i] = value
        total += value * value
        for j in range(6):
            value = 0.0
            for k in range(2 * n):
                value += whiten[i, k] * slope[k, j]
            jacobian[i, j] = value
    return total


@kernel(**_JIT)
def _normal_equations(error, jacobian, gradient, normal):
    """J^T e into ``gradient`` (6,) and J^T J into ``normal`` (6, 6)."""
    for i in range(6):
        gradient[i] = 0.0
        for k in range(len(error)):
            gradient[i] += jacobian[k, i] * error[k]
        for j in range(6):
            normal[i, j] = 0.0
            for k in range(len(error)):
                normal[i, j] += jacobian[k, i] * jacobian[k, j]


@kernel(**_JIT)
def refine_pose(points, corners, whiten, lens, rotation, translation, normal):
    """Refine the pose of points (n, 3) seen at ``corners`` (n, 2); updates ``rotation`` and ``translation`` in place.

    ``whiten`` (2n, 2n) makes the residuals independent with variance 1. Fills ``normal`` (6, 6), the
    information of the pose. Returns chi^2, infinite if the points end up behind the camera.

    Parameters
    ----------
    points
        Points in the body frame [m], (n, 3).
    corners
        Their observed pixels [px], (n, 2).
    whiten
        Makes the residuals independent with variance 1, (2n, 2n).
    lens
        As in :func:`project_point`.
    rotation, translation
        Start and result, (3, 3) and (3,) [m].
    normal
        Filled with the information of the pose, (6, 6).
    """
    size = 2 * len(points)
    error, jacobian = np.zeros(size), np.zeros((size, 6))
    next_error, next_jacobian = np.zeros(size), np.zeros((size, 6))
    gradient, step, shifted = np.zeros(6), np.zeros(6), np.zeros(3)
    active = np.ones(6, np.bool_)
    chi2 = _residual(points, corners, whiten, lens, rotation, translation, error, jacobian)
    if not np.isfinite(chi2):
        return np.inf
    damping = 1e-6
    for _ in range(20):
        _normal_equations(error, jacobian, gradient, normal)
        done = True
        for _ in range(8):
            if solve_step(normal, gradient, active, damping, step):
                turned = turn(rotation, step[3], step[4], step[5])
                for i in range(3):
                    shifted[i] = translation[i] + step[i]
                found = _residual(points, corners, whiten, lens, turned, shifted, next_error, next_jacobian)
                if found <= chi2 * (1 + 1e-12):
                    for i in range(3):
                        translation[i] = shifted[i]
                        for j in range(3):
                            rotation[i, j] = turned[i, j]
                    error, next_error = next_error, error
                    jacobian, next_jacobian = next_jacobian, jacobian
                    chi2, damping, done = found, max(damping / 10, 1e-9), False
                    break
            damping *= 10
        length = 0.0
        for i in range(6):
            for j in range(6):
                length += step[i] * normal[i, j] * step[j]
        # In units of the parameters' standard deviations: a thousandth of a sigma is sufficient.
        if done or length < 1e-6:
            break
    _normal_equations(error, jacobian, gradient, normal)
    return chi2
