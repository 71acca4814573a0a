"""Gauss-Newton on the pixels of a rigid body, as one compiled loop."""

# mypy: allow-untyped-defs, allow-untyped-calls

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel
from ...tracking._solve_kernels import median, solve_step
from ...tracking.pose._pose_kernels import project_point, turn


@kernel(error_model="numpy", nogil=True)
def fit_motion(
    body,
    pixels,
    sigma,
    pivot,
    view,
    origin,
    lens,
    gate_sigmas,
    least,
    active,
    rotation,
    shift,
    distance,
    kept,
):
    """Fit the motion of a body to the pixels of its points; in place on ``rotation`` and ``shift``.

    ``body`` (n, 3) frame F [m] at the start, ``pixels`` (n, 2) with ``sigma`` (n,) per axis; the body
    rotates about ``pivot`` (3,), then shifts. ``view`` (3, 3) and ``origin`` (3,) map F to the camera, ``lens``
    is that of :func:`visuohaptic.tracking.pose._pose_kernels.project_point`. ``active`` (6,) of (rotation
    vector, shift) are free. Points have Tukey weights, zero beyond ``gate_sigmas``, of which at least
    ``least`` must be inside.

    Fills ``distance`` (n,) in sigmas and ``kept`` (6, 6), the information of the points inside.
    Returns the scale of the residuals, NaN if there is no fit.

    Parameters
    ----------
    body
        Points of the body at the start, frame F [m], (n, 3).
    pixels, sigma
        Their image positions, (n, 2), and the standard deviation per axis, (n,) [px].
    pivot
        The body rotates about this point, then shifts [m], (3,).
    view, origin
        Rotation (3, 3) and translation (3,) from F to the camera.
    lens
        As in :func:`visuohaptic.tracking.pose._pose_kernels.project_point`.
    gate_sigmas
        Points beyond this number of standard deviations have zero weight.
    least
        Minimum number of points inside.
    active
        Mask of the free components of (rotation vector, shift), (6,).
    rotation, shift
        Initial guess and result, (3, 3) and (3,) [m].
    distance
        Filled with the residuals [standard deviations], (n,).
    kept
        Filled with the information of the points inside, (6, 6).
    """
    n = len(body)
    if n < least:
        return np.nan
    pixel, by_point, in_foam = np.zeros(2), np.zeros((2, 3)), np.zeros((2, 3))
    residual, jacobian, work = np.zeros((n, 2)), np.zeros((n, 2, 6)), np.zeros(n)
    information, gradient, step = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    free = 0
    for k in range(6):
        free += active[k]
    scale = 1.0
    for iteration in range(8):
        for i in range(n):
            a, b, c = body[i, 0] - pivot[0], body[i, 1] - pivot[1], body[i, 2] - pivot[2]
            # Lever arm from the rotated pivot, then the point in F and in the camera's frame.
            p = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c
            q = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c
            r = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c
            x, y, z = p + pivot[0] + shift[0], q + pivot[1] + shift[1], r + pivot[2] + shift[2]
            u = view[0, 0] * x + view[0, 1] * y + view[0, 2] * z + origin[0]
            v = view[1, 0] * x + view[1, 1] * y + view[1, 2] * z + origin[1]
            w = view[2, 0] * x + view[2, 1] * y + view[2, 2] * z + origin[2]
            if not project_point(u, v, w, lens, pixel, by_point):
                return np.nan
            one = 1.0 / sigma[i]
            squared = 0.0
            for k in range(2):
                residual[i, k] = (pixel[k] - pixels[i, k]) * one
                squared += residual[i, k] ** 2
                for m in range(3):
                    in_foam[k, m] = one * (
                        by_point[k, 0] * view[0, m]
                        + by_point[k, 1] * view[1, m]
                        + by_point[k, 2] * view[2, m]
                    )
                d = in_foam[k]
                # d(w x a) / dw = -[a]x
                jacobian[i, k, 0] = d[2] * q - d[1] * r
                jacobian[i, k, 1] = d[0] * r - d[2] * p
                jacobian[i, k, 2] = d[1] * p - d[0] * q
                jacobian[i, k, 3], jacobian[i, k, 4], jacobian[i, k, 5] = d[0], d[1], d[2]
            distance[i] = np.sqrt(squared)
            if not np.isfinite(squared):
                return np.nan
        # Wide at first, so that the points are found from an initial guess some pixels off.
        scale = max(1.0, median(distance, n, work) / 1.177) if iteration < 5 else max(1.0, scale)
        gate = gate_sigmas * scale
        information[:], gradient[:] = 0.0, 0.0
        count = 0
        for i in range(n):
            if not distance[i] < gate:
                continue
            count += 1
            weight = (1.0 - (distance[i] / gate) ** 2) ** 2
            for k in range(2):
                for a in range(6):
                    slope = weight * jacobian[i, k, a]
                    gradient[a] += slope * residual[i, k]
                    for b in range(a + 1):
                        information[a, b] += slope * jacobian[i, k, b]
        if count < least:
            return np.nan
        trace = 0.0
        for a in range(6):
            trace += information[a, a] if active[a] else 0.0
            for b in range(a):
                information[b, a] = information[a, b]
        for a in range(6):
            # Slight damping: a few nearly collinear points leave directions undetermined.
            information[a, a] += 1e-9 * trace
        if not solve_step(information, gradient, active, 0.0, step):
            return np.nan
        largest = 0.0
        for k in range(6):
            largest = max(largest, abs(step[k]))
        if not largest < 1.0:
            return np.nan
        turned = turn(rotation, step[0], step[1], step[2])
        for k in range(3):
            shift[k] += step[3 + k]
            for m in range(3):
                rotation[k, m] = turned[k, m]
        # A hundredth of the information of a good image.
        if largest < 2e-6:
            break
    # A wide scale is used for convergence only; in the end points agree within their own noise.
    scale = min(scale, 2.0)
    kept[:] = 0.0
    for i in range(n):
        if distance[i] < gate_sigmas * scale:
            for k in range(2):
                for a in range(6):
                    for b in range(6):
                        kept[a, b] += jacobian[i, k, a] * jacobian[i, k, b]
    return scale
