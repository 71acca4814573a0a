"""Evidence inside the outlines of an upright body in many views."""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel


@kernel
def _side(order, x, v, sign, chain, low, high, side):
    """One side of the convex hull of points at every image row: the minimum of ``sign * x``.

    Parameters
    ----------
    order
        Points (n) by ascending row.
    x, v
        Columns and rows of the points (n) [px].
    sign
        1: left side, -1: right side.
    chain
        Scratch (n).
    low, high
        First and last row to fill.
    side
        Columns of the side (rows) [px], filled.
    """
    count = 0
    for p in order:
        while count >= 2:
            a, b = chain[count - 2], chain[count - 1]
            if sign * (x[b] - x[a]) * (v[p] - v[a]) < sign * (x[p] - x[a]) * (v[b] - v[a]):
                break
            count -= 1
        chain[count] = p
        count += 1
    at = 0
    for i in range(low, high + 1):
        row = min(max(float(i), v[chain[0]]), v[chain[count - 1]])
        while at < count - 2 and v[chain[at + 1]] < row:
            at += 1
        a, b = chain[at], chain[min(at + 1, count - 1)]
        rise = v[b] - v[a]
        side[i] = x[a] if rise <= 0 else x[a] + (row - v[a]) / rise * (x[b] - x[a])


@kernel
def _row_sum(sums, left, right):
    """Sum of a row between two columns, with fractional pixels; ``sums`` are cumulative, one more than columns."""
    total = 0.0
    for end, sign in ((right, 1.0), (left, -1.0)):
        place = min(max(end + 0.5, 0.0), len(sums) - 1.0)
        k = min(int(place), len(sums) - 2)
        total += sign * (sums[k] + (place - k) * (sums[k + 1] - sums[k]))
    return total


@kernel
def outline_sums(corners, sums, limits, motions, matrices, reach, weights, found):
    """Sum of the evidence inside the outlines of a convex body for both eyes of the camera, of each view.

    Parameters
    ----------
    corners
        Points whose convex hull is the body (p, 3) [m].
    sums
        Cumulative evidence along each row (n, h, w + 1) [nat].
    limits
        Depth up to which each ray is evidence (n, h, w) [m].
    motions
        ``T_camera_world`` (n, 3, 4).
    matrices
        fx, fy, cx, cy (n, 4) [px].
    reach
        Focal length times baseline of the second eye (n) [px m].
    weights
        Weight of each view, in independent views (n).
    found
        Evidence (n), filled; 0 where the body is not in front of the camera [nat].
    """
    views, rows, columns = limits.shape
    points = len(corners)
    u, v, z, moved = np.empty(points), np.empty(points), np.empty(points), np.empty(points)
    order, chain = np.empty(points, np.int64), np.empty(points, np.int64)
    left, right, left2, right2 = np.empty(rows), np.empty(rows), np.empty(rows), np.empty(rows)
    for view in range(views):
        found[view] = 0.0
        m, matrix = motions[view], matrices[view]
        nearest, middle_z, middle_u, middle_v = np.inf, 0.0, 0.0, 0.0
        for p in range(points):
            x, y, w = corners[p, 0], corners[p, 1], corners[p, 2]
            z[p] = m[2, 0] * x + m[2, 1] * y + m[2, 2] * w + m[2, 3]
            nearest = min(nearest, z[p])
            u[p] = matrix[0] * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * w + m[0, 3]) / z[p] + matrix[2]
            v[p] = matrix[1] * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * w + m[1, 3]) / z[p] + matrix[3]
            middle_z += z[p] / points
            middle_u += u[p] / points
            middle_v += v[p] / points
        if nearest < 0.05:
            continue
        for p in range(points):
            at = p
            while at > 0 and v[order[at - 1]] > v[p]:
                order[at] = order[at - 1]
                at -= 1
            order[at] = p
        top, bottom = v[order[0]], v[order[points - 1]]
        first, last = max(int(np.floor(top + 0.5)), 0), min(int(np.floor(bottom + 0.5)), rows - 1)
        if last < first:
            continue
        # The second eye sees the body in front of the background beside it, which may differ from that behind its middle, and is
        # known where this is not: it is that at the farthest pixel for which the second eye looks past the body (fixed point).
        edge_u = u[0]
        for p in range(points):
            edge_u = min(edge_u, u[p]) if reach[view] > 0 else max(edge_u, u[p])
        i, behind = min(max(int(middle_v), 0), rows - 1), middle_z
        place = middle_u
        for _ in range(3):
            depth = float(limits[view, i, min(max(int(place), 0), columns - 1)])
            if depth > middle_z:
                behind = depth
            place = edge_u - reach[view] * (1 / middle_z - 1 / behind)
        for p in range(points):
            moved[p] = u[p] - reach[view] * (1 / z[p] - 1 / behind)
        _side(order, u, v, 1.0, chain, first, last, left)
        _side(order, u, v, -1.0, chain, first, last, right)
        _side(order, moved, v, 1.0, chain, first, last, left2)
        _side(order, moved, v, -1.0, chain, first, last, right2)
        total = 0.0
        for i in range(first, last + 1):
            part = min(i + 0.5, bottom) - max(i - 0.5, top)
            row = sums[view, i]
            if min(right[i], right2[i]) >= max(left[i], left2[i]):
                total += part * _row_sum(row, min(left[i], left2[i]), max(right[i], right2[i]))
            else:
                total += part * (_row_sum(row, left[i], right[i]) + _row_sum(row, left2[i], right2[i]))
        found[view] = weights[view] * total
