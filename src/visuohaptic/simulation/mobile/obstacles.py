"""Obstacles of a platform on the floor: boxes, cylinders, tables, walls, hinged doors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core import FINITE, NON_NEGATIVE, POSITIVE, Pose, Ranged, at_least
from ...core.measurement import GRAVITY_M_S2
from ..foam.outline import Outline
from ..rendering.scene import Solid

#: Feet on which movable obstacles stand: radius (m). A flat bottom would rest on arbitrary points.
FOOT_M = 0.004
#: Tilt above which the cross section is cut from the solid instead of the upright outline (rad).
UPRIGHT_RAD = 0.002


class ObstacleKind(StrEnum):
    """Type of an obstacle."""

    BOX = "box"
    CYLINDER = "cylinder"
    TABLE = "table"
    WALL = "wall"
    DOOR = "door"


@dataclass(frozen=True, slots=True)
class SimulatedObstacle(Ranged):
    """One obstacle: its pose in the world, and its physical properties.

    A box, table or wall is placed by its centre, a door by its hinge: the
    closed wing points along x of its own frame.
    """

    name: str
    kind: ObstacleKind
    x_m: float = field(metadata=FINITE)
    y_m: float = field(metadata=FINITE)
    yaw_rad: float = field(default=0.0, metadata=FINITE)
    length_m: float = field(default=0.3, metadata=POSITIVE)  #: along its x; diameter of a cylinder
    width_m: float = field(default=0.3, metadata=POSITIVE)  #: along its y; thickness of a door
    height_m: float = field(default=0.3, metadata=POSITIVE)
    mass_kg: float = field(default=1.0, metadata=POSITIVE)
    friction: float = field(default=0.4, metadata=NON_NEGATIVE)  #: dynamic, with the floor
    static_ratio: float = field(default=1.1, metadata=at_least(1))  #: static over dynamic friction
    fixed: bool = False  #: cannot move at all
    edge_m: float = 0.002  #: radius of its upright edges
    leg_m: float = 0.04  #: side or diameter of a table's legs
    round_legs: bool = False
    hinge_friction_Nm: float = 0.3  #: of a door
    hinge_damping_Nms: float = 0.2
    grey: float = 90.0  #: appearance
    texture: float = 20.0
    seed: int = 0
    material: str = "cardboard"  #: kind of texture, a name of ``textures.MATERIALS``
    bgr: tuple[float, float, float] | None = None  #: mean colour in a colour image; ``None`` = grey

    @property
    def movable(self) -> bool:
        """Whether a force can move it."""
        return not self.fixed and self.kind in (ObstacleKind.BOX, ObstacleKind.CYLINDER, ObstacleKind.DOOR)

    @property
    def dynamic_friction_N(self) -> float:
        """Force that keeps it sliding straight; infinite when fixed, 0 for a door (see its hinge)."""
        if self.kind is ObstacleKind.DOOR:
            return 0.0 if not self.fixed else math.inf
        return self.friction * self.mass_kg * GRAVITY_M_S2 if self.movable else math.inf

    @property
    def static_friction_N(self) -> float:
        """Force that starts it sliding."""
        return self.dynamic_friction_N * self.static_ratio

    @property
    def outlines(self) -> tuple[Outline, ...]:
        """Cross section at the foam's height in its own frame."""
        if self.kind is ObstacleKind.CYLINDER:
            return (Outline.disc((0.0, 0.0), 0.5 * self.length_m),)
        if self.kind is ObstacleKind.DOOR:
            leaf = (self.length_m, self.width_m)
            return (Outline.box((0.5 * self.length_m, 0.0), leaf, edge_m=self.edge_m),)
        if self.kind is ObstacleKind.TABLE:
            at = 0.5 * (np.array([self.length_m, self.width_m]) - self.leg_m)
            corners = at * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
            if self.round_legs:
                return tuple(Outline.disc((float(x), float(y)), 0.5 * self.leg_m) for x, y in corners)
            leg = (self.leg_m, self.leg_m)
            return tuple(Outline.box((float(x), float(y)), leg, edge_m=self.edge_m) for x, y in corners)
        return (Outline.box((0.0, 0.0), (self.length_m, self.width_m), edge_m=self.edge_m),)

    @property
    def reach_m(self) -> float:
        """Radius of the bounding circle about its origin."""
        far = 1.0 if self.kind is ObstacleKind.DOOR else 0.5
        return float(np.hypot(far * self.length_m, 0.5 * self.width_m))

    def moved(self, x_m: float, y_m: float, yaw_rad: float) -> SimulatedObstacle:
        """The same obstacle at another pose.

        Parameters
        ----------
        x_m, y_m
            Position in the world [m].
        yaw_rad
            Rotation about the vertical [rad].
        """
        return replace(self, x_m=x_m, y_m=y_m, yaw_rad=yaw_rad)


def box(
    name: str, x_m: float, y_m: float, size_m: tuple[float, float, float] = (0.3, 0.3, 0.3), **rest: Any
) -> SimulatedObstacle:
    """A box.

    Parameters
    ----------
    name
        Unique name.
    x_m, y_m
        Position in the world [m].
    size_m
        Length along x, length along y, height [m].
    rest
        Further fields of :class:`SimulatedObstacle`.
    """
    return _standing(ObstacleKind.BOX, name, x_m, y_m, size_m, **rest)


