"""Distances from convex hulls, masking of rays through hulls, and visibility of points in a voxel grid."""

from __future__ import annotations

import math

import numpy as np

from ..core.kernels import kernel


@kernel(fastmath=True)
def hull_distance(points, planes, out):
    """Largest signed distance of points from the planes of a convex hull.

    Parameters
    ----------
    points
        Points (n, 3) [m].
    planes
        Unit outward normals and offsets in columns (4, p), contiguous along the planes so that the loop vectorises.
    out
        Distances (n) [m], filled; negative inside.
    """
    a, b, c, d = planes[0], planes[1], planes[2], planes[3]
    for r in range(points.shape[0]):
        x, y, z = points[r, 0], points[r, 1], points[r, 2]
        most = a[0] * x + b[0] * y + c[0] * z + d[0]
        for p in range(1, a.size):
            most = max(most, a[p] * x + b[p] * y + c[p] * z + d[p])
        out[r] = most


@kernel
def mask_through(depth, planes, rows, columns, fx, fy, cx, cy, min_m):
    """Invalidate depth readings whose ray runs inside a hull for more than ``min_m`` before it ends.

    Parameters
    ----------
    depth
        Depth image (h, w) float32 [m]; masked readings are set to NaN.
    planes
        Planes (p, 4) float64 in the camera frame, ``n . x + o <= 0`` inside.
    rows, columns
        First and last pixel of the projection of the hull.
    fx, fy, cx, cy
        Focal lengths and principal point [px].
    min_m
        Minimum path length inside the hull [m].
    """
    for i in range(rows[0], rows[1] + 1):
        y = (i - cy) / fy
        for j in range(columns[0], columns[1] + 1):
            z = depth[i, j]
            if not z > 0:
                continue
            x = (j - cx) / fx
            enter, leave = 0.0, float(z)
            for p in range(len(planes)):
                slope = planes[p, 0] * x + planes[p, 1] * y + planes[p, 2]
                offset = planes[p, 3]
                if slope > 1e-12:
                    leave = min(leave, -offset / slope)
                elif slope < -1e-12:
                    enter = max(enter, -offset / slope)
                elif offset > 0:
                    leave = -1.0
                if leave <= enter:
                    break
            if (leave - enter) * math.sqrt(x * x + y * y + 1.0) > min_m:
                depth[i, j] = np.float32(np.nan)


@kernel
def seen_fraction(blocked, starts, normals, ways, fraction):
    """Cosine-weighted fraction of directions in which a point sees out of the grid without hitting a blocked cell.

    Parameters
    ----------
    blocked
        Cells (x, y, z) that end a ray.
    starts
        Points (n, 3) in cells.
    normals
        Unit normals (n, 3) of the points.
    ways
        Directions (k, 3), unit vectors.
    fraction
        Result (n), filled.
    """
    nx, ny, nz = blocked.shape
    for r in range(len(starts)):
        total, open_ = 0.0, 0.0
        for k in range(len(ways)):
            dx, dy, dz = ways[k, 0], ways[k, 1], ways[k, 2]
            cosine = normals[r, 0] * dx + normals[r, 1] * dy + normals[r, 2] * dz
            if cosine < 0.2:  # grazing directions hit the cells of the surface itself
                continue
            total += cosine
            x, y, z = starts[r, 0], starts[r, 1], starts[r, 2]
            while True:
                i, j, m = math.floor(x), math.floor(y), math.floor(z)
                if i < 0 or j < 0 or m < 0 or i >= nx or j >= ny or m >= nz:
                    open_ += cosine
                    break
                if blocked[i, j, m]:
                    break
                x, y, z = x + dx, y + dy, z + dz
        fraction[r] = open_ / total if total > 0.0 else 0.0
