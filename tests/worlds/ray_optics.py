"""Rays through solids of revolution and boxes: nearest surface, Snell refraction, Fresnel transmission.

A solid of revolution is a polyline (r, z) around its own z axis; each piece is a cone, a cylinder or a disc that is
intersected exactly. Every piece stores the refractive index on the side of its normal and on the other side, so that walls,
liquid and air need no tracking of the medium of a ray. The normal of a piece from (r0, z0) to (r1, z1) is
(z1 - z0, r0 - r1): outward of a profile that starts on the axis at the bottom and goes up outside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

__all__ = ["CLEAR", "Box", "Hits", "Revolved", "cast", "compile_scene", "fresnel_transmission", "refract"]

#: Material of glass; others are opaque and stop a ray.
CLEAR = -1
#: Maximum number of interfaces of a ray.
MAX_EVENTS = 24
#: A ray continues this far behind the intersected surface [m].
_STEP_M = 1e-7


@dataclass(frozen=True, slots=True)
class Revolved:
    """A solid of revolution."""

    pieces: (
        np.ndarray
    )  #: (k, 6): r0, z0, r1, z1 [m], refractive index on the normal's side, on the other side
    position_m: np.ndarray  #: of its origin in the world, (3,)
    material: int  #: ``CLEAR``, or the number of an opaque material
    rotation: np.ndarray | None = None  #: of its axes in the world, (3, 3); None: upright


@dataclass(frozen=True, slots=True)
class Box:
    """An opaque box that stands upright."""

    position_m: np.ndarray  #: middle, (3,)
    half_m: np.ndarray  #: half edges, (3,)
    yaw_rad: float
    material: int


@dataclass(frozen=True, slots=True)
class Hits:
    """Intersections of the rays of one camera; arrays of shape (rays, ...)."""

    point_m: np.ndarray  #: where the ray ends on something opaque, (n, 3); NaN: nowhere
    owner: np.ndarray  #: number of that object, boxes behind solids of revolution; -1: none
    first: np.ndarray  #: number of the first object met; -1: none
    first_m: np.ndarray  #: distance to it along the ray [m]
    normal: np.ndarray  #: of the first surface, towards the eye, (n, 3)
    passed: np.ndarray  #: fraction of light that gets through all interfaces, 0-1
    cosine: np.ndarray  #: of the angle between ray and surface where the ray ends, 0-1


@njit(cache=True)
def refract(dx, dy, dz, nx, ny, nz, ratio):
    """Direction behind an interface by Snell's law, for a normal against the ray; ratio = n before / n behind.

    Returns the direction and False, or the mirrored direction and True where reflection is total.
    """
    c = -(dx * nx + dy * ny + dz * nz)
    k = 1.0 - ratio * ratio * (1.0 - c * c)
    if k < 0.0:
        return dx + 2 * c * nx, dy + 2 * c * ny, dz + 2 * c * nz, True
    s = ratio * c - np.sqrt(k)
    return ratio * dx + s * nx, ratio * dy + s * ny, ratio * dz + s * nz, False


@njit(cache=True)
def fresnel_transmission(cosine, before, behind):
    """Fraction of unpolarised light that passes an interface, at the cosine of the angle of incidence."""
    sine = before / behind * np.sqrt(max(0.0, 1.0 - cosine * cosine))
    if sine >= 1.0:
        return 0.0
    inner = np.sqrt(1.0 - sine * sine)
    across = (before * cosine - behind * inner) / (before * cosine + behind * inner)
    along = (before * inner - behind * cosine) / (before * inner + behind * cosine)
    return 1.0 - 0.5 * (across * across + along * along)


@njit(cache=True)
def _meet_piece(pieces, s, ox, oy, oz, dx, dy, dz, nearest):
    """Distance to a piece in its own frame, or a value not below ``nearest``."""
    r0 = pieces[s, 0]
    z0 = pieces[s, 1]
    r1 = pieces[s, 2]
    z1 = pieces[s, 3]
    if abs(z1 - z0) < 1e-9:
        if abs(dz) < 1e-12:
            return nearest
        t = (z0 - oz) / dz
        if t <= 0.0 or t >= nearest:
            return nearest
        x = ox + t * dx
        y = oy + t * dy
        r = x * x + y * y
        low = min(r0, r1)
        high = max(r0, r1)
        return t if low * low <= r <= high * high else nearest
    slope = (r1 - r0) / (z1 - z0)
    g = r0 + slope * (oz - z0)
    h = slope * dz
    a = dx * dx + dy * dy - h * h
    b = ox * dx + oy * dy - g * h
    c = ox * ox + oy * oy - g * g
    low = min(z0, z1)
    high = max(z0, z1)
    best = nearest
    if abs(a) < 1e-14:
        if abs(b) > 1e-14:
            t = -0.5 * c / b
            z = oz + t * dz
            if 0.0 < t < best and low <= z <= high and g + h * t >= 0.0:
                best = t
        return best
    root = b * b - a * c
    if root < 0.0:
        return best
    root = np.sqrt(root)
    for sign in (-1.0, 1.0):
        t = (-b + sign * root) / a
        if 0.0 < t < best:
            z = oz + t * dz
            if low <= z <= high and g + h * t >= 0.0:
                best = t
    return best


@njit(cache=True)
def _meet_box(boxes, k, ox, oy, oz, dx, dy, dz, nearest, normal):
    """Distance to a box; its outward normal in world axes is left in ``normal``."""
    c = boxes[k, 6]
    s = boxes[k, 7]
    px = ox - boxes[k, 0]
    py = oy - boxes[k, 1]
    o = (c * px + s * py, -s * px + c * py, oz - boxes[k, 2])
    d = (c * dx + s * dy, -s * dx + c * dy, dz)
    enter = 0.0
    leave = nearest
    axis = -1
    for i in range(3):
        half = boxes[k, 3 + i]
        if abs(d[i]) < 1e-14:
            if abs(o[i]) > half:
                return nearest
            continue
        t0 = (-half - o[i]) / d[i]
        t1 = (half - o[i]) / d[i]
        if t0 > t1:
            t0, t1 = t1, t0
        if t0 > enter:
            enter = t0
            axis = i
        leave = min(leave, t1)
    if axis < 0 or enter >= leave:
        return nearest
    sign = -1.0 if d[axis] > 0 else 1.0
    if axis == 0:
        normal[0], normal[1], normal[2] = sign * c, sign * s, 0.0
    elif axis == 1:
        normal[0], normal[1], normal[2] = -sign * s, sign * c, 0.0
    else:
        normal[0], normal[1], normal[2] = 0.0, 0.0, sign
    return enter


@njit(cache=True)
def _nearest(solids, spans, pieces, boxes, ox, oy, oz, dx, dy, dz, normal, scratch):
    """Distance, object and piece of the nearest surface; the normal is the piece's, in world axes."""
    best = 1e9
    owner = -1
    piece = -1
    for k in range(solids.shape[0]):
        px = ox - solids[k, 0]
        py = oy - solids[k, 1]
        pz = oz - solids[k, 2]
        qx = solids[k, 3] * px + solids[k, 6] * py + solids[k, 9] * pz
        qy = solids[k, 4] * px + solids[k, 7] * py + solids[k, 10] * pz
        qz = solids[k, 5] * px + solids[k, 8] * py + solids[k, 11] * pz
        ex = solids[k, 3] * dx + solids[k, 6] * dy + solids[k, 9] * dz
        ey = solids[k, 4] * dx + solids[k, 7] * dy + solids[k, 10] * dz
        ez = solids[k, 5] * dx + solids[k, 8] * dy + solids[k, 11] * dz
        # The bounding sphere first.
        mz = qz - solids[k, 12]
        along = qx * ex + qy * ey + mz * ez
        off = qx * qx + qy * qy + mz * mz - along * along
        if off > solids[k, 13] * solids[k, 13]:
            continue
        before = best
        for s in range(spans[k, 0], spans[k, 1]):
            t = _meet_piece(pieces, s, qx, qy, qz, ex, ey, ez, best)
            if t < best:
                best = t
                owner = k
                piece = s
        if best < before:
            x = qx + best * ex
            y = qy + best * ey
            r = max(np.sqrt(x * x + y * y), 1e-12)
            nr = pieces[piece, 3] - pieces[piece, 1]
            nz = pieces[piece, 0] - pieces[piece, 2]
            norm = np.sqrt(nr * nr + nz * nz)
            nx = nr / norm * x / r
            ny = nr / norm * y / r
            nz = nz / norm
            for i in range(3):
                normal[i] = solids[k, 3 + 3 * i] * nx + solids[k, 4 + 3 * i] * ny + solids[k, 5 + 3 * i] * nz
    for k in range(boxes.shape[0]):
        t = _meet_box(boxes, k, ox, oy, oz, dx, dy, dz, best, scratch)
        if t < best:
            best = t
            owner = solids.shape[0] + k
            piece = -1
            normal[0], normal[1], normal[2] = scratch[0], scratch[1], scratch[2]
    return best, owner, piece


