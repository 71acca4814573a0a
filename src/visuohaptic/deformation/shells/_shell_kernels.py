"""Flat triangular shell element: DKT bending and the optimal membrane with drilling degrees of freedom.

Nodal degrees of freedom are three displacements and three rotations. In the element's own frame the membrane
has (u, v, theta_z) and the plate (w, theta_x, theta_y), which are uncoupled in a flat element.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel

#: Indices of the membrane's and of the plate's degrees of freedom among the 18 of an element.
MEMBRANE = np.array([0, 1, 5, 6, 7, 11, 12, 13, 17])
PLATE = np.array([2, 3, 4, 8, 9, 10, 14, 15, 16])

#: Felippa 2003: Q_1, Q_2, Q_3 for the chosen beta, and their means (midpoint of a side, row, corner).
_CORNER = np.array(
    [
        [[1, 2, 1], [0, 1, -1], [-1, -1, -2]],
        [[-2, -1, -1], [1, 1, 2], [-1, 0, 1]],
        [[1, -1, 0], [-1, -2, -1], [2, 1, 1]],
    ],
    dtype=float,
)
_MIDPOINT = 0.5 * (_CORNER + np.roll(_CORNER, -1, axis=0))


@kernel
def triangle_frame(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, frame: np.ndarray, corners: np.ndarray
) -> float:
    """Fill axes (rows) with x along a-b and z along the normal, and corner coordinates (3, 2); returns the area."""
    x0, x1, x2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    y0, y1, y2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    n0, n1, n2 = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
    twice = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    length = np.sqrt(x0 * x0 + x1 * x1 + x2 * x2)
    frame[0, 0], frame[0, 1], frame[0, 2] = x0 / length, x1 / length, x2 / length
    frame[2, 0], frame[2, 1], frame[2, 2] = n0 / twice, n1 / twice, n2 / twice
    frame[1, 0] = frame[2, 1] * frame[0, 2] - frame[2, 2] * frame[0, 1]
    frame[1, 1] = frame[2, 2] * frame[0, 0] - frame[2, 0] * frame[0, 2]
    frame[1, 2] = frame[2, 0] * frame[0, 1] - frame[2, 1] * frame[0, 0]
    corners[0, 0] = corners[0, 1] = corners[1, 1] = 0.0
    corners[1, 0] = length
    corners[2, 0] = frame[0, 0] * y0 + frame[0, 1] * y1 + frame[0, 2] * y2
    corners[2, 1] = frame[1, 0] * y0 + frame[1, 1] * y1 + frame[1, 2] * y2
    return 0.5 * twice


@kernel
def _add_congruent(out: np.ndarray, b: np.ndarray, d: np.ndarray, weight: float) -> None:
    """out += weight b^T d b for b (3, 9) and d (3, 3)."""
    db = np.empty((3, 9))
    for i in range(3):
        for j in range(9):
            db[i, j] = weight * (d[i, 0] * b[0, j] + d[i, 1] * b[1, j] + d[i, 2] * b[2, j])
    for i in range(9):
        for j in range(9):
            out[i, j] += b[0, i] * db[0, j] + b[1, i] * db[1, j] + b[2, i] * db[2, j]


@kernel
def mean_strain(xy: np.ndarray) -> np.ndarray:
    """Mean strain (3, 9) from the boundary, times twice the area: exact for constant stress."""
    alpha = 1.5
    mean = np.zeros((3, 9))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        x_kj, x_ki, x_ij = xy[k, 0] - xy[j, 0], xy[k, 0] - xy[i, 0], xy[i, 0] - xy[j, 0]
        y_jk, y_ik, y_ji = xy[j, 1] - xy[k, 1], xy[i, 1] - xy[k, 1], xy[j, 1] - xy[i, 1]
        mean[0, 3 * i], mean[2, 3 * i] = y_jk, x_kj
        mean[1, 3 * i + 1], mean[2, 3 * i + 1] = x_kj, y_jk
        mean[0, 3 * i + 2] = alpha * y_jk * (y_ik - y_ji) / 6
        mean[1, 3 * i + 2] = alpha * x_kj * (x_ki - x_ij) / 6
        mean[2, 3 * i + 2] = alpha * (x_ki * y_ik - x_ij * y_ji) / 3
    return mean


@kernel
def membrane_stiffness(xy: np.ndarray, area: float, stiffness: np.ndarray, beta0: float) -> np.ndarray:
    """OPT membrane (9, 9) in (u, v, theta_z) per corner; ``stiffness`` is force per length.

    Felippa 2003, "A study of optimal membrane triangles with drilling freedom", the
    template with alpha_b = 3/2, beta = (1, 2, 1, 0, 1, -1, -1, -1, -2).
    """
    x12, x23, x31 = xy[0, 0] - xy[1, 0], xy[1, 0] - xy[2, 0], xy[2, 0] - xy[0, 0]
    y12, y23, y31 = xy[0, 1] - xy[1, 1], xy[1, 1] - xy[2, 1], xy[2, 1] - xy[0, 1]
    x21, x32, x13 = -x12, -x23, -x31
    y21, y32, y13 = -y12, -y23, -y31
    mean = mean_strain(xy)
    out = np.zeros((9, 9))
    _add_congruent(out, mean, stiffness, 0.25 / area)
    # Higher-order part: natural strains of the deviatoric corner rotations. The squared lengths of the
    # sides that scale the columns of T and divide the rows of Q cancel.
    natural = np.empty((3, 3))
    factor = 0.25 / (area * area) * (2 * area / 3)
    natural[0, 0], natural[0, 1], natural[0, 2] = y23 * y13, y31 * y21, y12 * y32
    natural[1, 0], natural[1, 1], natural[1, 2] = x23 * x13, x31 * x21, x12 * x32
    natural[2, 0] = y23 * x31 + x32 * y13
    natural[2, 1] = y31 * x12 + x13 * y21
    natural[2, 2] = y12 * x23 + x21 * y32
    hierarchical = np.zeros((3, 9))
    for i in range(3):
        hierarchical[i, 0], hierarchical[i, 1] = x32 / (4 * area), y32 / (4 * area)
        hierarchical[i, 3], hierarchical[i, 4] = x13 / (4 * area), y13 / (4 * area)
        hierarchical[i, 6], hierarchical[i, 7] = x21 / (4 * area), y21 / (4 * area)
        hierarchical[i, 3 * i + 2] = 1.0
    for k in range(3):
        strain = np.zeros((3, 9))
        for i in range(3):
            for m in range(3):
                tq = 0.0
                for j in range(3):
                    tq += natural[i, j] * _MIDPOINT[k, j, m]
                tq *= factor
                for j in range(9):
                    strain[i, j] += tq * hierarchical[m, j]
        _add_congruent(out, strain, stiffness, 0.75 * beta0 * area)
    return out


@kernel
def plate_curvature(xy: np.ndarray, area: float, xi: float, eta: float) -> np.ndarray:
    """Curvature (3, 9) of the discrete Kirchhoff triangle in (w, theta_x, theta_y) per corner.

    Batoz, Bathe and Ho 1980. Rotations are right-handed: theta_x = w,y and theta_y = -w,x.
    """
    x23, x31, x12 = xy[1, 0] - xy[2, 0], xy[2, 0] - xy[0, 0], xy[0, 0] - xy[1, 0]
    y23, y31, y12 = xy[1, 1] - xy[2, 1], xy[2, 1] - xy[0, 1], xy[0, 1] - xy[1, 1]
    l4, l5, l6 = x23 * x23 + y23 * y23, x31 * x31 + y31 * y31, x12 * x12 + y12 * y12
    p4, p5, p6 = -6 * x23 / l4, -6 * x31 / l5, -6 * x12 / l6
    t4, t5, t6 = -6 * y23 / l4, -6 * y31 / l5, -6 * y12 / l6
    q4, q5, q6 = 3 * x23 * y23 / l4, 3 * x31 * y31 / l5, 3 * x12 * y12 / l6
    r4, r5, r6 = 3 * y23 * y23 / l4, 3 * y31 * y31 / l5, 3 * y12 * y12 / l6
    e, f = 1 - 2 * xi, 1 - 2 * eta
    hx_xi = (
        p6 * e + (p5 - p6) * eta, q6 * e - (q5 + q6) * eta, -4 + 6 * (xi + eta) + r6 * e - eta * (r5 + r6),
        -p6 * e + eta * (p4 + p6), q6 * e - eta * (q6 - q4), -2 + 6 * xi + r6 * e + eta * (r4 - r6),
        -eta * (p5 + p4), eta * (q4 - q5), -eta * (r5 - r4),
    )  # fmt: skip
    hy_xi = (
        t6 * e + eta * (t5 - t6), 1 + r6 * e - eta * (r5 + r6), -q6 * e + eta * (q5 + q6),
        -t6 * e + eta * (t4 + t6), -1 + r6 * e + eta * (r4 - r6), -q6 * e - eta * (q4 - q6),
        -eta * (t4 + t5), eta * (r4 - r5), -eta * (q4 - q5),
    )  # fmt: skip
    hx_eta = (
        -p5 * f - xi * (p6 - p5), q5 * f - xi * (q5 + q6), -4 + 6 * (xi + eta) + r5 * f - xi * (r5 + r6),
        xi * (p4 + p6), xi * (q4 - q6), -xi * (r6 - r4),
        p5 * f - xi * (p4 + p5), q5 * f + xi * (q4 - q5), -2 + 6 * eta + r5 * f + xi * (r4 - r5),
    )  # fmt: skip
    hy_eta = (
        -t5 * f - xi * (t6 - t5), 1 + r5 * f - xi * (r5 + r6), -q5 * f + xi * (q5 + q6),
        xi * (t4 + t6), xi * (r4 - r6), -xi * (q4 - q6),
        t5 * f - xi * (t4 + t5), -1 + r5 * f + xi * (r4 - r5), -q5 * f - xi * (q4 - q5),
    )  # fmt: skip
    out = np.empty((3, 9))
    scale = 0.5 / area
    for j in range(9):
        out[0, j] = scale * (y31 * hx_xi[j] + y12 * hx_eta[j])
        out[1, j] = scale * (-x31 * hy_xi[j] - x12 * hy_eta[j])
        out[2, j] = scale * (-x31 * hx_xi[j] - x12 * hx_eta[j] + y31 * hy_xi[j] + y12 * hy_eta[j])
    return out


@kernel
def rotate_blocks(
    local: np.ndarray, frame: np.ndarray, symmetric: bool, half: np.ndarray, out: np.ndarray
) -> None:
    """out = T^T local T, T the block diagonal of six times ``frame`` (rows are local axes); ``half`` (3, 3) is scratch.

    Of a ``symmetric`` matrix the blocks below the diagonal are read, and those above it copied.
    """
    for p in range(6):
        for q in range(p + 1 if symmetric else 6):
            for i in range(3):
                for j in range(3):
                    half[i, j] = (
                        local[3 * p + i, 3 * q] * frame[0, j]
                        + local[3 * p + i, 3 * q + 1] * frame[1, j]
                        + local[3 * p + i, 3 * q + 2] * frame[2, j]
                    )
            for i in range(3):
                for j in range(3):
                    out[3 * p + i, 3 * q + j] = (
                        frame[0, i] * half[0, j] + frame[1, i] * half[1, j] + frame[2, i] * half[2, j]
                    )
            if symmetric and q < p:
                for i in range(3):
                    for j in range(3):
                        out[3 * q + j, 3 * p + i] = out[3 * p + i, 3 * q + j]


@kernel
def rotate_elements(frames: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Element stiffness (f, 18, 18) in the global frame, from the results of :func:`element_frames`."""
    out = np.empty((len(frames), 18, 18))
    half = np.empty((3, 3))
    for e in range(len(frames)):
        rotate_blocks(stiffness[e], frames[e], True, half, out[e])
    return out


