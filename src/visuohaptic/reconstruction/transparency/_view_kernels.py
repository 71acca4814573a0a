"""Kernels between views: projection of a row, reprojection of depth images, and equations of the pose refinement."""

from __future__ import annotations

import numpy as np
from numba import prange

from ...core.kernels import kernel


# A loop over a row is a function of its own: only so does the compiler vectorise it.
@kernel(error_model="numpy")
def project_row(m, across, down, depth, fx, fy, cx, cy, rows, columns, margin, u, v, there):
    """Fill the pixels and depths of the points of a row in another view.

    Parameters
    ----------
    m
        ``T_other_this`` (3, 4).
    across, down
        Tangents of the rays of the row: along the columns (w), and of the row.
    depth
        Depths of the row (w) [m].
    fx, fy, cx, cy
        Focal lengths and principal point [px].
    rows, columns, margin
        Size of the other image, and width of its border that is left out [px].
    u, v, there
        Columns and rows (w) [px], and depths in the other view (w) [m], filled; NaN outside of its image and without depth.
    """
    half, one, zero = np.float32(0.5), np.float32(1), np.float32(0)
    least, right, low = np.float32(margin), np.float32(columns - margin), np.float32(rows - margin)
    ax, ay, az = m[0, 0], m[1, 0], m[2, 0]
    bx, by, bz = m[0, 1] * down + m[0, 2], m[1, 1] * down + m[1, 2], m[2, 1] * down + m[2, 2]
    tx, ty, tz = m[0, 3], m[1, 3], m[2, 3]
    for j in range(depth.size):
        z = depth[j]
        far = z * (az * across[j] + bz) + tz
        inverse = one / far
        x = fx * (z * (ax * across[j] + bx) + tx) * inverse + cx + half
        y = fy * (z * (ay * across[j] + by) + ty) * inverse + cy + half
        inside = (z > zero) & (far > np.float32(0.05)) & (x >= least) & (y >= least) & (x < right) & (y < low)
        u[j], v[j] = np.int32(x if inside else one), np.int32(y if inside else one)
        there[j] = far if inside else np.float32(np.nan)


@kernel(parallel=True)
def warp_views(depths, motions, fx, fy, cx, cy, warped):
    """Reproject depth images of other views into this view, with z-buffering.

    Parameters
    ----------
    depths
        Depth images (n, h, w) float32 [m]; NaN: invalid.
    motions
        ``T_this_other`` (n, 3, 4) float32.
    fx, fy, cx, cy
        Focal lengths and principal point [px].
    warped
        Depths in this view (n, h, w) float32 [m], filled; infinite where no point projects.
    """
    views, rows, columns = depths.shape
    for k in prange(views):
        target = warped[k]
        across, there = np.empty(columns, np.float32), np.empty(columns, np.float32)
        u, v = np.empty(columns, np.int32), np.empty(columns, np.int32)
        for j in range(columns):
            across[j] = (np.float32(j) - cx) / fx
        for i in range(rows):
            for j in range(columns):
                target[i, j] = np.float32(np.inf)
        for i in range(rows):
            down = (np.float32(i) - cy) / fy
            project_row(motions[k], across, down, depths[k, i], fx, fy, cx, cy, rows, columns, 0, u, v, there)
            for j in range(columns):
                a, b = np.uint32(v[j]), np.uint32(u[j])
                if there[j] < target[a, b]:
                    target[a, b] = there[j]


@kernel
def _plane(depth, i, j, fx, fy, cx, cy, normal):
    """Whether the surface at a pixel is smooth; the plane normal (3) in the camera frame is filled."""
    rows, columns = depth.shape
    if not (2 <= i < rows - 2 and 2 <= j < columns - 2):
        return False
    z = np.float64(depth[i, j])
    left, right = np.float64(depth[i, j - 2]), np.float64(depth[i, j + 2])
    above, below = np.float64(depth[i - 2, j]), np.float64(depth[i + 2, j])
    # A step over four pixels of more than a tenth of the depth is an edge; comparisons with NaN are false.
    if not (z > 0 and abs(right - left) <= 0.1 * z and abs(below - above) <= 0.1 * z):
        return False
    x, y = (j - cx) / fx, (i - cy) / fy
    ax, ay, az = (x + 2 / fx) * right - (x - 2 / fx) * left, y * (right - left), right - left
    bx, by, bz = x * (below - above), (y + 2 / fy) * below - (y - 2 / fy) * above, below - above
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if not length > 0:
        return False
    normal[0], normal[1], normal[2] = nx / length, ny / length, nz / length
    return True


