"""Contacts of a disc with an outline from which a straight push through the centre is stable (Alt 2016, Sec. 4.3.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from ._outline_kernels import disc_touches_at

__all__ = ["PushContact", "push_contacts"]

#: Maximum angle between contact normal and push; friction cones are wider.
STABLE_RAD = np.deg2rad(8.0)
#: Oblique pushes; they need a contact friction of the tangent, 0.21 and 0.45, which foam has on most objects.
OBLIQUE_RAD = (np.deg2rad(12.0), np.deg2rad(24.0))
#: Minimum distance of a contact from the ends of a face, as a fraction of its length.
FACE_MARGIN = 0.1
#: Pushes that differ by less are merged; the number of faces of a round outline is arbitrary.
FACE_SPACING_RAD, OBLIQUE_SPACING_RAD = np.deg2rad(1.0), np.deg2rad(6.0)
#: Additional directions tried for round outlines.
DIRECTIONS = 16


@dataclass(frozen=True, slots=True, eq=False)
class PushContact:
    """One stable straight push, relative to the object's centre."""

    direction: Float[np.ndarray, "2"]  #: unit vector of the push
    contact: Float[np.ndarray, "2"]  #: common point of disc and outline
    robot: Float[np.ndarray, "2"]  #: centre of the disc when it touches
    oblique: bool = False  #: oblique to the face: relies on contact friction


def push_contacts(
    outline: Float[np.ndarray, "p 2"], centre: Float[np.ndarray, "2"], radius: float, *, oblique: bool = False
) -> tuple[PushContact, ...]:
    """Contacts from which a disc pushes an outline straight and stably, sorted by direction.

    The line of the push goes through the centre, and the contact normal
    differs from it by at most ``STABLE_RAD``. Candidates are the
    perpendiculars of the hull's faces through the centre (a disc that bridges
    a concavity has two contacts, which is stable too) and, for round outlines, a fan
    of directions.

    Parameters
    ----------
    outline
        Corners, in any unit of length that all arguments share.
    centre
        Centre of friction on the line of the push.
    radius
        Radius of the pushing disc.
    oblique
        Whether pushes oblique to a face, which rely on contact friction, are added.
    """
    from shapely import Point, Polygon

    shape = np.ascontiguousarray(outline - centre)
    body = Polygon(shape)
    hull = np.array(body.convex_hull.exterior.coords)[:-1]
    if not body.convex_hull.exterior.is_ccw:
        hull = hull[::-1]
    candidates: list[tuple[float, float]] = []  # angle, and minimum spacing from others
    for a, b in zip(hull, np.roll(hull, -1, axis=0), strict=True):
        edge = b - a
        length = float(np.hypot(*edge))
        along = -float(a @ edge) / length**2
        if FACE_MARGIN <= along <= 1.0 - FACE_MARGIN:
            candidates.append((float(np.arctan2(edge[0], -edge[1])), FACE_SPACING_RAD))  # inward normal
    seats = _seats(body, radius)
    candidates += [(float(np.arctan2(-seat[1], -seat[0])), FACE_SPACING_RAD) for seat in seats]
    fan = np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS
    candidates += [(float(angle), np.pi / DIRECTIONS) for angle in fan]
    if oblique:
        normals = [angle for angle, spacing in candidates if spacing == FACE_SPACING_RAD]
        candidates += [
            (angle + s * t, OBLIQUE_SPACING_RAD) for angle in normals for t in OBLIQUE_RAD for s in (-1, 1)
        ]
    steepest = max(OBLIQUE_RAD) + np.deg2rad(0.5) if oblique else STABLE_RAD
    reach = float(np.abs(hull).max()) * 3 + 3 * radius
    found: list[PushContact] = []
    taken: list[float] = []
    for angle, spacing in candidates:
        of_face = spacing == FACE_SPACING_RAD
        if any(abs(math.remainder(angle - other, 2.0 * math.pi)) < spacing for other in taken):
            continue
        direction = np.array([np.cos(angle), np.sin(angle)])
        distance = disc_touches_at(shape, direction[0], direction[1], radius, reach)
        if distance <= 0.0:
            continue  # it passes, or ends in a concavity beyond the centre
        robot = -distance * direction
        contact = np.array(body.exterior.interpolate(body.exterior.project(Point(*robot))).coords[0])
        tilt = _tilt(hull, contact, direction)
        # At a corner of a concavity, the normal is that of the rim, and the object turns until it touches the other side.
        corner = _tilt(hull, contact, (contact - robot) / radius) > STABLE_RAD
        steep = tilt > STABLE_RAD
        bridged = of_face and (steep or corner) and _touches_both_sides(body, robot, radius, direction)
        if bridged or (tilt <= steepest and not corner):
            if bridged:
                contact = robot + radius * direction
            found.append(PushContact(direction, contact, robot, bool(steep and not bridged)))
            taken.append(angle)
    return tuple(sorted(found, key=lambda push: float(np.arctan2(push.direction[1], push.direction[0]))))


def _seats(body: Any, radius: float) -> Float[np.ndarray, "n 2"]:
    """Centres of a disc that touches both sides of a concavity: reflex corners of the outline of its possible centres."""
    ring = np.array(body.buffer(radius).exterior.coords)[:-1]
    after = np.roll(ring, -1, axis=0) - ring
    before = np.roll(after, 1, axis=0)
    turns = np.arctan2(np.linalg.det(np.stack([before, after], axis=1)), (before * after).sum(axis=1))
    found: np.ndarray = ring[turns * np.sign(turns.sum()) < -STABLE_RAD]
    return found


def _tilt(
    hull: Float[np.ndarray, "h 2"], contact: Float[np.ndarray, "2"], direction: Float[np.ndarray, "2"]
) -> float:
    """Angle between a push and the inward normal of the face that it touches [rad].

    Only faces count, not corners: pushed at a corner, a box rotates away.
    """
    edges = np.roll(hull, -1, axis=0) - hull
    lengths = np.hypot(*edges.T)
    edges, starts = edges[lengths > 0] / lengths[lengths > 0, None], hull[lengths > 0]
    off, lengths = contact - starts, lengths[lengths > 0]
    along = np.einsum("ij,ij->i", off, edges)
    across = np.abs(edges[:, 0] * off[:, 1] - edges[:, 1] * off[:, 0])
    tolerance = 1e-6 * float(np.abs(hull).max()) + 1e-9
    meets = (across < tolerance) & (along > -tolerance) & (along < lengths + tolerance)
    if not meets.any():
        return float(np.pi)
    inward = np.column_stack([-edges[:, 1], edges[:, 0]])[meets]
    return float(np.arccos(np.clip((inward @ direction).max(), -1.0, 1.0)))


def _touches_both_sides(body: object, robot: np.ndarray, radius: float, direction: np.ndarray) -> bool:
    """Whether the disc touches the outline on both sides of the push's line."""
    from shapely import Point, intersection

    touching = intersection(body, Point(*robot).buffer(radius * 1.02))
    if touching.is_empty:
        return False
    x0, y0, x1, y1 = touching.bounds
    corners = [np.array(part.centroid.coords[0]) for part in getattr(touching, "geoms", [touching])]
    if len(corners) < 2 or (x1 - x0) + (y1 - y0) == 0:
        return False
    sides = [float(direction[0] * (c - robot)[1] - direction[1] * (c - robot)[0]) for c in corners]
    return min(sides) < 0 < max(sides)
