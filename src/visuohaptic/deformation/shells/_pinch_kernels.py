"""Intersections of horizontal rays through the height axis with a mesh (:mod:`.stiffness_map`)."""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel


@kernel
def across(
    points: np.ndarray, faces: np.ndarray, first: np.ndarray, axis: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Farthest face hit beyond the axis of each (m, 2) (-1: none), barycentric coordinates, direction of the ray.

    Faces are sorted into height slabs, so that a ray is tested only against those at its height.
    """
    count = first.size
    slabs = max(1, int(np.sqrt(faces.shape[0])))
    bottom = top = points[0, 2]
    for v in range(points.shape[0]):
        bottom, top = min(bottom, points[v, 2]), max(top, points[v, 2])
    scale = slabs / max(top - bottom, 1e-300)
    slack = 1e-9 * max(top - bottom, 1e-300)
    begin = np.zeros(slabs + 1, dtype=np.int64)
    for sweep in range(2):
        if sweep == 1:
            for s in range(slabs):
                begin[s + 1] += begin[s]
            listed = np.empty(begin[slabs], dtype=np.int64)
            fill = begin[:slabs].copy()
        for f in range(faces.shape[0]):
            z0, z1, z2 = points[faces[f, 0], 2], points[faces[f, 1], 2], points[faces[f, 2], 2]
            low = int((min(z0, z1, z2) - slack - bottom) * scale)
            high = int((max(z0, z1, z2) + slack - bottom) * scale)
            for s in range(max(low, 0), min(high, slabs - 1) + 1):
                if sweep == 0:
                    begin[s + 1] += 1
                else:
                    listed[fill[s]] = f
                    fill[s] += 1
    face = np.full(count, -1, dtype=np.int64)
    weights = np.zeros((count, 3))
    direction = np.zeros((count, 3))
    for k in range(count):
        p = points[first[k]]
        dx, dy = axis[k, 0] - p[0], axis[k, 1] - p[1]
        reach = np.sqrt(dx * dx + dy * dy)
        if reach < 1e-9 * (top - bottom + reach):
            continue
        dx, dy = dx / reach, dy / reach
        direction[k, 0], direction[k, 1] = dx, dy
        slab = min(max(int((p[2] - bottom) * scale), 0), slabs - 1)
        furthest = reach
        for j in range(begin[slab], begin[slab + 1]):
            f = listed[j]
            a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
            # In the plane across the ray: side offset and height of each corner.
            ua, ub, uc = -dy * (a[0] - p[0]) + dx * (a[1] - p[1]), 0.0, 0.0
            ub = -dy * (b[0] - p[0]) + dx * (b[1] - p[1])
            uc = -dy * (c[0] - p[0]) + dx * (c[1] - p[1])
            va, vb, vc = a[2] - p[2], b[2] - p[2], c[2] - p[2]
            twice = (ub - ua) * (vc - va) - (uc - ua) * (vb - va)
            size = max(abs(ub - ua), abs(uc - ua), abs(vb - va), abs(vc - va))
            if abs(twice) < 1e-12 * size * size:
                continue
            wa = (ub * vc - uc * vb) / twice
            wb = (uc * va - ua * vc) / twice
            wc = 1.0 - wa - wb
            if min(wa, wb, wc) < -1e-7:
                continue
            s = (
                wa * (dx * (a[0] - p[0]) + dy * (a[1] - p[1]))
                + wb * (dx * (b[0] - p[0]) + dy * (b[1] - p[1]))
                + wc * (dx * (c[0] - p[0]) + dy * (c[1] - p[1]))
            )
            if s > furthest * (1 + 1e-9):
                furthest = s
                face[k] = f
                wa, wb, wc = max(wa, 0.0), max(wb, 0.0), max(wc, 0.0)
                total = wa + wb + wc
                weights[k, 0], weights[k, 1], weights[k, 2] = wa / total, wb / total, wc / total
    return face, weights, direction