@kernel
def smooth_points(depth, stride, fx, fy, cx, cy, points):
    """Points of a view on smooth surfaces, every ``stride`` pixels down and across; returns their number.

    Parameters
    ----------
    depth
        Depth image (h, w) [m]; NaN: not measured.
    stride
        Distance between points in the image [px].
    fx, fy, cx, cy
        Focal lengths and principal point [px].
    points
        Points (n, 3) in the camera frame [m], filled up to the returned number.
    """
    rows, columns = depth.shape
    normal, count = np.empty(3), 0
    for i in range(stride // 2, rows, stride):
        for j in range(stride // 2, columns, stride):
            if _plane(depth, i, j, fx, fy, cx, cy, normal):
                z = np.float64(depth[i, j])
                points[count, 0], points[count, 1], points[count, 2] = (j - cx) / fx * z, (i - cy) / fy * z, z
                count += 1
    return count


@kernel(parallel=True)
def plane_equations(pairs, points, firsts, stride, poses, depths, fx, fy, cx, cy, reach, quadratic, constant, offset, least, correlated, squares, pulls):  # fmt: skip
    """Point-to-plane normal equations between pairs of views, with Geman-McClure weights.

    Parameters
    ----------
    pairs
        Index of the view of the points, and of the view of the planes (p, 2).
    points
        Points of all views (m, 3) in their camera frames [m].
    firsts
        Index of the first point of each view, and the total number (n + 1).
    stride
        Every n-th point is used.
    poses
        ``T_world_camera`` (n, 3, 4).
    depths
        Depth images (n, h, w) [m]; NaN: not measured.
    fx, fy, cx, cy
        Focal lengths and principal point [px].
    reach
        Maximum distance of a point from its plane [m].
    quadratic, constant, offset
        Coefficients of the depth noise of the camera.
    least
        Minimum standard deviation of a depth [m].
    correlated
        Number of correlated residuals that count as one independent residual.
    squares, pulls
        J^T J and J^T r of each pair, for a motion of the points in the world (p, 6, 6), (p, 6); filled.
    """
    rows, columns = depths.shape[1:]
    for p in prange(len(pairs)):
        row, normal = np.empty(6), np.empty(3)
        a, b = poses[pairs[p, 0]], poses[pairs[p, 1]]
        depth = depths[pairs[p, 1]]
        for c in range(6):
            pulls[p, c] = 0.0
            for d in range(c + 1):
                squares[p, c, d] = 0.0
        for q in range(firsts[pairs[p, 0]], firsts[pairs[p, 0] + 1], stride):
            px, py, pz = points[q, 0], points[q, 1], points[q, 2]
            x = a[0, 0] * px + a[0, 1] * py + a[0, 2] * pz + a[0, 3]
            y = a[1, 0] * px + a[1, 1] * py + a[1, 2] * pz + a[1, 3]
            z = a[2, 0] * px + a[2, 1] * py + a[2, 2] * pz + a[2, 3]
            dx, dy, dz = x - b[0, 3], y - b[1, 3], z - b[2, 3]
            lx = b[0, 0] * dx + b[1, 0] * dy + b[2, 0] * dz
            ly = b[0, 1] * dx + b[1, 1] * dy + b[2, 1] * dz
            lz = b[0, 2] * dx + b[1, 2] * dy + b[2, 2] * dz
            if not lz > 0.05:
                continue
            u, v = np.rint(fx * lx / lz + cx), np.rint(fy * ly / lz + cy)
            if not (u >= 0 and v >= 0 and u < columns and v < rows):
                continue
            i, j = int(v), int(u)
            if not _plane(depth, i, j, fx, fy, cx, cy, normal):
                continue
            nx, ny, nz, there = normal[0], normal[1], normal[2], np.float64(depth[i, j])
            away = (lx - (u - cx) / fx * there) * nx + (ly - (v - cy) / fy * there) * ny + (lz - there) * nz
            if not abs(away) < reach:
                continue
            wx = b[0, 0] * nx + b[0, 1] * ny + b[0, 2] * nz
            wy = b[1, 0] * nx + b[1, 1] * ny + b[1, 2] * nz
            wz = b[2, 0] * nx + b[2, 1] * ny + b[2, 2] * nz
            sigma = np.sqrt(2.0) * abs(constant + quadratic * (lz - offset) ** 2) + least
            # Robust weight: points on a different surface are suppressed.
            weight = 1 / (1 + (away / (3 * sigma)) ** 2) / (sigma * np.sqrt(correlated))
            row[0], row[1], row[2] = y * wz - z * wy, z * wx - x * wz, x * wy - y * wx
            row[3], row[4], row[5] = wx, wy, wz
            for c in range(6):
                row[c] *= weight
                pulls[p, c] += row[c] * away * weight
                for d in range(c + 1):
                    squares[p, c, d] += row[c] * row[d]
        for c in range(6):
            for d in range(c):
                squares[p, d, c] = squares[p, c, d]
