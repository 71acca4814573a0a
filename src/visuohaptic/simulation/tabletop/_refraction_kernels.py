"""Ray tracing through glass, liquid and mirrors to the first diffuse surface; exact quadrics, no facets.

Layouts of the arrays (built by :mod:`.refraction`):

``solids`` (n, 10): x, y, z, cos yaw, sin yaw, squash, bounding radius, bounding height, first, last segment
``segments`` (m, 14): r0, z0, r1, z1 (profile), nr0, nz0, nr1, nz1 (unit normals at both ends), n ahead of and
behind the normal, kind (0 refracts, 1 diffuse, 2 mirror), first angle, width of the arc, albedo
``boxes`` (k, 12): x, y, z, cos yaw, sin yaw, half sizes (3), kind, n inside, albedo, unused
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from ...core.kernels import kernel

_MAX_INTERFACES = 16


@kernel(inline="always")
def _segment_hit(segments, s, px, py, pz, dx, dy, dz, t_min, t_best):
    """Nearest intersection with one ring of the profile beyond ``t_min``, or ``t_best``."""
    r0, z0, r1, z1 = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
    first, width = segments[s, 11], segments[s, 12]
    if abs(z1 - z0) < 1e-9:
        if abs(dz) < 1e-12:
            return t_best
        t = (z0 - pz) / dz
        if t <= t_min or t >= t_best:
            return t_best
        radius = math.hypot(px + t * dx, py + t * dy)
        if min(r0, r1) <= radius <= max(r0, r1):
            return t
        return t_best
    low, high = min(z0, z1), max(z0, z1)
    k = (r1 - r0) / (z1 - z0)
    here = r0 + k * (pz - z0)
    a = dx * dx + dy * dy - k * k * dz * dz
    b = px * dx + py * dy - k * dz * here
    c = px * px + py * py - here * here
    if abs(a) < 1e-14:
        return t_best
    root = b * b - a * c
    if root < 0.0:
        return t_best
    root = math.sqrt(root)
    for sign in (-1.0, 1.0):
        t = (-b + sign * root) / a
        if t <= t_min or t >= t_best:
            continue
        z = pz + t * dz
        if z < low or z > high or r0 + k * (z - z0) < 0.0:
            continue
        if width < math.tau:
            angle = (math.atan2(py + t * dy, px + t * dx) - first) % math.tau
            if angle > width:
                continue
        t_best = t
    return t_best


@kernel
def _nearest(origin, direction, solids, segments, boxes, t_min):
    """(t, solid, segment, box): the nearest surface of any kind; unused indices are -1."""
    t_best, best_solid, best_segment, best_box = 1e9, -1, -1, -1
    for i in range(len(solids)):
        c, s, squash = solids[i, 3], solids[i, 4], solids[i, 5]
        ox, oy = origin[0] - solids[i, 0], origin[1] - solids[i, 1]
        pz = origin[2] - solids[i, 2]
        px, py = (c * ox + s * oy) / squash, -s * ox + c * oy
        dx, dy = (c * direction[0] + s * direction[1]) / squash, -s * direction[0] + c * direction[1]
        dz = direction[2]
        # The upright bounding cylinder: does the ray pass close enough to its axis, and within its heights?
        flat = dx * dx + dy * dy
        radius = solids[i, 6]
        z_low, z_high = -1e9, 1e9
        if flat < 1e-14:
            if px * px + py * py > radius * radius:
                continue
        else:
            middle = -(px * dx + py * dy) / flat
            reach = radius * radius - (px + middle * dx) ** 2 - (py + middle * dy) ** 2
            if reach < 0.0:
                continue
            reach = math.sqrt(reach / flat)
            enter, leave = middle - reach, middle + reach
            if leave < 0.0 or enter > t_best:
                continue
            z_enter, z_leave = pz + max(enter, t_min) * dz, pz + min(leave, t_best) * dz
            z_low, z_high = min(z_enter, z_leave) - 1e-6, max(z_enter, z_leave) + 1e-6
            if z_high < 0.0 or z_low > solids[i, 7]:
                continue
        for segment in range(int(solids[i, 8]), int(solids[i, 9])):
            # Most rings are above or below the part of the ray that is in the cylinder.
            z0, z1 = segments[segment, 1], segments[segment, 3]
            if (z0 < z_low and z1 < z_low) or (z0 > z_high and z1 > z_high):
                continue
            t = _segment_hit(segments, segment, px, py, pz, dx, dy, dz, t_min, t_best)
            if t < t_best:
                t_best, best_solid, best_segment = t, i, segment
    for i in range(len(boxes)):
        c, s = boxes[i, 3], boxes[i, 4]
        ox, oy, pz = origin[0] - boxes[i, 0], origin[1] - boxes[i, 1], origin[2] - boxes[i, 2]
        px, py = c * ox + s * oy, -s * ox + c * oy
        dx, dy = c * direction[0] + s * direction[1], -s * direction[0] + c * direction[1]
        enter, leave = -1e9, 1e9
        for axis in range(3):
            p = px if axis == 0 else (py if axis == 1 else pz)
            d = dx if axis == 0 else (dy if axis == 1 else direction[2])
            half = boxes[i, 5 + axis]
            if abs(d) < 1e-14:
                if abs(p) > half:
                    enter = 1e9
                continue
            near, far = (-half - p) / d, (half - p) / d
            if near > far:
                near, far = far, near
            enter, leave = max(enter, near), min(leave, far)
        if enter > leave:
            continue
        t = enter if enter > t_min else leave
        if t_min < t < t_best:
            t_best, best_solid, best_segment, best_box = t, -1, -1, i
    return t_best, best_solid, best_segment, best_box


@kernel
def _normal(point, solid, segment, box, solids, segments, boxes, normal):
    """Unit normal of the surface at a point; of a solid, on the side that its profile calls ahead."""
    if box >= 0:
        c, s = boxes[box, 3], boxes[box, 4]
        ox, oy, pz = point[0] - boxes[box, 0], point[1] - boxes[box, 1], point[2] - boxes[box, 2]
        px, py = c * ox + s * oy, -s * ox + c * oy
        ax, ay, az = abs(px) / boxes[box, 5], abs(py) / boxes[box, 6], abs(pz) / boxes[box, 7]
        nx = ny = nz = 0.0
        if ax >= ay and ax >= az:
            nx = math.copysign(1.0, px)
        elif ay >= az:
            ny = math.copysign(1.0, py)
        else:
            nz = math.copysign(1.0, pz)
    else:
        c, s, squash = solids[solid, 3], solids[solid, 4], solids[solid, 5]
        ox, oy, pz = point[0] - solids[solid, 0], point[1] - solids[solid, 1], point[2] - solids[solid, 2]
        px, py = (c * ox + s * oy) / squash, -s * ox + c * oy
        r0, z0, r1, z1 = (
            segments[segment, 0],
            segments[segment, 1],
            segments[segment, 2],
            segments[segment, 3],
        )
        radius = math.hypot(px, py)
        length = (r1 - r0) ** 2 + (z1 - z0) ** 2
        along = ((radius - r0) * (r1 - r0) + (pz - z0) * (z1 - z0)) / length
        along = min(1.0, max(0.0, along))
        nr = segments[segment, 4] * (1.0 - along) + segments[segment, 6] * along
        nz = segments[segment, 5] * (1.0 - along) + segments[segment, 7] * along
        if radius < 1e-12:
            nx = ny = 0.0
        else:
            nx, ny = nr * px / radius / squash, nr * py / radius
    size = math.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny = nx / size, ny / size
    normal[0], normal[1], normal[2] = c * nx - s * ny, s * nx + c * ny, nz / size


@kernel
def _trace(origin, direction, solids, segments, boxes, found, scratch):
    """Trace one ray to a diffuse surface.

    ``found``: x, y, z, transmitted fraction, cosine at the surface, albedo, interfaces passed, then of the first
    interface: distance and normal. Returns 1 where a diffuse surface was reached.
    """
    o, d, normal = scratch[0], scratch[1], scratch[2]
    for axis in range(3):
        o[axis], d[axis] = origin[axis], direction[axis]
    fraction = 1.0
    found[7] = -1.0
    t_min = 0.0
    for passed in range(_MAX_INTERFACES):
        t, solid, segment, box = _nearest(o, d, solids, segments, boxes, t_min)
        if t >= 1e9:
            return 0
        for axis in range(3):
            o[axis] += t * d[axis]
        _normal(o, solid, segment, box, solids, segments, boxes, normal)
        cosine = -(d[0] * normal[0] + d[1] * normal[1] + d[2] * normal[2])
        if box >= 0:
            kind, ahead, behind, albedo = boxes[box, 8], 1.0, boxes[box, 9], boxes[box, 10]
        else:
            kind, ahead, behind = segments[segment, 10], segments[segment, 8], segments[segment, 9]
            albedo = segments[segment, 13]
        if kind == 1.0:
            found[0], found[1], found[2] = o[0], o[1], o[2]
            found[3], found[4], found[5], found[6] = fraction, abs(cosine), albedo, passed
            return 1
        if passed == 0:
            found[7] = t
            flip = 1.0 if cosine > 0.0 else -1.0
            for axis in range(3):
                found[8 + axis] = flip * normal[axis]
        t_min = 1e-7
        if kind == 2.0:
            for axis in range(3):
                d[axis] += 2.0 * cosine * normal[axis]
            fraction *= 0.9
            continue
        n_from, n_to = ahead, behind
        if cosine < 0.0:
            n_from, n_to, cosine = behind, ahead, -cosine
            for axis in range(3):
                normal[axis] = -normal[axis]
        ratio = n_from / n_to
        sine2 = ratio * ratio * (1.0 - cosine * cosine)
        if sine2 >= 1.0:  # total reflection
            for axis in range(3):
                d[axis] += 2.0 * cosine * normal[axis]
            continue
        out = math.sqrt(1.0 - sine2)
        across = (n_from * cosine - n_to * out) / (n_from * cosine + n_to * out)
        along = (n_from * out - n_to * cosine) / (n_from * out + n_to * cosine)
        fraction *= 1.0 - 0.5 * (across * across + along * along)
        for axis in range(3):
            d[axis] = ratio * d[axis] + (ratio * cosine - out) * normal[axis]
    return 0


@kernel(parallel=True)
def trace_rays(origin, rotation, slopes_x, slopes_y, solids, segments, boxes):
    """Rays of an ideal view, pixel (i, j) along R (slopes_x[j], slopes_y[i], 1).

    Returns ``hit`` (h, w) and ``found`` (h, w, 11), see :func:`_trace`; points in the world.

    Parameters
    ----------
    origin, rotation
        Centre (3) [m] and rotation (3, 3) of the view in the world.
    slopes_x, slopes_y
        Slopes of the rays of the columns (w) and rows (h).
    solids, segments, boxes
        Scene, see :class:`~visuohaptic.simulation.tabletop.refraction.RefractingScene`.
    """
    rows, columns = len(slopes_y), len(slopes_x)
    hit = np.zeros((rows, columns), np.uint8)
    found = np.zeros((rows, columns, 11))
    for i in prange(rows):
        scratch = np.empty((3, 3))
        direction = np.empty(3)
        for j in range(columns):
            length = math.sqrt(slopes_x[j] ** 2 + slopes_y[i] ** 2 + 1.0)
            for axis in range(3):
                direction[axis] = (
                    rotation[axis, 0] * slopes_x[j] + rotation[axis, 1] * slopes_y[i] + rotation[axis, 2]
                ) / length
            hit[i, j] = _trace(origin, direction, solids, segments, boxes, found[i, j], scratch)
    return hit, found


@kernel
def pattern_map(hit, found, rotation, origin, focal_x, focal_y, first_x, centre_y):
    """Landing points of the projector's pixels in its pinhole image, and the owner of each cell.

    Returns ``landing`` (h, w, 2), NaN without a landing, ``bright`` (h, w), the irradiance of each projector
    pixel there (1 = undisturbed), ``owner`` (h, w), the brightest projector pixel (row * w + column) that
    lands in a cell or -1, and ``mixed`` (h, w), 1 where a second, displaced part of the pattern with at least half
    the brightness lands on it.

    Parameters
    ----------
    hit, found
        Result of :func:`trace_rays` from the projector.
    rotation, origin
        Rotation (3, 3) and centre (3) [m] of the projector in the world.
    focal_x, focal_y, first_x, centre_y
        Focal lengths, column of the first pixel on the image axis and row of the principal point [px].
    """
    rows, columns = hit.shape
    landing = np.full((rows, columns, 2), np.nan)
    bright = np.zeros((rows, columns))
    owner = np.full((rows, columns), -1, np.int64)
    mixed = np.zeros((rows, columns), np.uint8)
    for i in range(rows):
        for j in range(columns):
            if hit[i, j] == 0:
                continue
            x, y, z = found[i, j, 0] - origin[0], found[i, j, 1] - origin[1], found[i, j, 2] - origin[2]
            px = rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z
            py = rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z
            pz = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z
            if pz > 0.05:
                landing[i, j, 0] = focal_x * px / pz - first_x
                landing[i, j, 1] = focal_y * py / pz + centre_y
    for i in range(rows - 1):
        for j in range(columns - 1):
            u, v = landing[i, j, 0], landing[i, j, 1]
            area = (landing[i, j + 1, 0] - u) * (landing[i + 1, j, 1] - v)
            area = abs(area - (landing[i, j + 1, 1] - v) * (landing[i + 1, j, 0] - u))
            if not area < 100.0:  # discontinuous, or a neighbour without landing
                area = 100.0
            bright[i, j] = found[i, j, 3] / max(area, 0.1)
            if not (u > -0.5 and v > -0.5 and u < columns - 0.5 and v < rows - 0.5):
                continue
            column, row = int(math.floor(u + 0.5)), int(math.floor(v + 0.5))
            other = owner[row, column]
            if other < 0:
                owner[row, column] = i * columns + j
                continue
            a, b = other // columns, other % columns
            mine, theirs = bright[i, j], bright[a, b]
            if (abs(a - i) > 2 or abs(b - j) > 2) and min(mine, theirs) > 0.5 * max(mine, theirs):
                mixed[row, column] = 1
            if mine > theirs:
                owner[row, column] = i * columns + j
    return landing, bright, owner, mixed


@kernel(parallel=True)
def decode_pattern(hit, found, p_found, landing, bright, owner, mixed, rotation, projector, focal_x, focal_y, first_x, centre_y, row_tolerance, min_signal):  # fmt: skip
    """Projector column visible in each camera pixel, NaN where the pattern cannot be decoded.

    Parameters
    ----------
    hit, found
        Result of :func:`trace_rays` from the camera.
    p_found
        Result of :func:`trace_rays` from the projector.
    landing, bright, owner, mixed
        Result of :func:`pattern_map`.
    rotation, projector
        Rotation (3, 3) and centre (3) [m] of the projector in the world.
    focal_x, focal_y, first_x, centre_y
        Focal lengths, column of the projector's first pixel on its own image axis (negative of its principal
        point) and row of the principal point [px].
    row_tolerance
        Maximum shift of the pattern across the rows [px].
    min_signal
        Minimum transmitted fraction x albedo x cosine / depth^2 that can be decoded [1/m^2].
    """
    rows, columns = hit.shape
    p_rows, p_columns = owner.shape
    seen = np.full((rows, columns), np.nan)
    for i in prange(rows):
        for j in range(columns):
            if hit[i, j] == 0:
                continue
            x = found[i, j, 0] - projector[0]
            y = found[i, j, 1] - projector[1]
            z = found[i, j, 2] - projector[2]
            px = rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z
            py = rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z
            pz = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z
            if pz <= 0.05:
                continue
            u, v = focal_x * px / pz - first_x, focal_y * py / pz + centre_y
            column, row = int(math.floor(u + 0.5)), int(math.floor(v + 0.5))
            best, best_far2 = -1, (2.5 * pz / focal_x) ** 2 + 1e-6
            blurred = False
            for a in range(max(0, row - 1), min(p_rows, row + 2)):
                for b in range(max(0, column - 1), min(p_columns, column + 2)):
                    k = owner[a, b]
                    if k < 0:
                        continue
                    q = p_found[k // p_columns, k % p_columns]
                    far2 = (
                        (q[0] - found[i, j, 0]) ** 2
                        + (q[1] - found[i, j, 1]) ** 2
                        + (q[2] - found[i, j, 2]) ** 2
                    )
                    if far2 < best_far2:
                        best, best_far2 = k, far2
                        blurred = mixed[a, b] == 1
            if best < 0 or blurred:
                continue
            a, b = best // p_columns, best % p_columns
            # One Newton step from the nearest landing, with the gradient of the map.
            du, dv = u - landing[a, b, 0], v - landing[a, b, 1]
            if 0 < a < p_rows - 1 and 0 < b < p_columns - 1:
                uu = 0.5 * (landing[a, b + 1, 0] - landing[a, b - 1, 0])
                uv = 0.5 * (landing[a + 1, b, 0] - landing[a - 1, b, 0])
                vu = 0.5 * (landing[a, b + 1, 1] - landing[a, b - 1, 1])
                vv = 0.5 * (landing[a + 1, b, 1] - landing[a - 1, b, 1])
                det = uu * vv - uv * vu
                if abs(det) > 0.05:  # not NaN, not a caustic
                    du, dv = (vv * du - uv * dv) / det, (uu * dv - vu * du) / det
            if abs(du) > 2.0 or abs(dv) > 2.0 or abs(a + dv - i) > row_tolerance:
                continue
            light = min(1.0, bright[a, b])
            signal = found[i, j, 3] * light * found[i, j, 5] * found[i, j, 4] / (pz * pz)
            if signal < min_signal:
                continue
            seen[i, j] = b + du + first_x
    return seen