@kernel
def element_frames(
    vertices: np.ndarray,
    faces: np.ndarray,
    membrane: np.ndarray,
    plate: np.ndarray,
    beta0: np.ndarray,
    coupling: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frames (f, 3, 3), corners about the centroid (f, 3, 2), local stiffness (f, 18, 18).

    ``membrane`` and ``plate`` (f, 3, 3): force per length and moment per length for unit strain
    and curvature, in the element's frame; ``coupling``: force per length for unit curvature, empty if uncoupled.
    """
    count = faces.shape[0]
    frames = np.empty((count, 3, 3))
    corners = np.empty((count, 3, 2))
    stiffness = np.zeros((count, 18, 18))
    xy = np.empty((3, 2))
    for e in range(count):
        a, b, c = vertices[faces[e, 0]], vertices[faces[e, 1]], vertices[faces[e, 2]]
        area = triangle_frame(a, b, c, frames[e], xy)
        in_plane = membrane_stiffness(xy, area, membrane[e], beta0[e])
        across = np.zeros((9, 9))
        bending = np.zeros((3, 9))
        for k in range(3):
            # The midpoints of the sides, in natural coordinates (xi, eta).
            xi, eta = 0.5 if k < 2 else 0.0, 0.5 if k > 0 else 0.0
            curvature = plate_curvature(xy, area, xi, eta)
            _add_congruent(across, curvature, plate[e], area / 3)
            for i in range(3):
                for j in range(9):
                    bending[i, j] += area / 3 * curvature[i, j]
        for i in range(9):
            for j in range(9):
                stiffness[e, MEMBRANE[i], MEMBRANE[j]] = 0.5 * (in_plane[i, j] + in_plane[j, i])
                stiffness[e, PLATE[i], PLATE[j]] = 0.5 * (across[i, j] + across[j, i])
        if len(coupling):
            # Means over the triangle: positive definite together with the constant-strain parts of membrane and plate.
            stretch = mean_strain(xy)
            for i in range(9):
                for j in range(9):
                    value = 0.0
                    for p in range(3):
                        for q in range(3):
                            value += stretch[p, i] * coupling[e, p, q] * bending[q, j]
                    value *= 0.5 / area
                    stiffness[e, MEMBRANE[i], PLATE[j]] = stiffness[e, PLATE[j], MEMBRANE[i]] = value
        for i in range(2):
            middle = (xy[0, i] + xy[1, i] + xy[2, i]) / 3
            for j in range(3):
                corners[e, j, i] = xy[j, i] - middle
    return frames, corners, stiffness
