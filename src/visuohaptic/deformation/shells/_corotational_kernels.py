"""Corotational shell triangle: forces and consistent tangent (:mod:`.corotational`).

Notation of Felippa and Haugen 2005, "A unified formulation of small-strain corotational finite
elements": P projects a motion onto its deformational part, G gives the spin of the element's frame, H converts
a spin into the rate of a rotation vector.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel
from ._shell_kernels import rotate_blocks, triangle_frame


@kernel
def rotation_vector(r: np.ndarray, out: np.ndarray) -> None:
    """Rotation vector of a rotation matrix; exact for small rotations, angle below pi."""
    w0, w1, w2 = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    sine = 0.5 * np.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
    cosine = 0.5 * (r[0, 0] + r[1, 1] + r[2, 2] - 1.0)
    angle = np.arctan2(sine, cosine)
    factor = 0.5 * (1.0 + angle * angle / 6.0) if sine < 1e-6 else 0.5 * angle / sine
    out[0], out[1], out[2] = factor * w0, factor * w1, factor * w2


@kernel
def rotation_vectors(rotations: np.ndarray, out: np.ndarray) -> None:
    """:func:`rotation_vector` of each of (n, 3, 3) matrices into the rows of ``out``."""
    for k in range(rotations.shape[0]):
        rotation_vector(rotations[k], out[k])


@kernel
def rotate_nodes(rotations: np.ndarray, spins: np.ndarray) -> np.ndarray:
    """exp(spin) R for each node."""
    out = np.empty((rotations.shape[0], 3, 3))
    e = np.empty((3, 3))
    for v in range(rotations.shape[0]):
        x, y, z = spins[v, 0], spins[v, 1], spins[v, 2]
        square = x * x + y * y + z * z
        angle = np.sqrt(square)
        if angle < 1e-4:
            a, b = 1.0 - square / 6.0, 0.5 - square / 24.0
        else:
            a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / square
        e[0, 0], e[0, 1], e[0, 2] = 1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
        e[1, 0], e[1, 1], e[1, 2] = b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x
        e[2, 0], e[2, 1], e[2, 2] = b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)
        for i in range(3):
            for j in range(3):
                out[v, i, j] = (
                    e[i, 0] * rotations[v, 0, j] + e[i, 1] * rotations[v, 1, j] + e[i, 2] * rotations[v, 2, j]
                )
    return out


@kernel
def _subtract_half_skew(v: np.ndarray, out: np.ndarray) -> None:
    """out -= [v]x / 2."""
    out[0, 1] += 0.5 * v[2]
    out[0, 2] -= 0.5 * v[1]
    out[1, 0] -= 0.5 * v[2]
    out[1, 2] += 0.5 * v[0]
    out[2, 0] += 0.5 * v[1]
    out[2, 1] -= 0.5 * v[0]


@kernel
def _spin_to_rate(
    theta: np.ndarray, moment: np.ndarray, h: np.ndarray, m: np.ndarray, twice: np.ndarray, inner: np.ndarray
) -> None:
    """H(theta), and M = d(H^T moment)/d(spin) at a fixed moment; ``twice`` and ``inner`` (3, 3) are scratch."""
    t0, t1, t2 = theta[0], theta[1], theta[2]
    square = t0 * t0 + t1 * t1 + t2 * t2
    if square < 1e-4:
        eta = 1.0 / 12 + square / 720
        mu = 1.0 / 360 + square / 7560
    else:
        angle = np.sqrt(square)
        half = 0.5 * angle
        eta = (1.0 - half * np.cos(half) / np.sin(half)) / square
        mu = (square + 4 * np.cos(angle) + angle * np.sin(angle) - 4) / (
            4 * square * square * np.sin(half) ** 2
        )
    for i in range(3):
        for j in range(3):
            twice[i, j] = theta[i] * theta[j] - (square if i == j else 0.0)
            h[i, j] = (1.0 if i == j else 0.0) + eta * twice[i, j]
    _subtract_half_skew(theta, h)
    dot = t0 * moment[0] + t1 * moment[1] + t2 * moment[2]
    for i in range(3):
        along = twice[i, 0] * moment[0] + twice[i, 1] * moment[1] + twice[i, 2] * moment[2]
        for j in range(3):
            inner[i, j] = (
                eta * ((dot if i == j else 0.0) + theta[i] * moment[j] - 2 * moment[i] * theta[j])
                + mu * along * theta[j]
            )
    _subtract_half_skew(moment, inner)
    for i in range(3):
        for j in range(3):
            m[i, j] = inner[i, 0] * h[0, j] + inner[i, 1] * h[1, j] + inner[i, 2] * h[2, j]


@kernel(fastmath={"reassoc", "contract", "nsz"})
def forces_and_tangent(
    points: np.ndarray,
    rotations: np.ndarray,
    faces: np.ndarray,
    frames: np.ndarray,
    corners: np.ndarray,
    stiffness: np.ndarray,
    symmetric: bool,
    forces: np.ndarray,
    tangent: np.ndarray,
) -> float:
    """Internal forces (f, 18) and, if its array is not empty, the tangent (f, 18, 18); returns the energy.

    ``points`` (v, 3) and ``rotations`` (v, 3, 3) of the current state; ``frames``, ``corners``, ``stiffness`` of the
    undeformed elements. ``symmetric`` takes the symmetric part of the tangent, to which it converges in
    equilibrium.
    """
    wanted = tangent.shape[0] > 0
    energy = 0.0
    local = np.empty((3, 2))
    xy = np.empty((3, 2))
    moment = np.empty(3)
    frame = np.empty((3, 3))
    side = np.empty((3, 3))
    spin = np.empty((3, 3))
    half = np.empty((3, 3))
    d = np.empty(18)
    kd = np.empty(18)
    fp = np.empty(18)
    h = np.empty((3, 3, 3))
    m = np.empty((3, 3, 3))
    g = np.zeros((3, 18))
    s = np.zeros((18, 3))
    a = np.empty((18, 18))
    work = np.empty((18, 18))
    left = np.empty((18, 3))
    right = np.empty((18, 3))
    inner = np.empty((3, 3))
    for e in range(faces.shape[0]):
        area = triangle_frame(points[faces[e, 0]], points[faces[e, 1]], points[faces[e, 2]], side, xy)
        # Rotate the frame in its plane until it fits the undeformed corners best.
        mx, my = (xy[0, 0] + xy[1, 0] + xy[2, 0]) / 3, (xy[0, 1] + xy[1, 1] + xy[2, 1]) / 3
        sine = cosine = 0.0
        for k in range(3):
            px, py = xy[k, 0] - mx, xy[k, 1] - my
            sine += corners[e, k, 0] * py - corners[e, k, 1] * px
            cosine += corners[e, k, 0] * px + corners[e, k, 1] * py
        spread = np.sqrt(sine * sine + cosine * cosine)
        sine, cosine = sine / spread, cosine / spread
        for i in range(3):
            frame[0, i] = cosine * side[0, i] + sine * side[1, i]
            frame[1, i] = -sine * side[0, i] + cosine * side[1, i]
            frame[2, i] = side[2, i]
        for k in range(3):
            px, py = xy[k, 0] - mx, xy[k, 1] - my
            local[k, 0] = cosine * px + sine * py
            local[k, 1] = -sine * px + cosine * py
            d[6 * k] = local[k, 0] - corners[e, k, 0]
            d[6 * k + 1] = local[k, 1] - corners[e, k, 1]
            d[6 * k + 2] = 0.0
            rotation = rotations[faces[e, k]]
            for i in range(3):
                for j in range(3):
                    half[i, j] = (
                        frame[i, 0] * rotation[0, j]
                        + frame[i, 1] * rotation[1, j]
                        + frame[i, 2] * rotation[2, j]
                    )
            for i in range(3):
                for j in range(3):
                    spin[i, j] = (
                        half[i, 0] * frames[e, j, 0]
                        + half[i, 1] * frames[e, j, 1]
                        + half[i, 2] * frames[e, j, 2]
                    )
            rotation_vector(spin, d[6 * k + 3 : 6 * k + 6])
        for i in range(18):
            kd[i] = 0.0
            for j in range(18):
                kd[i] += stiffness[e, i, j] * d[j]
            energy += 0.5 * d[i] * kd[i]
        for k in range(3):
            _spin_to_rate(d[6 * k + 3 : 6 * k + 6], kd[6 * k + 3 : 6 * k + 6], h[k], m[k], half, spin)
            b, c = (k + 1) % 3, (k + 2) % 3
            g[0, 6 * k + 2] = (local[c, 0] - local[b, 0]) / (2 * area)
            g[1, 6 * k + 2] = -(local[b, 1] - local[c, 1]) / (2 * area)
            g[2, 6 * k] = -corners[e, k, 1] / spread
            g[2, 6 * k + 1] = corners[e, k, 0] / spread
            s[6 * k, 2], s[6 * k + 1, 2] = -local[k, 1], local[k, 0]
            s[6 * k + 2, 0], s[6 * k + 2, 1] = local[k, 1], -local[k, 0]
            for i in range(3):
                s[6 * k + 3 + i, i] = 1.0
                fp[6 * k + i] = kd[6 * k + i]
                fp[6 * k + 3 + i] = (
                    h[k, 0, i] * kd[6 * k + 3] + h[k, 1, i] * kd[6 * k + 4] + h[k, 2, i] * kd[6 * k + 5]
                )
        # P^T: remove the part that does work in a rigid rotation of the element.
        for j in range(3):
            moment[j] = 0.0
            for i in range(18):
                moment[j] += s[i, j] * fp[i]
        for i in range(18):
            fp[i] -= g[0, i] * moment[0] + g[1, i] * moment[1] + g[2, i] * moment[2]
        for k in range(6):
            for i in range(3):
                forces[e, 3 * k + i] = (
                    frame[0, i] * fp[3 * k] + frame[1, i] * fp[3 * k + 1] + frame[2, i] * fp[3 * k + 2]
                )
        if not wanted:
            continue
        # A = H^T K H + M.
        for i in range(18):
            for k in range(3):
                for j in range(3):
                    work[i, 6 * k + j] = stiffness[e, i, 6 * k + j]
                    work[i, 6 * k + 3 + j] = (
                        stiffness[e, i, 6 * k + 3] * h[k, 0, j]
                        + stiffness[e, i, 6 * k + 4] * h[k, 1, j]
                        + stiffness[e, i, 6 * k + 5] * h[k, 2, j]
                    )
        for j in range(18):
            for k in range(3):
                for i in range(3):
                    a[6 * k + i, j] = work[6 * k + i, j]
                    a[6 * k + 3 + i, j] = (
                        h[k, 0, i] * work[6 * k + 3, j]
                        + h[k, 1, i] * work[6 * k + 4, j]
                        + h[k, 2, i] * work[6 * k + 5, j]
                    )
        for k in range(3):
            for i in range(3):
                for j in range(3):
                    a[6 * k + 3 + i, 6 * k + 3 + j] += m[k, i, j]
        # ``right`` = A S and ``left`` = A^T S; S has two entries per row in the displacements.
        for i in range(18):
            r0 = r1 = r2 = l0 = l1 = l2 = 0.0
            for k in range(3):
                x, y, z = 6 * k, 6 * k + 1, 6 * k + 2
                px, py = local[k, 0], local[k, 1]
                r0 += a[i, z] * py + a[i, x + 3]
                r1 += a[i, x + 4] - a[i, z] * px
                r2 += a[i, y] * px - a[i, x] * py + a[i, x + 5]
                l0 += a[z, i] * py + a[x + 3, i]
                l1 += a[x + 4, i] - a[z, i] * px
                l2 += a[y, i] * px - a[x, i] * py + a[x + 5, i]
            right[i, 0], right[i, 1], right[i, 2] = r0, r1, r2
            left[i, 0], left[i, 1], left[i, 2] = l0, l1, l2
        # P^T A P - F_nm G - G^T F_n^T P = A - Q G - G^T R^T, with P = 1 - S G.
        for k in range(6):
            n0, n1, n2 = fp[3 * k], fp[3 * k + 1], fp[3 * k + 2]
            right[3 * k, 1] -= n2
            right[3 * k, 2] += n1
            right[3 * k + 1, 0] += n2
            right[3 * k + 1, 2] -= n0
            right[3 * k + 2, 0] -= n1
            right[3 * k + 2, 1] += n0
            if k % 2 == 0:
                left[3 * k, 1] -= n2
                left[3 * k, 2] += n1
                left[3 * k + 1, 0] += n2
                left[3 * k + 1, 2] -= n0
                left[3 * k + 2, 0] -= n1
                left[3 * k + 2, 1] += n0
        for p in range(3):
            for q in range(3):
                inner[p, q] = 0.0
                for i in range(18):
                    inner[p, q] += left[i, p] * s[i, q]
        for i in range(18):
            for q in range(3):
                right[i, q] -= g[0, i] * inner[0, q] + g[1, i] * inner[1, q] + g[2, i] * inner[2, q]
        if symmetric:
            for i in range(18):
                for q in range(3):
                    right[i, q] = left[i, q] = 0.5 * (right[i, q] + left[i, q])
        for i in range(18):
            for j in range(18):
                work[i, j] = a[i, j]
        # G has entries only for displacements: its third row in the plane, the others across it.
        for k in range(3):
            x, y, z = 6 * k, 6 * k + 1, 6 * k + 2
            for i in range(18):
                work[i, x] -= right[i, 2] * g[2, x]
                work[i, y] -= right[i, 2] * g[2, y]
                work[i, z] -= right[i, 0] * g[0, z] + right[i, 1] * g[1, z]
            for j in range(18):
                work[x, j] -= g[2, x] * left[j, 2]
                work[y, j] -= g[2, y] * left[j, 2]
                work[z, j] -= g[0, z] * left[j, 0] + g[1, z] * left[j, 1]
        if symmetric:
            for k in range(3):
                # Only M in A is unsymmetric.
                for i in range(6 * k + 3, 6 * k + 6):
                    for j in range(6 * k + 3, i):
                        work[i, j] = work[j, i] = 0.5 * (work[i, j] + work[j, i])
        rotate_blocks(work, frame, symmetric, half, tangent[e])
    return energy


@kernel
def pressure_tangent(
    points: np.ndarray, faces: np.ndarray, fraction: np.ndarray, pressure: float, out: np.ndarray
) -> None:
    """Subtract d(pressure a)/du from element tangents (f, 18, 18), a = dV/du, at constant pressure."""
    for e in range(faces.shape[0]):
        scale = fraction[e] * pressure / 6.0
        for k in range(3):
            # Twice the face's area vector is the sum over corners of x_k x x_k+1.
            following, previous = faces[e, (k + 1) % 3], faces[e, (k + 2) % 3]
            # d(a x b + b x c + c x a) by corner k: skew of (previous - following).
            ux = scale * (points[previous, 0] - points[following, 0])
            uy = scale * (points[previous, 1] - points[following, 1])
            uz = scale * (points[previous, 2] - points[following, 2])
            for i in range(3):
                out[e, 6 * i, 6 * k + 1] += uz
                out[e, 6 * i, 6 * k + 2] -= uy
                out[e, 6 * i + 1, 6 * k] -= uz
                out[e, 6 * i + 1, 6 * k + 2] += ux
                out[e, 6 * i + 2, 6 * k] += uy
                out[e, 6 * i + 2, 6 * k + 1] -= ux
