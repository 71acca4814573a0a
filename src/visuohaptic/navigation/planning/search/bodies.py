"""Pushable bodies in grid coordinates: outline, contacts, and their effect on the clearance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float, Int32

from ....core.geometry import rotation_2d
from ....io.maps.occupancy_map import OccupancyMap
from ...problem.planning_problem import MovableObject
from ...problem.push_costs import Manipulability
from ...pushing._outline_kernels import distance_patch
from ...pushing.contact_candidates import PushContact, push_contacts
from ..arrays import Clearance, Outline, Path, Point

#: Spacing of the points along an outline that are checked for collisions [cells].
OUTLINE_STEP = 0.45
#: Distance of these points inside the outline, so that an object may slide along a wall [m].
OUTLINE_INSET_M = 5e-4


@dataclass(frozen=True, eq=False)
class Body:
    """A pushable object in grid coordinates, at its mapped position."""

    obj: MovableObject
    outline: Outline
    centre: Point
    friction: Point  #: centre of friction from the centre
    allowed: Manipulability
    radius: float  #: distance of the robot's front from its centre
    margin: float  #: margin that the robot keeps while it is pushed
    inset: float  #: of the sampled points from its outline
    robot: Path | None = None  #: footprint of the robot; ``None``: a disc
    room: float = 0.0  #: distance that drives keep in addition to the robot's radius

    @cached_property
    def kept_clear(self) -> Path:
        """Outline from which drives keep the robot's radius."""
        import shapely

        if not self.room:
            return self.outline
        return shapely.get_coordinates(shapely.Polygon(self.outline).buffer(self.room, quad_segs=2))[:-1]

    @cached_property
    def samples(self) -> Path:
        """Points along the outline, slightly inside."""
        return _samples(self.outline, -self.inset)

    @cached_property
    def around(self) -> Path:
        """Points outside the outline by the robot's ``push_margin_m``; none without a margin."""
        return _samples(self.outline, self.margin) if self.margin > 0 else np.zeros((0, 2))

    @cached_property
    def contacts(self) -> tuple[PushContact, ...]:
        """Stable straight pushes through the centre of friction, relative to the centroid."""
        return self._contacts(oblique=False)

    @cached_property
    def with_oblique(self) -> tuple[PushContact, ...]:
        """The contacts, followed by those oblique to a face, which rely on contact friction."""
        return (*self.contacts, *(push for push in self._contacts(oblique=True) if push.oblique))

    def placed(
        self, points: Path, poses: Float[np.ndarray, "*k 3"], resolution_m: float
    ) -> Float[np.ndarray, "*k m 2"]:
        """Points of the body [cells] after each of the motions.

        Parameters
        ----------
        points
            Points at the mapped position [cells].
        poses
            x, y [m] and rotation about the centre [rad].
        resolution_m
            Edge of a cell [m].
        """
        c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
        turns = np.stack([np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)], axis=-2)
        ends = self.centre + poses[..., :2] / resolution_m
        return (points - self.centre) @ turns + ends[..., None, :]

    def push(self, contact: int) -> PushContact:
        """A push by its index: first those perpendicular to a face, then the oblique ones.

        Parameters
        ----------
        contact
            Index of the contact.
        """
        return self.contacts[contact] if contact < len(self.contacts) else self.with_oblique[contact]

    def _contacts(self, *, oblique: bool) -> tuple[PushContact, ...]:
        shape = np.round(self.outline - self.centre - self.friction, 6)
        found = _contacts(shape.tobytes(), self.radius, oblique)
        if self.friction.any():
            found = tuple(
                replace(push, contact=push.contact + self.friction, robot=push.robot + self.friction)
                for push in found
            )
        if self.robot is not None:
            found = tuple(push for push in found if self._fits_behind(push, self.robot))
        return found

    def _fits_behind(self, push: PushContact, robot: Path) -> bool:
        """Whether a robot with a footprint does not overlap the body where it touches it."""
        import shapely

        (x, y) = push.direction
        placed = robot @ np.array([[x, y], [-y, x]]) + push.robot
        inner = shapely.Polygon(placed).buffer(-2.0 * self.inset)
        return not inner.intersects(shapely.Polygon(self.outline - self.centre))


