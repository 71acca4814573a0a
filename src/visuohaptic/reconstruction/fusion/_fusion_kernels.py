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
TILE = 8
#: Edge of a brick, and of the cubes into which it is divided near a surface [voxels].
BRICK, CUBE = 8, 4
#: A brick that covers more tiles than this is projected without the range test.
_MAX_TILES = 64

_BEHIND, _FREE, _NEAR = 0, 1, 2
#: Value of a voxel that a view does not observe.
_UNSEEN = -1e9
#: Weight of an observation behind the band: so small that a thousand count less than one within the band.
BEHIND_BAND = 1e-5


@kernel
def tile_ranges(depth, low, high, missing):
    """Smallest and largest depth of each tile, and the number of pixels without depth above and left of each pixel.

    ``missing`` (rows + 1, columns + 1) is an integral image, so that pixels without depth are counted in any rectangle.
    """
    rows, columns = depth.shape
    low[:] = np.float32(np.inf)
    high[:] = np.float32(-np.inf)
    missing[0] = 0
    for v in range(rows):
        i, count = v // TILE, 0
        missing[v + 1, 0] = 0
        for u in range(columns):
            d = depth[v, u]
            if d == d:
                j = u // TILE
                low[i, j] = min(low[i, j], d)
                high[i, j] = max(high[i, j], d)
            else:
                count += 1
            missing[v + 1, u + 1] = missing[v, u + 1] + count


@kernel(error_model="numpy")
def _brick_case(first, stop, corner, steps, camera, depth, low, high, missing, band):
    """Classify a box: behind the observed surface, in free space, or near; and whether a surface may be within the band.

    ``corner`` is its first voxel in the camera frame [m], ``steps`` the edges of a voxel [m].
    """
    fx, fy, cx, cy = camera
    z_min, z_max = np.float32(np.inf), np.float32(-np.inf)
    u_min, u_max = np.float32(np.inf), np.float32(-np.inf)
    v_min, v_max = np.float32(np.inf), np.float32(-np.inf)
    for i in range(8):
        a = np.float32((i & 1) * (stop[0] - first[0] - 1))
        b = np.float32(((i >> 1) & 1) * (stop[1] - first[1] - 1))
        c = np.float32(((i >> 2) & 1) * (stop[2] - first[2] - 1))
        x = corner[0] + a * steps[0, 0] + b * steps[1, 0] + c * steps[2, 0]
        y = corner[1] + a * steps[0, 1] + b * steps[1, 1] + c * steps[2, 1]
        z = corner[2] + a * steps[0, 2] + b * steps[1, 2] + c * steps[2, 2]
        z_min, z_max = min(z_min, z), max(z_max, z)
        if z > np.float32(1e-3):
            u, v = fx * x / z + cx, fy * y / z + cy
            u_min, u_max = min(u_min, u), max(u_max, u)
            v_min, v_max = min(v_min, v), max(v_max, v)
    if z_max <= np.float32(1e-3):
        return _BEHIND, False
    if z_min <= np.float32(1e-3):
        return _NEAR, True
    rows, columns = depth.shape
    # A margin of one pixel covers the rounding of the voxel projections.
    if u_max < -1 or v_max < -1 or u_min > columns or v_min > rows:
        return _BEHIND, False
    inside = u_min >= 1 and v_min >= 1 and u_max <= columns - 2 and v_max <= rows - 2
    u0, u1 = max(int(u_min) - 1, 0), min(int(u_max) + 1, columns - 1)
    v0, v1 = max(int(v_min) - 1, 0), min(int(v_max) + 1, rows - 1)
    j0, j1, i0, i1 = u0 // TILE, u1 // TILE, v0 // TILE, v1 // TILE
    if (i1 - i0 + 1) * (j1 - j0 + 1) > _MAX_TILES:
        return _NEAR, True
    empty = missing[v1 + 1, u1 + 1] - missing[v0, u1 + 1] - missing[v1 + 1, u0] + missing[v0, u0]
    if empty == (v1 + 1 - v0) * (u1 + 1 - u0):
        return _BEHIND, False
    nearest, farthest = np.float32(np.inf), np.float32(-np.inf)
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            nearest, farthest = min(nearest, low[i, j]), max(farthest, high[i, j])
    if z_min > farthest + band:
        return _BEHIND, False
    if inside and empty == 0 and z_max < nearest - band:
        return _FREE, False
    return _NEAR, z_max >= nearest - band