@njit(cache=True)
def _cast(solids, spans, pieces, boxes, materials, eye, directions, numbers, values):
    """Follow each ray to an opaque surface; fills ``numbers`` (n, 2) and ``values`` (n, 9)."""
    normal = np.zeros(3)
    scratch = np.zeros(3)
    for n in range(directions.shape[0]):
        ox, oy, oz = eye[0], eye[1], eye[2]
        dx, dy, dz = directions[n, 0], directions[n, 1], directions[n, 2]
        passed = 1.0
        numbers[n, 0] = -1
        numbers[n, 1] = -1
        for event in range(MAX_EVENTS):
            t, owner, piece = _nearest(solids, spans, pieces, boxes, ox, oy, oz, dx, dy, dz, normal, scratch)
            if owner < 0:
                break
            c = -(dx * normal[0] + dy * normal[1] + dz * normal[2])
            side = 1.0 if c >= 0 else -1.0
            if event == 0:
                numbers[n, 1] = owner
                values[n, 3] = t
                for i in range(3):
                    values[n, 4 + i] = side * normal[i]
            ox, oy, oz = ox + t * dx, oy + t * dy, oz + t * dz
            if materials[owner] != CLEAR:
                numbers[n, 0] = owner
                values[n, 0], values[n, 1], values[n, 2] = ox, oy, oz
                values[n, 8] = abs(c)
                break
            before = pieces[piece, 4] if side > 0 else pieces[piece, 5]
            behind = pieces[piece, 5] if side > 0 else pieces[piece, 4]
            nx, ny, nz = side * normal[0], side * normal[1], side * normal[2]
            dx, dy, dz, mirrored = refract(dx, dy, dz, nx, ny, nz, before / behind)
            if not mirrored:
                passed *= fresnel_transmission(abs(c), before, behind)
            ox, oy, oz = ox + _STEP_M * dx, oy + _STEP_M * dy, oz + _STEP_M * dz
        values[n, 7] = passed