@lru_cache(maxsize=4096)
def _contacts(shape: bytes, radius: float, oblique: bool) -> tuple[PushContact, ...]:
    """Contacts of an outline about its centre of friction, cached by shape."""
    outline = np.frombuffer(shape, dtype=np.float64).reshape(-1, 2)
    return push_contacts(outline, np.zeros(2), radius, oblique=oblique)


def lower_clearance(clearance: Clearance, outline: Outline, reach: float) -> None:
    """Add an object to a clearance layer, in place, within the relevant distance.

    Parameters
    ----------
    clearance
        Clearance of each cell, (rows, columns) float32 [cells]; reduced in place.
    outline
        Corners of the object (x, y), (p, 2) [cells].
    reach
        Maximum clearance that matters [cells].
    """

    lower_window(clearance, *distance_patch(outline, reach))


def lower_window(layer: Clearance, patch: Clearance, row: int, column: int) -> None:
    """Add a patch to a clearance layer, in place.

    Parameters
    ----------
    layer
        Clearance of each cell, (rows, columns) float32 [cells]; reduced in place.
    patch
        Clearance to one object, (r, c) float32 [cells].
    row, column
        First row and column of the patch, which may lie outside the layer [cells].
    """
    r0, c0 = max(row, 0), max(column, 0)
    r1, c1 = min(row + patch.shape[0], layer.shape[0]), min(column + patch.shape[1], layer.shape[1])
    if r0 < r1 and c0 < c1:
        into = layer[r0:r1, c0:c1]
        np.minimum(into, patch[r0 - row : r1 - row, c0 - column : c1 - column], out=into)


def _samples(outline: Outline, outside: float) -> Path:
    """Points along the outline, offset to the outside (to the inside where negative) [cells]."""
    import shapely

    body = shapely.Polygon(outline)
    inner = body.buffer(outside, join_style="mitre")
    rings = shapely.get_exterior_ring(shapely.get_parts(body if inner.is_empty else inner))
    return np.asarray(shapely.get_coordinates(shapely.segmentize(rings, OUTLINE_STEP)))


def joined_outlines(outlines: Sequence[Outline]) -> tuple[Float[np.ndarray, "v 2"], Int32[np.ndarray, "o"]]:
    """Concatenated outlines, and the start index of each, followed by the end of the last.

    Parameters
    ----------
    outlines
        Corners of each outline.
    """
    starts = np.cumsum([0, *(len(outline) for outline in outlines)]).astype(np.int32)
    return np.concatenate(outlines) if outlines else np.zeros((0, 2)), starts


def grid_from_world(
    map: OccupancyMap, points_m: Float[np.ndarray, "*batch 2"]
) -> Float[np.ndarray, "*batch 2"]:
    """Grid coordinates [cells] of points in the map frame.

    Parameters
    ----------
    map
        The grid.
    points_m
        x, y in the map frame [m].
    """
    x, y, yaw = map.origin
    return (np.asarray(points_m, dtype=np.float64) - (x, y)) @ rotation_2d(yaw) / map.resolution_m


def world_from_grid(
    map: OccupancyMap, points: Float[np.ndarray, "*batch 2"]
) -> Float[np.ndarray, "*batch 2"]:
    """Points in the map frame [m] of grid coordinates.

    Parameters
    ----------
    map
        The grid.
    points
        x along the columns, y along the rows [cells].
    """
    x, y, yaw = map.origin
    return np.asarray(points) * map.resolution_m @ rotation_2d(yaw).T + (x, y)


def sampled(path: Path, step: float) -> tuple[Path, Float[np.ndarray, "k"]]:
    """Middles of equal parts of a path's segments, and the lengths of the parts.

    Parameters
    ----------
    path
        Corners.
    step
        Maximum length of a part.
    """
    steps = np.diff(path, axis=0)
    lengths = np.hypot(*steps.T)
    parts = np.maximum(np.ceil(lengths / step), 1).astype(int)
    number = np.repeat(np.arange(len(parts)), parts)
    share = (np.arange(len(number)) - np.repeat(np.cumsum(parts) - parts, parts) + 0.5) / parts[number]
    return path[number] + share[:, None] * steps[number], (lengths / parts)[number]
