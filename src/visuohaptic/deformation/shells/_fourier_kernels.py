"""Block-tridiagonal shell of revolution, one harmonic at a time (:mod:`.fourier_shell`)."""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel


@kernel
def _strains(
    n: float,
    h0: np.ndarray,
    h1: np.ndarray,
    h2: np.ndarray,
    r: float,
    rt: float,
    zt: float,
    rtt: float,
    ztt: float,
    out: np.ndarray,
) -> None:
    """Membrane and bending strain (6, 12) of one element's degrees of freedom at a point of the meridian.

    Degrees of freedom by node: (u_r, u_theta, u_z), then their derivatives by the parameter. ``h0, h1, h2``
    are the four Hermite functions and their derivatives.
    """
    speed2 = rt * rt + zt * zt
    speed = np.sqrt(speed2)
    gamma = (rtt * rt + ztt * zt) / speed2
    nr, nz = -zt / speed, rt / speed
    for k in range(4):
        # Node (0, 1) and kind (value, slope) of this function.
        base = 6 * (k // 2) + 3 * (k % 2)
        v, d, dd = h0[k], h1[k], h2[k]
        c = dd - gamma * d
        tangential = rt / (r * speed2) * d
        out[0, base], out[0, base + 1], out[0, base + 2] = rt * d / speed2, 0.0, zt * d / speed2
        out[1, base], out[1, base + 1], out[1, base + 2] = v / r, n * v / r, 0.0
        out[2, base] = -rt * n * v / (speed * r)
        out[2, base + 1] = (-rt * v + r * d) / (speed * r)
        out[2, base + 2] = -zt * n * v / (speed * r)
        out[3, base], out[3, base + 1], out[3, base + 2] = nr * c / speed2, 0.0, nz * c / speed2
        out[4, base] = nr * (-(n * n + 1) * v / (r * r) + tangential)
        out[4, base + 1] = -nr * 2 * n * v / (r * r)
        out[4, base + 2] = nz * (-n * n * v / (r * r) + tangential)
        twist = d - rt / r * v
        out[5, base] = -2 * nr * n * twist / (speed * r)
        out[5, base + 1] = -2 * nr * twist / (speed * r)
        out[5, base + 2] = -2 * nz * n * twist / (speed * r)


@kernel
def _element(
    n: float,
    size: float,
    meridian: np.ndarray,
    thickness: np.ndarray,
    young: float,
    nu: float,
    points: np.ndarray,
    weights: np.ndarray,
    hermite: np.ndarray,
    out: np.ndarray,
) -> None:
    """Stiffness (12, 12) of one element for harmonic n."""
    strain = np.zeros((6, 12))
    stress = np.zeros((6, 12))
    out[:, :] = 0.0
    for g in range(points.size):
        r, rt, zt, rtt, ztt = meridian[g]
        _strains(n, hermite[g, 0], hermite[g, 1], hermite[g, 2], r, rt, zt, rtt, ztt, strain)
        t = thickness[g]
        membrane = young * t / (1 - nu * nu)
        plate = membrane * t * t / 12
        area = weights[g] * size * np.sqrt(rt * rt + zt * zt) * r * (2 * np.pi if n == 0 else np.pi)
        for j in range(12):
            for half in range(2):
                d = (membrane if half == 0 else plate) * area
                a, b, c = strain[3 * half, j], strain[3 * half + 1, j], strain[3 * half + 2, j]
                stress[3 * half, j] = d * (a + nu * b)
                stress[3 * half + 1, j] = d * (b + nu * a)
                stress[3 * half + 2, j] = d * 0.5 * (1 - nu) * c
        for i in range(12):
            for j in range(i + 1):
                value = 0.0
                for q in range(6):
                    value += strain[q, i] * stress[q, j]
                out[i, j] += value
    for i in range(12):
        for j in range(i):
            out[j, i] = out[i, j]


@kernel
def _eliminate(a: np.ndarray, b: np.ndarray, out: np.ndarray) -> bool:
    """out = b^T a^-1 b for a positive definite (6, 6); ``a`` is overwritten by its factor."""
    for j in range(6):
        for i in range(j, 6):
            value = a[i, j]
            for k in range(j):
                value -= a[i, k] * a[j, k]
            if i == j:
                if value <= 0:
                    return False
                a[j, j] = np.sqrt(value)
            else:
                a[i, j] = value / a[j, j]
    for q in range(6):
        for i in range(6):
            value = b[i, q]
            for k in range(i):
                value -= a[i, k] * b[k, q]
            b[i, q] = value / a[i, i]
    for p in range(6):
        for q in range(p + 1):
            value = 0.0
            for k in range(6):
                value += b[k, p] * b[k, q]
            out[p, q] = value
            out[q, p] = value
    return True


@kernel
def nodal_compliance(
    harmonics: np.ndarray,
    size: np.ndarray,
    meridian: np.ndarray,
    thickness: np.ndarray,
    young: float,
    nu: float,
    points: np.ndarray,
    weights: np.ndarray,
    hermite: np.ndarray,
    held: np.ndarray,
    loads: np.ndarray,
) -> np.ndarray:
    """Compliance (harmonics, nodes) of a unit load of each harmonic at each node.

    ``loads`` (nodes, 3) gives the load's direction in (r, theta, z); ``held`` (nodes, 6) the fixed degrees
    of freedom. The inverse's diagonal blocks result from elimination towards a node from both ends.
    """
    nodes = held.shape[0]
    out = np.zeros((harmonics.size, nodes))
    elements = nodes - 1
    stiffness = np.empty((elements, 12, 12))
    left = np.zeros((nodes, 6, 6))
    a = np.empty((6, 6))
    b = np.empty((6, 6))
    schur = np.zeros((6, 6))
    total = np.empty((6, 6))
    for h in range(harmonics.size):
        n = harmonics[h]
        for e in range(elements):
            _element(
                n, size[e], meridian[e], thickness[e], young, nu, points, weights, hermite[e], stiffness[e]
            )
            for q in range(12):
                if held[e + q // 6, q % 6]:
                    for p in range(12):
                        stiffness[e, p, q] = stiffness[e, q, p] = 0.0
                    stiffness[e, q, q] = 1.0
        for i in range(1, nodes):
            for p in range(6):
                for q in range(6):
                    a[p, q] = stiffness[i - 1, p, q] + left[i - 1, p, q]
                    b[p, q] = stiffness[i - 1, p, 6 + q]
            if not _eliminate(a, b, schur):
                out[h] = np.nan
                break
            for p in range(6):
                for q in range(6):
                    left[i, p, q] = stiffness[i - 1, 6 + p, 6 + q] - schur[p, q]
        for p in range(6):
            for q in range(6):
                schur[p, q] = 0.0
        for i in range(nodes - 1, -1, -1):
            # ``schur`` is the Schur complement of the part beyond this node in its own block.
            for p in range(6):
                for q in range(6):
                    total[p, q] = left[i, p, q] + schur[p, q]
                    b[p, q] = 0.0
            for p in range(6):
                if held[i, p]:
                    total[p, p] = 1.0 if total[p, p] == 0.0 else total[p, p]
            for p in range(3):
                b[p, 0] = 0.0 if held[i, p] else loads[i, p]
            own = np.zeros((6, 6))
            if not _eliminate(total, b, own):
                out[h, i] = np.nan
            else:
                out[h, i] = own[0, 0]
            if i > 0:
                for p in range(6):
                    for q in range(6):
                        a[p, q] = stiffness[i - 1, 6 + p, 6 + q] + schur[p, q]
                        b[p, q] = stiffness[i - 1, 6 + p, q]
                keep = np.zeros((6, 6))
                _eliminate(a, b, keep)
                for p in range(6):
                    for q in range(6):
                        schur[p, q] = stiffness[i - 1, p, q] - keep[p, q]
    return out