def compile_scene(objects: list[Revolved], boxes: list[Box]) -> tuple[np.ndarray, ...]:
    """Arrays of a scene for :func:`cast`."""
    spans, pieces, solids = [], [], []
    start = 0
    for one in objects:
        pieces.append(one.pieces)
        spans.append((start, start + len(one.pieces)))
        start += len(one.pieces)
        r = one.pieces[:, [0, 2]].ravel()
        z = one.pieces[:, [1, 3]].ravel()
        middle = 0.5 * (z.min() + z.max())
        radius = np.hypot(r, z - middle).max() + 1e-6
        rotation = np.eye(3) if one.rotation is None else one.rotation
        solids.append([*one.position_m, *rotation.ravel(), middle, radius])
    rows = [[*b.position_m, *b.half_m, np.cos(b.yaw_rad), np.sin(b.yaw_rad)] for b in boxes]
    return (
        np.array(solids, dtype=float).reshape(-1, 14),
        np.array(spans, dtype=np.int64).reshape(-1, 2),
        np.concatenate(pieces) if pieces else np.zeros((0, 6)),
        np.array(rows, dtype=float).reshape(-1, 8),
        np.array([one.material for one in objects] + [b.material for b in boxes], dtype=np.int64),
    )


def cast(scene: tuple[np.ndarray, ...], eye_m: np.ndarray, directions: np.ndarray) -> Hits:
    """Follow rays from an eye, unit directions (n, 3) in the world."""
    count = len(directions)
    numbers = np.empty((count, 2), dtype=np.int64)
    values = np.full((count, 9), np.nan)
    _cast(*scene, np.asarray(eye_m, dtype=float), np.ascontiguousarray(directions), numbers, values)
    return Hits(
        values[:, :3], numbers[:, 0], numbers[:, 1], values[:, 3], values[:, 4:7], values[:, 7], values[:, 8]
    )
