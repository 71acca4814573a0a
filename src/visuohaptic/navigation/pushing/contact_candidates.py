"""Contacts of a disc with an outline from which a straight push through the centre is stable (Alt 2016, Sec. 4.3.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from ._outline_kernels import disc_touches_at

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
    from shapely import Polygon, get_coordinates, points

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
    angles = np.array([angle for angle, _ in candidates])
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    distances = np.array([disc_touches_at(shape, *direction, radius, reach) for direction in directions])
    robots = -distances[:, None] * directions
    ring = body.exterior
    contacts = get_coordinates(ring.interpolate(ring.project(points(robots))))
    tilts = _tilts(hull, contacts, directions, FACE_MARGIN)
    # At a corner of a concavity, the normal is that of the rim, and the object turns until it touches the other side.
    corners = _tilts(hull, contacts, (contacts - robots) / radius) > STABLE_RAD
    found: list[PushContact] = []
    taken: list[float] = []
    for k, (angle, spacing) in enumerate(candidates):
        # Not positive: the disc passes, or ends in a concavity beyond the centre.
        if distances[k] <= 0.0 or any(abs(math.remainder(angle - t, 2.0 * math.pi)) < spacing for t in taken):
            continue
        steep = tilts[k] > STABLE_RAD
        bridged = spacing == FACE_SPACING_RAD and (steep or corners[k])
        bridged = bridged and _touches_both_sides(body, robots[k], radius, directions[k])
        if bridged or (tilts[k] <= steepest and not corners[k]):
            contact = robots[k] + radius * directions[k] if bridged else contacts[k]
            found.append(PushContact(directions[k], contact, robots[k], bool(steep and not bridged)))
            taken.append(angle)
    return tuple(sorted(found, key=lambda push: float(np.arctan2(push.direction[1], push.direction[0]))))


def _seats(body: Any, radius: float) -> Float[np.ndarray, "n 2"]:
    """Centres of a disc that touches both sides of a concavity: reflex corners of the outline of its possible centres."""
    ring = np.array(body.buffer(radius).exterior.coords)[:-1]
    after = np.roll(ring, -1, axis=0) - ring
    before = np.roll(after, 1, axis=0)
    turns = np.arctan2(np.linalg.det(np.stack([before, after], axis=1)), (before * after).sum(axis=1))
    return np.asarray(ring[turns * np.sign(turns.sum()) < -STABLE_RAD])


def _tilts(
    hull: Float[np.ndarray, "h 2"],
    contacts: Float[np.ndarray, "n 2"],
    directions: Float[np.ndarray, "n 2"],
    margin: float = 0.0,
) -> Float[np.ndarray, "n"]:
    """Angles between pushes and the inward normals of the faces that they touch [rad]; pi without a face.

    Only faces count, not corners: pushed at a corner, a box rotates away. The margin, a fraction of the face, is kept from
    corners that the rim would roll around, not from those between the faces of a round outline.
    """
    edges = np.roll(hull, -1, axis=0) - hull
    lengths = np.hypot(*edges.T)
    edges, starts, lengths = edges[lengths > 0], hull[lengths > 0], lengths[lengths > 0]
    edges /= lengths[:, None]
    inward = np.column_stack([-edges[:, 1], edges[:, 0]])
    along = contacts @ edges.T - (starts * edges).sum(axis=1)
    across = contacts @ inward.T - (starts * inward).sum(axis=1)
    tolerance = 1e-6 * float(np.abs(hull).max()) + 1e-9
    # Beyond a corner that is not sharp, friction holds the rim on the next face: discs are polygons.
    sharp = (edges * np.roll(edges, 1, axis=0)).sum(axis=1) < np.cos(max(OBLIQUE_RAD))
    limits = np.where([sharp, np.roll(sharp, -1)], margin * lengths, 0.0)[:, None] - tolerance
    # An oblique push would slide off at any corner.
    begins, ends = np.where(directions @ inward.T < np.cos(STABLE_RAD), tolerance, limits)
    meets = (np.abs(across) < tolerance) & (along > begins) & (along < lengths - ends)
    cosines = np.where(meets, directions @ inward.T, -1.0).max(axis=1)
    return np.asarray(np.arccos(np.clip(cosines, -1.0, 1.0)))


def _touches_both_sides(body: Any, robot: np.ndarray, radius: float, direction: np.ndarray) -> bool:
    """Whether the disc touches the outline on both sides of the push's line, which goes through the origin."""
    from shapely import Point, get_parts

    touching = get_parts(body.intersection(Point(*robot).buffer(radius * 1.02)))
    middles = [part.centroid for part in touching]
    sides = [float(direction[0] * at.y - direction[1] * at.x) for at in middles]
    return min(sides, default=0.0) < 0 < max(sides, default=0.0)
