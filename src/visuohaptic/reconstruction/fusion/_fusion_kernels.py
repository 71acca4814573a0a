"""Kernels of :mod:`.fusion`: integration of a depth image into a grid of truncated signed distances.

The grid is processed in bricks. A brick entirely behind the observed surface is
skipped, one entirely in front is free space and needs no projection; only
bricks near the surface are projected voxel by voxel. All arithmetic is
float32: an int times a float32 would silently become float64.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel

#: Edge of a tile of the depth image for which the range of depths is stored [px].
TILE = 16
#: Edge of a brick [voxels].
BRICK = 8
#: A brick that covers more tiles than this is projected without the range test.
_MAX_TILES = 64

_BEHIND, _FREE, _NEAR = 0, 1, 2


@kernel
def tile_ranges(depth, low, high, holes):
    """Smallest and largest depth of each tile, and whether it has a pixel without depth."""
    rows, columns = depth.shape
    low[:] = np.float32(np.inf)
    high[:] = np.float32(-np.inf)
    holes[:] = 0
    for v in range(rows):
        for u in range(columns):
            d = depth[v, u]
            i, j = v // TILE, u // TILE
            if d == d:
                low[i, j] = min(low[i, j], d)
                high[i, j] = max(high[i, j], d)
            else:
                holes[i, j] = 1


@kernel
def _brick_case(corner, steps, size, camera, depth, low, high, holes, band):
    """Classify a brick: behind the observed surface, in free space, or near the surface.

    ``corner`` is its first voxel in the camera frame [m], ``steps`` its edges [m].
    """
    fx, fy, cx, cy = camera
    z_min, z_max = np.float32(np.inf), np.float32(-np.inf)
    u_min, u_max = np.float32(np.inf), np.float32(-np.inf)
    v_min, v_max = np.float32(np.inf), np.float32(-np.inf)
    for i in range(8):
        a = np.float32((i & 1) * (size[0] - 1))
        b = np.float32(((i >> 1) & 1) * (size[1] - 1))
        c = np.float32(((i >> 2) & 1) * (size[2] - 1))
        x = corner[0] + a * steps[0, 0] + b * steps[1, 0] + c * steps[2, 0]
        y = corner[1] + a * steps[0, 1] + b * steps[1, 1] + c * steps[2, 1]
        z = corner[2] + a * steps[0, 2] + b * steps[1, 2] + c * steps[2, 2]
        z_min, z_max = min(z_min, z), max(z_max, z)
        if z > np.float32(1e-3):
            u, v = fx * x / z + cx, fy * y / z + cy
            u_min, u_max = min(u_min, u), max(u_max, u)
            v_min, v_max = min(v_min, v), max(v_max, v)
    if z_max <= np.float32(1e-3):
        return _BEHIND
    if z_min <= np.float32(1e-3):
        return _NEAR
    rows, columns = depth.shape
    # A margin of one pixel covers the rounding of the voxel projections.
    if u_max < -1 or v_max < -1 or u_min > columns or v_min > rows:
        return _BEHIND
    inside = u_min >= 1 and v_min >= 1 and u_max <= columns - 2 and v_max <= rows - 2
    j0, j1 = max(int(u_min) - 1, 0) // TILE, min(int(u_max) + 1, columns - 1) // TILE
    i0, i1 = max(int(v_min) - 1, 0) // TILE, min(int(v_max) + 1, rows - 1) // TILE
    if (i1 - i0 + 1) * (j1 - j0 + 1) > _MAX_TILES:
        return _NEAR
    nearest, farthest, hole = np.float32(np.inf), np.float32(-np.inf), False
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            nearest, farthest = min(nearest, low[i, j]), max(farthest, high[i, j])
            hole = hole or holes[i, j] != 0
    if z_min > farthest + band:
        return _BEHIND
    if inside and not hole and z_max < nearest - band:
        return _FREE
    return _NEAR


@kernel
def fuse_brick(distance, weight, color, use_color, start, stop, corner, steps, view):
    """Project the voxels from ``start`` to ``stop`` and average their observations.

    ``view``: intrinsics, depth, image, half width of the band, weight of the view, maximum weight.
    """
    camera, depth, image, band, gain, cap = view
    fx, fy, cx, cy = camera
    rows, columns = depth.shape
    one = np.float32(1.0)
    half = np.float32(0.5)
    scale = one / band
    for i in range(start[0], stop[0]):
        a = np.float32(i - start[0])
        for j in range(start[1], stop[1]):
            b = np.float32(j - start[1])
            x0 = corner[0] + a * steps[0, 0] + b * steps[1, 0]
            y0 = corner[1] + a * steps[0, 1] + b * steps[1, 1]
            z0 = corner[2] + a * steps[0, 2] + b * steps[1, 2]
            for k in range(start[2], stop[2]):
                c = np.float32(k - start[2])
                z = z0 + c * steps[2, 2]
                if z <= np.float32(1e-3):
                    continue
                inverse = one / z
                u = fx * (x0 + c * steps[2, 0]) * inverse + cx + half
                v = fy * (y0 + c * steps[2, 1]) * inverse + cy + half
                if not (u >= 0 and v >= 0 and u < columns and v < rows):
                    continue
                column, row = int(u), int(v)
                d = depth[row, column]
                gap = d - z
                if not gap >= -band:  # also true for NaN
                    continue
                value = min(one, gap * scale)
                old = weight[i, j, k]
                total = old + gain
                distance[i, j, k] += (value - distance[i, j, k]) * (gain / total)
                if use_color and gap <= band:
                    fraction = gain / total
                    for channel in range(3):
                        seen = np.float32(image[row, column, channel])
                        color[i, j, k, channel] += (seen - color[i, j, k, channel]) * fraction
                weight[i, j, k] = min(total, cap)


@kernel
def fuse_dense(distance, weight, color, use_color, origin, steps, camera, depth, image, low, high, holes, band, gain, cap):  # fmt: skip
    """Integrate a view into all bricks of a dense grid; ``origin`` is its first voxel in the camera frame [m]."""
    shape = distance.shape
    view = (camera, depth, image, band, gain, cap)
    corner = np.zeros(3, np.float32)
    one = np.float32(1.0)
    start = np.zeros(3, np.int64)
    stop = np.zeros(3, np.int64)
    size = np.zeros(3, np.int64)
    for i0 in range(0, shape[0], BRICK):
        for j0 in range(0, shape[1], BRICK):
            for k0 in range(0, shape[2], BRICK):
                start[0], start[1], start[2] = i0, j0, k0
                for axis in range(3):
                    stop[axis] = min(start[axis] + BRICK, shape[axis])
                    size[axis] = stop[axis] - start[axis]
                    corner[axis] = (
                        origin[axis]
                        + np.float32(i0) * steps[0, axis]
                        + np.float32(j0) * steps[1, axis]
                        + np.float32(k0) * steps[2, axis]
                    )
                case = _brick_case(corner, steps, size, camera, depth, low, high, holes, band)
                if case == _FREE:
                    for i in range(start[0], stop[0]):
                        for j in range(start[1], stop[1]):
                            for k in range(start[2], stop[2]):
                                total = weight[i, j, k] + gain
                                value = distance[i, j, k]
                                distance[i, j, k] = value + (one - value) * (gain / total)
                                weight[i, j, k] = min(total, cap)
                elif case == _NEAR:
                    fuse_brick(distance, weight, color, use_color, start, stop, corner, steps, view)


@kernel
def fuse_bricks(distance, weight, color, use_color, bricks, chosen, origin, steps, camera, depth, image, band, gain, cap):  # fmt: skip
    """Integrate a view into chosen bricks of a sparse grid; ``bricks`` are integer positions, ``origin`` as in :func:`fuse_dense`."""
    view = (camera, depth, image, band, gain, cap)
    corner = np.zeros(3, np.float32)
    start = np.zeros(3, np.int64)
    stop = np.full(3, BRICK, np.int64)
    for n in range(chosen.size):
        b = chosen[n]
        for axis in range(3):
            corner[axis] = origin[axis]
            for edge in range(3):
                corner[axis] += np.float32(bricks[b, edge] * BRICK) * steps[edge, axis]
        fuse_brick(distance[b], weight[b], color[b], use_color, start, stop, corner, steps, view)


@kernel
def active_cells(distance, weight, least, places):
    """Find bricks with cells that the surface crosses; returns their number, ``places`` is filled.

    A brick contains the cells between its voxels and the first voxels of the next brick.
    """
    shape = distance.shape
    count = 0
    for i0 in range(0, shape[0] - 1, BRICK):
        for j0 in range(0, shape[1] - 1, BRICK):
            for k0 in range(0, shape[2] - 1, BRICK):
                below = above = False
                for i in range(i0, min(i0 + BRICK + 1, shape[0])):
                    for j in range(j0, min(j0 + BRICK + 1, shape[1])):
                        for k in range(k0, min(k0 + BRICK + 1, shape[2])):
                            if weight[i, j, k] >= least:
                                value = distance[i, j, k]
                                below = below or value <= 0
                                above = above or value > 0
                    if below and above:
                        break
                if below and above:
                    places[count, 0], places[count, 1], places[count, 2] = i0, j0, k0
                    count += 1
    return count


@kernel
def gather_cells(distance, weight, least, places, side, tiled, known):
    """Copy each brick with its upper neighbours into the tile array; unobserved voxels stay unknown."""
    shape = distance.shape
    edge = BRICK + 1
    for n in range(places.shape[0]):
        a, b, c = n // (side * side) * edge, n // side % side * edge, n % side * edge
        for i in range(edge):
            for j in range(edge):
                for k in range(edge):
                    x, y, z = places[n, 0] + i, places[n, 1] + j, places[n, 2] + k
                    inside = x < shape[0] and y < shape[1] and z < shape[2]
                    if inside and weight[x, y, z] >= least:
                        tiled[a + i, b + j, c + k] = distance[x, y, z]
                        known[a + i, b + j, c + k] = True