@kernel
def set_offsets(edge, steps, offsets):
    """Fill the offsets (3, edge^3) of the voxels of a cube from its first one, in the camera frame [m]."""
    for n in range(edge * edge * edge):
        i, j, k = np.float32(n // (edge * edge)), np.float32(n // edge % edge), np.float32(n % edge)
        for axis in range(3):
            offsets[axis, n] = i * steps[0, axis] + j * steps[1, axis] + k * steps[2, axis]


# The loops of a cube are functions of their own: only so does the compiler vectorise them (4 times less CPU than one loop).
@kernel(error_model="numpy")
def project_cube(offsets, corner, camera, rows, columns, nearest, pixels, there):
    """Fill the pixels (2, n) and depths [m] of the voxels of a cube; infinite outside the image and nearer than ``nearest``."""
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    x0, y0, z0 = corner[0], corner[1], corner[2]
    one, half, zero = np.float32(1.0), np.float32(0.5), np.float32(0.0)
    for n in range(there.size):
        z = z0 + offsets[2, n]
        inverse = one / z
        u = fx * (x0 + offsets[0, n]) * inverse + cx + half
        v = fy * (y0 + offsets[1, n]) * inverse + cy + half
        inside = (z > nearest) & (u >= zero) & (v >= zero) & (u < columns) & (v < rows)
        pixels[0, n], pixels[1, n] = np.int32(v if inside else zero), np.int32(u if inside else zero)
        there[n] = z if inside else np.float32(np.inf)


@kernel
def look_up(depth, pixels, seen):
    """Fill the depths at some pixels [m]."""
    for n in range(seen.size):
        seen[n] = depth[np.uint32(pixels[0, n]), np.uint32(pixels[1, n])]


@kernel(error_model="numpy")
def _observe(there, band, reach, seen):
    """Replace observed depths by distances in bands, clipped to 1; ``_UNSEEN`` beyond ``reach`` [m] and without depth."""
    one, scale, unseen = np.float32(1.0), np.float32(1.0) / band, np.float32(_UNSEEN)
    for n in range(seen.size):
        gap = seen[n] - there[n]
        seen[n] = min(one, gap * scale) if gap >= -reach else unseen


@kernel(error_model="numpy")
def _average(seen, gain, cap, distance, weight):
    """Average observed distances into voxels."""
    small = gain * np.float32(BEHIND_BAND)
    for n in range(seen.size):
        before, value = weight[n], distance[n]
        used = seen[n] > np.float32(_UNSEEN)
        mass = gain if seen[n] >= np.float32(-1.0) else small
        total = before + mass
        distance[n] = value + (seen[n] - value) * (mass / total) if used else value
        weight[n] = min(total, cap) if used else before


@kernel
def _average_color(seen, pixels, image, gain, edge, first, stop, weight, color):
    """Average the color of voxels within the band; ``weight`` (n) is that before the view."""
    for i in range(stop[0] - first[0]):
        for j in range(stop[1] - first[1]):
            for k in range(stop[2] - first[2]):
                n = (i * edge + j) * edge + k
                if np.float32(-1.0) <= seen[n] < np.float32(1.0):
                    fraction = gain / (weight[n] + gain)
                    for channel in range(3):
                        value = np.float32(image[pixels[0, n], pixels[1, n], channel])
                        old = color[first[0] + i, first[1] + j, first[2] + k, channel]
                        color[first[0] + i, first[1] + j, first[2] + k, channel] = (
                            old + (value - old) * fraction
                        )


@kernel
def _gather(values, edge, first, stop, cube):
    """Copy the values from ``first`` to ``stop`` of a grid to a cube (edge^3)."""
    a, b, c = np.uint64(first[0]), np.uint64(first[1]), np.uint64(first[2])
    x, y, z = np.uint64(stop[0]) - a, np.uint64(stop[1]) - b, np.uint64(stop[2]) - c
    side = np.uint64(edge)
    for i in range(x):
        for j in range(y):
            for k in range(z):
                cube[(i * side + j) * side + k] = values[a + i, b + j, c + k]


@kernel
def scatter(cube, edge, first, stop, values):
    """Copy a cube (edge^3) to the values from ``first`` to ``stop`` of a grid."""
    a, b, c = np.uint64(first[0]), np.uint64(first[1]), np.uint64(first[2])
    x, y, z = np.uint64(stop[0]) - a, np.uint64(stop[1]) - b, np.uint64(stop[2]) - c
    side = np.uint64(edge)
    for i in range(x):
        for j in range(y):
            for k in range(z):
                values[a + i, b + j, c + k] = cube[(i * side + j) * side + k]


@kernel
def _buffers(edge, steps):
    """Offsets of the voxels of a cube (3, n), and buffers of their pixels (2, n), depths, observations, distances and weights."""
    n = edge * edge * edge
    offsets, pixels = np.empty((3, n), np.float32), np.empty((2, n), np.int32)
    set_offsets(edge, steps, offsets)
    there, seen = np.empty(n, np.float32), np.empty(n, np.float32)
    near, mass = np.zeros(n, np.float32), np.zeros(n, np.float32)
    return offsets, pixels, there, seen, near, mass


@kernel
def _fuse_cube(distance, weight, color, use_color, edge, first, stop, corner, view, buffers):
    """Project the voxels of a cube from ``first`` to ``stop`` and average their observations.

    ``view``: intrinsics, depth, image, half width of the band, reach behind surfaces, weight of the view, maximum weight.
    """
    camera, depth, image, band, reach, gain, cap = view
    offsets, pixels, there, seen, near, mass = buffers
    rows, columns = np.float32(depth.shape[0]), np.float32(depth.shape[1])
    project_cube(offsets, corner, camera, rows, columns, np.float32(1e-3), pixels, there)
    look_up(depth, pixels, seen)
    _observe(there, band, reach, seen)
    _gather(distance, edge, first, stop, near)
    _gather(weight, edge, first, stop, mass)
    if use_color:
        _average_color(seen, pixels, image, gain, edge, first, stop, mass, color)
    _average(seen, gain, cap, near, mass)
    scatter(near, edge, first, stop, distance)
    scatter(mass, edge, first, stop, weight)


@kernel
def _set_box(first, edge, origin, steps, shape, corner, stop):
    """Fill the last voxels plus one of a box of ``edge`` voxels in a grid, and its first voxel in the camera frame [m]."""
    for axis in range(3):
        stop[axis] = min(first[axis] + edge, shape[axis])
        corner[axis] = (
            origin[axis]
            + np.float32(first[0]) * steps[0, axis]
            + np.float32(first[1]) * steps[1, axis]
            + np.float32(first[2]) * steps[2, axis]
        )


@kernel
def mark_surface(marked, shape, origin, steps, camera, depth, low, high, missing, band):
    """Set ``marked`` (cubes along x, y, z) where a view may see a surface within ``band`` [m] of a cube of a dense grid."""
    first, stop, corner = np.zeros(3, np.int64), np.zeros(3, np.int64), np.zeros(3, np.float32)
    for i in range(0, shape[0], BRICK):
        for j in range(0, shape[1], BRICK):
            for k in range(0, shape[2], BRICK):
                first[0], first[1], first[2] = i, j, k
                _set_box(first, BRICK, origin, steps, shape, corner, stop)
                _, near = _brick_case(first, stop, corner, steps, camera, depth, low, high, missing, band)
                if not near:
                    continue
                for a in range(i // CUBE, min((i + BRICK) // CUBE, marked.shape[0])):
                    for b in range(j // CUBE, min((j + BRICK) // CUBE, marked.shape[1])):
                        for c in range(k // CUBE, min((k + BRICK) // CUBE, marked.shape[2])):
                            if marked[a, b, c] == 0:
                                first[0], first[1], first[2] = a * CUBE, b * CUBE, c * CUBE
                                _set_box(first, CUBE, origin, steps, shape, corner, stop)
                                _, near = _brick_case(
                                    first, stop, corner, steps, camera, depth, low, high, missing, band
                                )
                                if near:
                                    marked[a, b, c] = 1


@kernel(error_model="numpy")
def _fuse_free(distance, weight, first, stop, gain, cap):
    """Average an observation of free space into the voxels of a box."""
    for i in range(first[0], stop[0]):
        for j in range(first[1], stop[1]):
            for k in range(first[2], stop[2]):
                total = weight[i, j, k] + gain
                value = distance[i, j, k]
                distance[i, j, k] = value + (np.float32(1.0) - value) * (gain / total)
                weight[i, j, k] = min(total, cap)


@kernel
def fuse_dense(distance, weight, color, use_color, marked, origin, steps, camera, depth, image, low, high, missing, band, reach, gain, cap):  # fmt: skip
    """Integrate a view into the marked cubes of a dense grid; ``origin`` is its first voxel in the camera frame [m]."""
    shape, view = distance.shape, (camera, depth, image, band, reach, gain, cap)
    first, stop, corner = np.zeros(3, np.int64), np.zeros(3, np.int64), np.zeros(3, np.float32)
    buffers = _buffers(CUBE, steps)
    for brick in range(_bricks(shape[0]) * _bricks(shape[1]) * _bricks(shape[2])):
        i = brick // (_bricks(shape[1]) * _bricks(shape[2])) * BRICK
        j, k = brick // _bricks(shape[2]) % _bricks(shape[1]) * BRICK, brick % _bricks(shape[2]) * BRICK
        some = False
        for a in range(i // CUBE, min((i + BRICK) // CUBE, marked.shape[0])):
            for b in range(j // CUBE, min((j + BRICK) // CUBE, marked.shape[1])):
                for c in range(k // CUBE, min((k + BRICK) // CUBE, marked.shape[2])):
                    some = some or marked[a, b, c] != 0
        if not some:
            continue
        first[0], first[1], first[2] = i, j, k
        _set_box(first, BRICK, origin, steps, shape, corner, stop)
        whole, _ = _brick_case(first, stop, corner, steps, camera, depth, low, high, missing, reach)
        if whole == _BEHIND:
            continue
        for a in range(i, min(i + BRICK, shape[0]), CUBE):
            for b in range(j, min(j + BRICK, shape[1]), CUBE):
                for c in range(k, min(k + BRICK, shape[2]), CUBE):
                    if marked[a // CUBE, b // CUBE, c // CUBE] == 0:
                        continue
                    first[0], first[1], first[2] = a, b, c
                    _set_box(first, CUBE, origin, steps, shape, corner, stop)
                    case = whole
                    if case == _NEAR:
                        case, _ = _brick_case(
                            first, stop, corner, steps, camera, depth, low, high, missing, reach
                        )
                    if case == _FREE:
                        _fuse_free(distance, weight, first, stop, gain, cap)
                    elif case == _NEAR:
                        _fuse_cube(
                            distance, weight, color, use_color, CUBE, first, stop, corner, view, buffers
                        )


@kernel
def _bricks(size):
    """Number of bricks along an edge of a grid."""
    return (size + BRICK - 1) // BRICK


@kernel
def fuse_bricks(distance, weight, color, use_color, bricks, chosen, origin, steps, camera, depth, image, band, reach, gain, cap):  # fmt: skip
    """Integrate a view into chosen bricks of a sparse grid; ``bricks`` are integer positions, ``origin`` as in :func:`fuse_dense`."""
    view = (camera, depth, image, band, reach, gain, cap)
    corner, first, stop = np.zeros(3, np.float32), np.zeros(3, np.int64), np.full(3, BRICK, np.int64)
    buffers = _buffers(BRICK, steps)
    for q in range(chosen.size):
        b = chosen[q]
        for axis in range(3):
            corner[axis] = origin[axis]
            for edge in range(3):
                corner[axis] += np.float32(bricks[b, edge] * BRICK) * steps[edge, axis]
        _fuse_cube(distance[b], weight[b], color[b], use_color, BRICK, first, stop, corner, view, buffers)


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
