"""Sum of the ray evidence of all views in the voxels of a volume."""

from __future__ import annotations

import numpy as np
from numba import prange

from ...core.kernels import kernel
from ..fusion._fusion_kernels import look_up, project_cube, scatter, set_offsets

#: Edge of the voxel blocks and of the pixel tiles that share a bound.
EDGE = 8
#: Whether a view has evidence for no, some or all voxels of a block.
NO_VOXEL, SOME_VOXELS, EACH_VOXEL = 0, 1, 2


@kernel
def _block_sight(m, fx, fy, cx, cy, rows, columns, corner, size, nearest, farthest, max_on_ray, max_at_voxel):
    """(Whether a view has evidence for no, some or all voxels of a block, upper bounds of both kinds of evidence)."""
    half = np.float32(0.5)
    low_z, high_z = np.float32(np.inf), np.float32(-np.inf)
    low_u, high_u, low_v, high_v = low_z, high_z, low_z, high_z
    for p in range(8):
        x = corner[0] + size[0] * np.float32(p & 1)
        y = corner[1] + size[1] * np.float32(p >> 1 & 1)
        w = corner[2] + size[2] * np.float32(p >> 2)
        z = m[2, 0] * x + m[2, 1] * y + m[2, 2] * w + m[2, 3]
        low_z, high_z = min(low_z, z), max(high_z, z)
        if z > np.float32(0.05):
            u = fx * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * w + m[0, 3]) / z + cx + half
            v = fy * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * w + m[1, 3]) / z + cy + half
            low_u, high_u, low_v, high_v = min(low_u, u), max(high_u, u), min(low_v, v), max(high_v, v)
    top_on_ray, top_at_voxel = np.float32(-np.inf), np.float32(-np.inf)
    if high_z <= np.float32(0.05):
        return NO_VOXEL, top_on_ray, top_at_voxel
    behind = low_z <= np.float32(0.051)
    # Margin for single precision: one pixel, and a tenth of a millimetre in depth.
    first_row = 0 if behind else int(min(max(low_v - 1, 0), rows)) // EDGE
    first_column = 0 if behind else int(min(max(low_u - 1, 0), columns)) // EDGE
    last_row = rows - 1 if behind else int(min(max(high_v + 1, -1), rows - 1))
    last_column = columns - 1 if behind else int(min(max(high_u + 1, -1), columns - 1))
    least, most = np.float32(np.inf), np.float32(0)
    if last_row >= 0 and last_column >= 0:
        for a in range(first_row, last_row // EDGE + 1):
            for b in range(first_column, last_column // EDGE + 1):
                least, most = min(least, nearest[a, b]), max(most, farthest[a, b])
                top_on_ray = max(top_on_ray, max_on_ray[a, b])
                top_at_voxel = max(top_at_voxel, max_at_voxel[a, b])
    slack = np.float32(1e-4)
    if low_z - slack >= most:
        return NO_VOXEL, top_on_ray, top_at_voxel
    inside = low_u >= 1 and low_v >= 1 and high_u < columns - 1 and high_v < rows - 1
    if inside and not behind and high_z + slack < least:
        return EACH_VOXEL, top_on_ray, top_at_voxel
    return SOME_VOXELS, max(top_on_ray, np.float32(0)), max(top_at_voxel, np.float32(0))


@kernel
def _add(weight, limit, there, here, total):
    """Add the weighted evidence of the rays that end behind the voxels of a block."""
    for n in range(total.size):
        total[n] += weight * here[n] if there[n] < limit[n] else np.float32(0)


@kernel
def _sees(limit, m, fx, fy, cx, cy, x, y, w):
    """Whether a view has evidence at a point of the world."""
    z = m[2, 0] * x + m[2, 1] * y + m[2, 2] * w + m[2, 3]
    if z <= np.float32(0.05):
        return False
    u = fx * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * w + m[0, 3]) / z + cx + np.float32(0.5)
    v = fy * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * w + m[1, 3]) / z + cy + np.float32(0.5)
    return u >= 0 and v >= 0 and u < limit.shape[1] and v < limit.shape[0] and z < limit[int(v), int(u)]


