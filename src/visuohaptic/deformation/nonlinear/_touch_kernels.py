"""Kernels of self-contact: vertices close to faces, and edges that intersect faces (:mod:`.self_contact`)."""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel


@kernel
def distance_to_triangle(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    """Vector from a point to the nearest point of a triangle (Ericson 2005, Sec. 5.1.5)."""
    ab0, ab1, ab2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    ac0, ac1, ac2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    ap0, ap1, ap2 = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    bp0, bp1, bp2 = p[0] - b[0], p[1] - b[1], p[2] - b[2]
    cp0, cp1, cp2 = p[0] - c[0], p[1] - c[1], p[2] - c[2]
    d1 = ab0 * ap0 + ab1 * ap1 + ab2 * ap2
    d2 = ac0 * ap0 + ac1 * ap1 + ac2 * ap2
    d3 = ab0 * bp0 + ab1 * bp1 + ab2 * bp2
    d4 = ac0 * bp0 + ac1 * bp1 + ac2 * bp2
    d5 = ab0 * cp0 + ab1 * cp1 + ab2 * cp2
    d6 = ac0 * cp0 + ac1 * cp1 + ac2 * cp2
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0 and d2 <= 0:
        u, v = 0.0, 0.0
    elif d3 >= 0 and d4 <= d3:
        u, v = 1.0, 0.0
    elif d6 >= 0 and d5 <= d6:
        u, v = 0.0, 1.0
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        u, v = d1 / (d1 - d3), 0.0
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        u, v = 0.0, d2 / (d2 - d6)
    elif va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        v = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        u = 1.0 - v
    else:
        u, v = vb / (va + vb + vc), vc / (va + vb + vc)
    x, y, z = ap0 - u * ab0 - v * ac0, ap1 - u * ab1 - v * ac1, ap2 - u * ab2 - v * ac2
    return float(np.sqrt(x * x + y * y + z * z))


@kernel
def goes_through(p: np.ndarray, q: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> bool:
    """Whether the segment from p to q intersects a triangle (Moeller and Trumbore 1997)."""
    e10, e11, e12 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    e20, e21, e22 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    d0, d1, d2 = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    h0, h1, h2 = d1 * e22 - d2 * e21, d2 * e20 - d0 * e22, d0 * e21 - d1 * e20
    det = e10 * h0 + e11 * h1 + e12 * h2
    size = (abs(e10) + abs(e11) + abs(e12)) * (abs(e20) + abs(e21) + abs(e22)) * (abs(d0) + abs(d1) + abs(d2))
    if abs(det) < 1e-9 * size:
        return False  # along the triangle
    s0, s1, s2 = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    u = (s0 * h0 + s1 * h1 + s2 * h2) / det
    if u < 0 or u > 1:
        return False
    k0, k1, k2 = s1 * e12 - s2 * e11, s2 * e10 - s0 * e12, s0 * e11 - s1 * e10
    v = (d0 * k0 + d1 * k1 + d2 * k2) / det
    if v < 0 or u + v > 1:
        return False
    t = (e20 * k0 + e21 * k1 + e22 * k2) / det
    return 0 <= t <= 1


@kernel
def _beside(least: np.ndarray, most: np.ndarray, p: np.ndarray, q: np.ndarray, near: float) -> bool:
    """Whether the bounding boxes of a face and of an edge are more than ``near`` apart along an axis."""
    apart = False
    for k in range(3):
        apart = apart or max(p[k], q[k]) < least[k] - near or min(p[k], q[k]) > most[k] + near
    return apart


@kernel
def meetings(
    points: np.ndarray, faces: np.ndarray, edges: np.ndarray, near: float, cell: float, most: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices nearer than ``near`` to a non-adjacent face, and edges through such a face.

    Returns the vertex (of an edge its first), the face, and the distance, zero for an edge. Faces are
    sorted into a grid, so that only neighbours are tested.
    """
    low = np.empty(3)
    size = np.empty(3, dtype=np.int64)
    for k in range(3):
        lowest = highest = points[0, k]
        for v in range(points.shape[0]):
            lowest, highest = min(lowest, points[v, k]), max(highest, points[v, k])
        low[k] = lowest - near
        size[k] = int((highest + near - low[k]) / cell) + 1
    least = np.empty((faces.shape[0], 3))
    greatest = np.empty((faces.shape[0], 3))
    for f in range(faces.shape[0]):
        for k in range(3):
            a, b, c = points[faces[f, 0], k], points[faces[f, 1], k], points[faces[f, 2], k]
            least[f, k], greatest[f, k] = min(a, b, c), max(a, b, c)
    begin = np.zeros(size[0] * size[1] * size[2] + 1, dtype=np.int64)
    bottom = np.empty(3, dtype=np.int64)
    top = np.empty(3, dtype=np.int64)
    listed = np.empty(0, dtype=np.int64)
    fill = begin
    for sweep in range(2):
        if sweep == 1:
            for s in range(begin.size - 1):
                begin[s + 1] += begin[s]
            listed = np.empty(begin[-1], dtype=np.int64)
            fill = begin[:-1].copy()
        for f in range(faces.shape[0]):
            for k in range(3):
                bottom[k] = max(int((least[f, k] - near - low[k]) / cell), 0)
                top[k] = min(int((greatest[f, k] + near - low[k]) / cell), size[k] - 1)
            for i in range(bottom[0], top[0] + 1):
                for j in range(bottom[1], top[1] + 1):
                    for k in range(bottom[2], top[2] + 1):
                        s = (i * size[1] + j) * size[2] + k
                        if sweep == 0:
                            begin[s + 1] += 1
                        else:
                            listed[fill[s]] = f
                            fill[s] += 1
    vertex = np.empty(most, dtype=np.int64)
    face = np.empty(most, dtype=np.int64)
    distance = np.empty(most)
    count = 0
    seen = np.full(faces.shape[0], -1, dtype=np.int64)
    for e in range(edges.shape[0]):
        p, q = edges[e, 0], edges[e, 1]
        for k in range(3):
            a, b = points[p, k], points[q, k]
            bottom[k] = max(int((min(a, b) - low[k]) / cell), 0)
            top[k] = min(int((max(a, b) - low[k]) / cell), size[k] - 1)
        for i in range(bottom[0], top[0] + 1):
            for j in range(bottom[1], top[1] + 1):
                for k in range(bottom[2], top[2] + 1):
                    s = (i * size[1] + j) * size[2] + k
                    for m in range(begin[s], begin[s + 1]):
                        f = listed[m]
                        if seen[f] == e:
                            continue
                        seen[f] = e
                        if _beside(least[f], greatest[f], points[p], points[q], 0.0):
                            continue
                        a_, b_, c_ = faces[f, 0], faces[f, 1], faces[f, 2]
                        if p in (a_, b_, c_) or q in (a_, b_, c_):
                            continue
                        if goes_through(points[p], points[q], points[a_], points[b_], points[c_]):
                            vertex[count], face[count], distance[count] = p, f, 0.0
                            count += 1
                            if count == most:
                                return vertex, face, distance
    for v in range(points.shape[0]):
        for k in range(3):
            bottom[k] = min(max(int((points[v, k] - low[k]) / cell), 0), size[k] - 1)
        s = (bottom[0] * size[1] + bottom[1]) * size[2] + bottom[2]
        for m in range(begin[s], begin[s + 1]):
            f = listed[m]
            if _beside(least[f], greatest[f], points[v], points[v], near):
                continue
            a_, b_, c_ = faces[f, 0], faces[f, 1], faces[f, 2]
            if v in (a_, b_, c_):
                continue
            away = distance_to_triangle(points[v], points[a_], points[b_], points[c_])
            if away < near:
                vertex[count], face[count], distance[count] = v, f, away
                count += 1
                if count == most:
                    return vertex, face, distance
    return vertex[:count], face[:count], distance[:count]


@kernel
def distances(points: np.ndarray, faces: np.ndarray, vertex: np.ndarray, face: np.ndarray) -> np.ndarray:
    """Distances from vertices to faces, pair by pair."""
    out = np.empty(vertex.size)
    for k in range(vertex.size):
        a, b, c = points[faces[face[k], 0]], points[faces[face[k], 1]], points[faces[face[k], 2]]
        out[k] = distance_to_triangle(points[vertex[k]], a, b, c)
    return out