def cylinder(
    name: str, x_m: float, y_m: float, radius_m: float = 0.1, height_m: float = 0.3, **rest: Any
) -> SimulatedObstacle:
    """An upright cylinder.

    Parameters
    ----------
    name, x_m, y_m, rest
        As of :func:`box`.
    radius_m, height_m
        Size [m].
    """
    return _standing(ObstacleKind.CYLINDER, name, x_m, y_m, (2 * radius_m, 2 * radius_m, height_m), **rest)


def table(
    name: str, x_m: float, y_m: float, size_m: tuple[float, float, float] = (1.2, 0.7, 0.72), **rest: Any
) -> SimulatedObstacle:
    """A fixed table; the foam touches its legs.

    Parameters
    ----------
    name, x_m, y_m, size_m, rest
        As of :func:`box`.
    """
    return _standing(ObstacleKind.TABLE, name, x_m, y_m, size_m, fixed=True, **rest)


def wall(
    name: str, x_m: float, y_m: float, length_m: float = 2.0, thickness_m: float = 0.1, **rest: Any
) -> SimulatedObstacle:
    """A wall along its x.

    Parameters
    ----------
    name, x_m, y_m, rest
        As of :func:`box`; the position is that of its centre.
    length_m, thickness_m
        Size [m].
    """
    return _standing(ObstacleKind.WALL, name, x_m, y_m, (length_m, thickness_m, 1.0), fixed=True, **rest)


def door(
    name: str, hinge_x_m: float, hinge_y_m: float, length_m: float = 0.8, mass_kg: float = 12.0, **rest: Any
) -> SimulatedObstacle:
    """A door leaf that rotates about its hinge.

    Parameters
    ----------
    name, rest
        As of :func:`box`.
    hinge_x_m, hinge_y_m
        Position of the hinge in the world [m].
    length_m
        Width of the leaf [m].
    mass_kg
        Mass [kg].
    """
    size_m = (length_m, 0.04, 1.0)
    return _standing(ObstacleKind.DOOR, name, hinge_x_m, hinge_y_m, size_m, mass_kg=mass_kg, **rest)


def _standing(
    kind: ObstacleKind, name: str, x_m: float, y_m: float, size_m: tuple[float, float, float], **rest: Any
) -> SimulatedObstacle:
    length, width, height = size_m
    return SimulatedObstacle(name, kind, x_m, y_m, length_m=length, width_m=width, height_m=height, **rest)


def section(
    obstacle: SimulatedObstacle,
    position_m: Float[np.ndarray, "3"],
    rotation: Float[np.ndarray, "3 3"],
    height_m: float,
) -> tuple[Outline, ...]:
    """Section of an obstacle in a horizontal plane, in the world; empty when it lies below or above.

    Parameters
    ----------
    obstacle
        Shape.
    position_m, rotation
        Pose of its own frame in the world, (3) [m] and (3, 3); the origin is on the floor below its centre.
    height_m
        Height of the plane [m].
    """
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    tilt = math.acos(min(1.0, max(-1.0, float(rotation[2, 2]))))
    if tilt < UPRIGHT_RAD:
        if not position_m[2] < height_m < position_m[2] + obstacle.height_m:
            return ()
        # A slight tilt shifts the section by its lever arm.
        lean = rotation[:2, 2] * (height_m - position_m[2])
        x, y = float(position_m[0] + lean[0]), float(position_m[1] + lean[1])
        return tuple(outline.moved(x, y, yaw) for outline in obstacle.outlines)
    cuts = []
    for outline in obstacle.outlines:
        flat = outline.polygon_m(math.pi / 16)
        bottom = np.column_stack([flat, np.zeros(len(flat))]) @ rotation.T + position_m
        top = bottom + rotation[:, 2] * obstacle.height_m
        ring = np.concatenate([[bottom, top], [bottom, np.roll(bottom, -1, 0)], [top, np.roll(top, -1, 0)]])
        begin, end = ring[0::2].reshape(-1, 3), ring[1::2].reshape(-1, 3)
        below = (begin[:, 2] - height_m) * (end[:, 2] - height_m) < 0
        if below.sum() >= 3:
            a, b = begin[below], end[below]
            fraction = (height_m - a[:, 2]) / (b[:, 2] - a[:, 2])
            points = a[:, :2] + fraction[:, None] * (b[:, :2] - a[:, :2])
            cuts.append(Outline(_hull(points)))
    return tuple(cut for cut in cuts if len(cut.vertices_m) >= 3)


def leaning_solid(obstacle: SimulatedObstacle, T_world_obstacle: Pose, T_foam_world: Pose) -> Solid | None:
    """The body itself if an upright section does not give its appearance: it is tilted, or round and rotating.

    Parameters
    ----------
    obstacle
        Shape.
    T_world_obstacle
        Pose of its frame.
    T_foam_world
        Maps the world to frame F of the sensor.
    """
    tilt = math.acos(min(1.0, max(-1.0, float(T_world_obstacle.rotation[2, 2]))))
    if not obstacle.movable or (tilt < UPRIGHT_RAD and obstacle.kind is not ObstacleKind.CYLINDER):
        return None
    outline = obstacle.outlines[0].polygon_m()
    return Solid(outline, obstacle.height_m, T_foam_world @ T_world_obstacle)


def _hull(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "m 2"]:
    """Convex hull, counter-clockwise; empty if all points are on a line."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        return points[:0]
