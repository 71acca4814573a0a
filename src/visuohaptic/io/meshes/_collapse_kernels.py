"""Sequential edge collapse of a triangle mesh: kernels."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.kernels import kernel

#: A collapse creates no angle above 130 degrees, unless there was a larger one: its cosine.
OBTUSE_COSINE = float(np.cos(np.radians(130.0)))
#: A triangle rotates by less than 60 degrees when a corner moves: its cosine.
MIN_COSINE = 0.5
#: The orientation of a triangle whose height is below this fraction of its longest side is not preserved.
SLIVER = 0.05
#: Tangentially, the planes give no constraint: relative weight of the edge's midpoint.
DAMPING = 1e-2


@kernel
def collapse_short(
    points: Any, faces: Any, quadric: Any, border: Any, bound: float, length: float, tolerance: float
) -> float:
    """Collapse edges shorter than ``bound``; removed faces get -1; returns the largest resulting distance."""
    count, total = points.shape[0], faces.shape[0]
    head, tail = np.full(count, -1), np.full(count, -1)
    after = np.full(3 * total, -1)
    for corner in range(3 * total):
        vertex = faces[corner // 3, corner % 3]
        if head[vertex] < 0:
            head[vertex] = corner
        else:
            after[tail[vertex]] = corner
        tail[vertex] = corner
    stamp = np.full(count, -1)
    place = np.empty(3)
    moved = 0.0
    tries = 0
    for corner in range(3 * total):
        face = corner // 3
        if faces[face, 0] < 0:
            continue
        a, b = faces[face, corner % 3], faces[face, (corner + 1) % 3]
        square = 0.0
        for k in range(3):
            square += (points[a, k] - points[b, k]) ** 2
        if square >= bound * bound:
            continue
        error = best_place(points, quadric, a, b, place)
        if error > tolerance:
            continue
        tries += 1
        shared = common(faces, head, after, stamp, a, b, tries)
        # Both ends are on a border but the edge is interior, or the ends share too many neighbours.
        if shared == 0 or (border[a] and border[b] and shared != 1):
            continue
        if not (
            stays(points, faces, head, after, a, b, place, length)
            and stays(points, faces, head, after, b, a, place, length)
        ):
            continue
        moved = max(moved, error)
        for k in range(3):
            points[a, k] = place[k]
        for k in range(quadric.shape[1]):
            quadric[a, k] += quadric[b, k]
        border[a] = border[a] or border[b]
        other = head[b]
        while other >= 0:
            if faces[other // 3, 0] >= 0:
                row = other // 3
                if faces[row, 0] == a or faces[row, 1] == a or faces[row, 2] == a:
                    faces[row, 0] = -1
                else:
                    faces[row, other % 3] = a
            other = after[other]
        after[tail[a]] = head[b]
        tail[a] = tail[b]
    return moved


@kernel
def best_place(points: Any, quadric: Any, a: int, b: int, place: Any) -> float:
    """Point with the smallest distance from all planes of two vertices, near their midpoint, and that distance."""
    weight = quadric[a, 10] + quadric[b, 10]
    damping = DAMPING * weight
    xx, xy, xz = quadric[a, 0] + quadric[b, 0], quadric[a, 1] + quadric[b, 1], quadric[a, 2] + quadric[b, 2]
    yy, yz, zz = quadric[a, 3] + quadric[b, 3], quadric[a, 4] + quadric[b, 4], quadric[a, 5] + quadric[b, 5]
    bx, by, bz = quadric[a, 6] + quadric[b, 6], quadric[a, 7] + quadric[b, 7], quadric[a, 8] + quadric[b, 8]
    x, y, z = (
        0.5 * (points[a, 0] + points[b, 0]),
        0.5 * (points[a, 1] + points[b, 1]),
        0.5 * (points[a, 2] + points[b, 2]),
    )
    gx, gy, gz = xx * x + xy * y + xz * z + bx, xy * x + yy * y + yz * z + by, xz * x + yz * y + zz * z + bz
    p, q, r = xx + damping, yy + damping, zz + damping
    # By cofactors: the matrix is positive definite.
    c00, c01, c02 = q * r - yz * yz, xz * yz - xy * r, xy * yz - xz * q
    c11, c12, c22 = p * r - xz * xz, xy * xz - p * yz, p * q - xy * xy
    whole = p * c00 + xy * c01 + xz * c02
    x -= (c00 * gx + c01 * gy + c02 * gz) / whole
    y -= (c01 * gx + c11 * gy + c12 * gz) / whole
    z -= (c02 * gx + c12 * gy + c22 * gz) / whole
    place[0], place[1], place[2] = x, y, z
    square = (
        xx * x * x
        + yy * y * y
        + zz * z * z
        + 2 * (xy * x * y + xz * x * z + yz * y * z)
        + 2 * (bx * x + by * y + bz * z)
        + quadric[a, 9]
        + quadric[b, 9]
    )
    return np.sqrt(max(square, 0.0) / weight)


@kernel
def common(faces: Any, head: Any, after: Any, stamp: Any, a: int, b: int, tries: int) -> int:
    """Number of triangles at an edge, or 0 if its ends share more neighbours than those (link condition)."""
    shared, both = 0, 0
    corner = head[a]
    while corner >= 0:
        face = corner // 3
        if faces[face, 0] >= 0:
            for k in range(3):
                if faces[face, k] == b:
                    shared += 1
                stamp[faces[face, k]] = 2 * tries
        corner = after[corner]
    corner = head[b]
    while corner >= 0:
        face = corner // 3
        if faces[face, 0] >= 0:
            for k in range(3):
                vertex = faces[face, k]
                if vertex != a and vertex != b and stamp[vertex] == 2 * tries:
                    both += 1
                    stamp[vertex] = 2 * tries + 1
        corner = after[corner]
    return shared if both == shared else 0


@kernel
def stays(points: Any, faces: Any, head: Any, after: Any, a: int, b: int, place: Any, length: float) -> bool:
    """Whether no triangle at ``a`` but not ``b`` is flipped, obtuse or too long when ``a`` moves to ``place``."""
    corner = head[a]
    while corner >= 0:
        face, k = corner // 3, corner % 3
        p, q = faces[face, (k + 1) % 3], faces[face, (k + 2) % 3]
        if faces[face, 0] >= 0 and p != b and q != b:
            ox, oy, oz = across(points, p, q, points[a, 0], points[a, 1], points[a, 2])
            nx, ny, nz = across(points, p, q, place[0], place[1], place[2])
            old, new = np.sqrt(ox * ox + oy * oy + oz * oz), np.sqrt(nx * nx + ny * ny + nz * nz)
            longest, before = shape(points, p, q, points[a, 0], points[a, 1], points[a, 2])
            if old > SLIVER * longest and ox * nx + oy * ny + oz * nz < MIN_COSINE * old * new:
                return False
            longest, angle = shape(points, p, q, place[0], place[1], place[2])
            if angle < min(OBTUSE_COSINE, before) or longest > (4 / 3 * length) ** 2:
                return False
        corner = after[corner]
    return True


@kernel
def across(points: Any, p: int, q: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Normal of a triangle, whose length is twice the area."""
    ux, uy, uz = points[q, 0] - points[p, 0], points[q, 1] - points[p, 1], points[q, 2] - points[p, 2]
    vx, vy, vz = x - points[p, 0], y - points[p, 1], z - points[p, 2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@kernel
def shape(points: Any, p: int, q: int, x: float, y: float, z: float) -> tuple[float, float]:
    """Squared longest side of a triangle, and cosine of its largest angle."""
    one = (points[p, 0] - x) ** 2 + (points[p, 1] - y) ** 2 + (points[p, 2] - z) ** 2
    two = (points[q, 0] - x) ** 2 + (points[q, 1] - y) ** 2 + (points[q, 2] - z) ** 2
    three = (
        (points[p, 0] - points[q, 0]) ** 2
        + (points[p, 1] - points[q, 1]) ** 2
        + (points[p, 2] - points[q, 2]) ** 2
    )
    c = max(one, two, three)
    a = min(one, two, three)
    b = one + two + three - a - c
    if a <= 0.0:
        return c, -1.0
    return c, (a + b - c) / (2 * np.sqrt(a * b))