@kernel(parallel=True)
def sum_evidence(limits, on_ray, at_voxel, weights, motions, fx, fy, cx, cy, nearest, farthest, max_on_ray, max_at_voxel, low, voxel, evidence, extent, seen):  # fmt: skip
    """For every voxel, sum over the views the evidence of the ray through it that ends behind it.

    Blocks of voxels whose upper bound, from the tiles in which they are visible, is not positive are skipped.

    Parameters
    ----------
    limits
        Depth up to which each ray is evidence (n, h, w) [m]; 0: no evidence.
    on_ray, at_voxel
        Evidence of each ray for glass on the ray, and for glass at the voxel rather than beside it (n, h, w) [nat].
    weights
        Weight of each view (n).
    motions
        ``T_camera_world`` (n, 3, 4).
    fx, fy, cx, cy
        Focal lengths and principal point [px].
    nearest, farthest, max_on_ray, max_at_voxel
        Smallest and largest limit [m], and largest evidence of both kinds [nat], of each tile (n, tiles down, tiles across).
    low, voxel
        Lowest corner (3) and edge of a voxel [m].
    evidence, extent
        Sums of both kinds of evidence of each voxel (x, y, z) [nat], filled; the upper bounds where neither can be positive.
    seen
        Sum of the weights at the centre of each block (blocks along x, y, z), filled.
    """
    views, rows, columns = limits.shape
    bx, by, bz = seen.shape
    half, size_n = np.float32(0.5), EDGE * EDGE * EDGE
    camera, offsets, steps = (
        np.empty(4, np.float32),
        np.empty((views, 3, size_n), np.float32),
        np.empty((3, 3), np.float32),
    )
    camera[0], camera[1], camera[2], camera[3] = fx, fy, cx, cy
    for n in range(views):
        for along in range(3):
            for axis in range(3):
                steps[along, axis] = voxel * motions[n, axis, along]
        set_offsets(EDGE, steps, offsets[n])
    for block in prange(bx * by * bz):
        first, stop = np.empty(3, np.int64), np.empty(3, np.int64)
        first[0], first[1], first[2] = block // (by * bz) * EDGE, block // bz % by * EDGE, block % bz * EDGE
        corner, size = np.empty(3, np.float32), np.empty(3, np.float32)
        for axis in range(3):
            stop[axis] = min(first[axis] + EDGE, evidence.shape[axis])
            corner[axis] = low[axis] + voxel * (np.float32(first[axis]) + half)
            size[axis] = voxel * np.float32(stop[axis] - first[axis] - 1)
        x, y, w = corner[0] + half * size[0], corner[1] + half * size[1], corner[2] + half * size[2]
        sight = np.empty(views, np.uint8)
        bound, reach, whole = np.float32(0), np.float32(0), np.float32(0)
        for n in range(views):
            sight[n], most, wide = _block_sight(
                motions[n], fx, fy, cx, cy, rows, columns, corner, size, nearest[n], farthest[n], max_on_ray[n], max_at_voxel[n]
            )  # fmt: skip
            if sight[n] != NO_VOXEL:
                bound += weights[n] * most
                reach += weights[n] * wide
                if sight[n] == EACH_VOXEL or _sees(limits[n], motions[n], fx, fy, cx, cy, x, y, w):
                    whole += weights[n]
        seen[first[0] // EDGE, first[1] // EDGE, first[2] // EDGE] = whole
        summed = bound > 0 or reach > 0
        on, at = np.empty(size_n, np.float32), np.empty(size_n, np.float32)
        for n in range(size_n):
            on[n], at[n] = np.float32(0) if summed else bound, np.float32(0) if summed else reach
        if summed:
            pixels, there = np.empty((2, size_n), np.int32), np.empty(size_n, np.float32)
            limit, here, place = (
                np.empty(size_n, np.float32),
                np.empty(size_n, np.float32),
                np.empty(3, np.float32),
            )
            for n in range(views):
                if sight[n] == NO_VOXEL:
                    continue
                m = motions[n]
                for axis in range(3):
                    place[axis] = (
                        m[axis, 0] * corner[0] + m[axis, 1] * corner[1] + m[axis, 2] * corner[2] + m[axis, 3]
                    )
                project_cube(
                    offsets[n],
                    place,
                    camera,
                    np.float32(rows),
                    np.float32(columns),
                    np.float32(0.05),
                    pixels,
                    there,
                )
                look_up(limits[n], pixels, limit)
                look_up(on_ray[n], pixels, here)
                _add(weights[n], limit, there, here, on)
                look_up(at_voxel[n], pixels, here)
                _add(weights[n], limit, there, here, at)
        scatter(on, EDGE, first, stop, evidence)
        scatter(at, EDGE, first, stop, extent)
