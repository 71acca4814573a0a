"""Kernels of :mod:`.fusion`: integration of a depth image into bricks of truncated signed distances.

Each brick is stored cube by cube. A cube entirely behind the observed surface is skipped, one entirely in front is free space and needs
no projection; only cubes near the surface are projected voxel by voxel. All arithmetic is float32: an int times a float32 would
silently become float64.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel

#: Edge of a tile of the depth image for which the range of depths is stored [px].
TILE = 8
#: Edge of a block of bricks in which surfaces are searched first, of a brick, and of the cubes of a brick [voxels].
BLOCK, BRICK, CUBE = 64, 8, 4
#: A box that covers more tiles than this is projected without the range test.
_MAX_TILES = 64

_BEHIND, _FREE, _NEAR = 0, 1, 2
#: Value of a voxel that a view does not observe.
_UNSEEN = -1e9
#: Weight of an observation behind the band: so small that a thousand count less than one within the band.
BEHIND_BAND = 1e-5
#: Upper bound of the weight of a voxel, so that the volume adapts to a changing scene.
MAX_WEIGHT = 64.0


@kernel(error_model="numpy")
def _case(edge, corner, steps, camera, depth, low, high, missing, band):
    """Classify a box: behind the observed surface, in free space, or near; and whether a surface may be within the band.

    ``corner`` is its first voxel in the camera frame [m], ``steps`` the edges of a voxel [m], ``edge`` its edge [voxels].
    """
    fx, fy, cx, cy = camera
    last = np.float32(edge - 1)
    z_min, z_max = np.float32(np.inf), np.float32(-np.inf)
    u_min, u_max = np.float32(np.inf), np.float32(-np.inf)
    v_min, v_max = np.float32(np.inf), np.float32(-np.inf)
    for i in range(8):
        a, b, c = np.float32(i & 1) * last, np.float32((i >> 1) & 1) * last, np.float32((i >> 2) & 1) * last
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
def _average(seen, distance, weight):
    """Average observed distances into voxels."""
    one, small, cap = np.float32(1.0), np.float32(BEHIND_BAND), np.float32(MAX_WEIGHT)
    for n in range(seen.size):
        before, value = weight[n], distance[n]
        used = seen[n] > np.float32(_UNSEEN)
        mass = one if seen[n] >= np.float32(-1.0) else small
        total = before + mass
        distance[n] = value + (seen[n] - value) * (mass / total) if used else value
        weight[n] = min(total, cap) if used else before


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


@kernel(error_model="numpy")
def _average_free(distance, weight):
    """Average an observation of free space into voxels."""
    one, cap = np.float32(1.0), np.float32(MAX_WEIGHT)
    for n in range(weight.size):
        total = weight[n] + one
        distance[n] += (one - distance[n]) / total
        weight[n] = min(total, cap)


@kernel
def _average_color(seen, pixels, image, weight, color):
    """Average the color of voxels within the band; ``weight`` is that before the view."""
    for n in range(seen.size):
        if np.float32(-1.0) <= seen[n] < np.float32(1.0):
            fraction = np.float32(1.0) / (weight[n] + np.float32(1.0))
            for channel in range(3):
                value = np.float32(image[pixels[0, n], pixels[1, n], channel])
                color[n, channel] += (value - color[n, channel]) * fraction


@kernel
def _set_corner(i, j, k, origin, steps, corner):
    """Fill the place of a voxel in the camera frame [m]."""
    a, b, c = np.float32(i), np.float32(j), np.float32(k)
    for axis in range(3):
        corner[axis] = origin[axis] + a * steps[0, axis] + b * steps[1, axis] + c * steps[2, axis]


@kernel
def mark_bricks(marked, first, origin, steps, camera, depth, low, high, missing, band):
    """Set ``marked`` (bricks along x, y, z, from the brick ``first``) where a view may see a surface within ``band`` [m]."""
    corner, many = np.zeros(3, np.float32), BLOCK // BRICK
    nx, ny, nz = marked.shape
    for i in range(0, nx, many):
        for j in range(0, ny, many):
            for k in range(0, nz, many):
                x, y, z = (first[0] + i) * BRICK, (first[1] + j) * BRICK, (first[2] + k) * BRICK
                _set_corner(x, y, z, origin, steps, corner)
                _, near = _case(BLOCK, corner, steps, camera, depth, low, high, missing, band)
                if not near:
                    continue
                for a in range(i, min(i + many, nx)):
                    for b in range(j, min(j + many, ny)):
                        for c in range(k, min(k + many, nz)):
                            if marked[a, b, c]:
                                continue
                            x, y, z = (first[0] + a) * BRICK, (first[1] + b) * BRICK, (first[2] + c) * BRICK
                            _set_corner(x, y, z, origin, steps, corner)
                            _, near = _case(BRICK, corner, steps, camera, depth, low, high, missing, band)
                            marked[a, b, c] = near


@kernel
def fuse_bricks(distance, weight, color, use_color, places, origin, steps, camera, depth, image, low, high, missing, band, reach):  # fmt: skip
    """Integrate a view into bricks, stored as (brick, cube, voxel of the cube).

    ``places`` are the indices of the bricks; ``origin`` is voxel 0 in the camera frame [m].
    """
    rows, columns = np.float32(depth.shape[0]), np.float32(depth.shape[1])
    voxels, half = CUBE * CUBE * CUBE, BRICK // CUBE
    corner = np.zeros(3, np.float32)
    offsets, pixels = np.empty((3, voxels), np.float32), np.empty((2, voxels), np.int32)
    there, seen = np.empty(voxels, np.float32), np.empty(voxels, np.float32)
    set_offsets(CUBE, steps, offsets)
    for q in range(places.shape[0]):
        x, y, z = places[q, 0] * BRICK, places[q, 1] * BRICK, places[q, 2] * BRICK
        _set_corner(x, y, z, origin, steps, corner)
        whole, _ = _case(BRICK, corner, steps, camera, depth, low, high, missing, reach)
        if whole == _BEHIND:
            continue
        for n in range(half * half * half):
            case = whole
            if whole == _NEAR:
                a, b, c = n // (half * half) * CUBE, n // half % half * CUBE, n % half * CUBE
                _set_corner(x + a, y + b, z + c, origin, steps, corner)
                case, _ = _case(CUBE, corner, steps, camera, depth, low, high, missing, reach)
            if case == _FREE:
                _average_free(distance[q, n], weight[q, n])
            elif case == _NEAR:
                project_cube(offsets, corner, camera, rows, columns, np.float32(1e-3), pixels, there)
                look_up(depth, pixels, seen)
                _observe(there, band, reach, seen)
                if use_color:
                    _average_color(seen, pixels, image, weight[q, n], color[q, n])
                _average(seen, distance[q, n], weight[q, n])
