"""Objects and robot on a floor, and their MuJoCo model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ...core.geometry import polygon_centroid
from ...core.measurement import GRAVITY_M_S2
from ...io.maps.occupancy_map import OccupancyMap
from ..mobile.obstacles import FOOT_M

#: Height of the rim's equator and of the objects' outlines: they meet there (m).
PUSH_HEIGHT_M = 0.04
#: Outlines are rounded by this (m).
EDGE_M = 0.006
#: Time constant of the contact with the rim (s): 10 N press it in by 3 mm with an object of 3 kg.
FOAM_S = 0.03
#: Time constant of the feet (s): they sink in by 4 mm, so that sliding, which lifts an object in MuJoCo's
#: convex contacts, does not make it hop.
SINK_S = 0.02
#: Time step of the physics (s).
STEP_S = 0.004
#: Walls are as hard as furniture: friction of outlines against them and each other.
WALL_FRICTION = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class FloorObject:
    """An object that stands on the floor."""

    id: str
    footprint_m: Float[np.ndarray, "p 2"]  #: initial outline, map frame
    mass_kg: float
    floor_friction: float
    contact_friction: float = 0.3  #: with the robot's rim
    centre_offset_m: tuple[float, float] = (0.0, 0.0)  #: of mass, from the outline's centroid
    #: radius of a round object, about the centroid; its footprint is not used for contact
    round_m: float = 0.0

    def __post_init__(self) -> None:
        if (
            not min(self.mass_kg, self.floor_friction) > 0
            or min(self.contact_friction, self.round_m) < 0
            or len(self.footprint_m) < 3
        ):
            raise InputError("FloorObject", f"found {self}, expected an outline, mass and floor friction > 0")

    @property
    def friction_N(self) -> float:
        """Force required to move it."""
        return self.mass_kg * GRAVITY_M_S2 * self.floor_friction


@dataclass(frozen=True, slots=True)
class FloorRobot:
    """A robot on two wheels: round, or with a convex outline."""

    radius_m: float = 0.17  #: half the distance between its wheels
    force_max_N: float = 20.0  #: of the drive; it stalls above this force
    acceleration_m_s2: float = 0.5
    turn_acceleration_rad_s2: float = 2.0
    #: corners x, y in its frame, counter-clockwise, x forwards [m]; empty: a disc
    footprint_m: tuple[tuple[float, float], ...] = ()

    @property
    def reach_m(self) -> float:
        """Radius of the circle about its centre that contains it [m]."""
        return max((math.hypot(x, y) for x, y in self.footprint_m), default=self.radius_m)


def floor_mjcf(
    map: OccupancyMap,
    boxes: Float[np.ndarray, "n 4"],
    objects: Sequence[FloorObject],
    robot: FloorRobot,
) -> str:
    """MuJoCo model; contact bit 1 is the floor with the feet, bit 2 the objects on it.

    Parameters
    ----------
    map
        Pose of the map in the world.
    boxes
        Walls (x0, y0, x1, y1) in the frame of the map [m].
    objects
        Objects with different names.
    robot
        Size of the robot.
    """
    x, y, yaw = map.origin
    height = PUSH_HEIGHT_M
    walls = "".join(
        f'<geom type="box" pos="{(x0 + x1) / 2} {(y0 + y1) / 2} {height}" '
        f'size="{(x1 - x0) / 2} {(y1 - y0) / 2} {height}" contype="2" conaffinity="2" '
        f'friction="{WALL_FRICTION} 0 0"/>'
        for x0, y0, x1, y1 in boxes
    )
    bodies = "".join(_object_mjcf(obj) for obj in objects)
    return f"""<mujoco><compiler angle="radian" inertiafromgeom="false"/>
    <option timestep="{STEP_S}" cone="elliptic" impratio="5" integrator="implicitfast"
      gravity="0 0 {-GRAVITY_M_S2}"/>
    <default><geom condim="3" solref="0.01 1" solimp="0.95 0.99 0.001"/></default>
    <worldbody>
    <geom type="plane" size="500 500 1" contype="1" conaffinity="0"/>
    <body pos="{x} {y} 0" euler="0 0 {yaw}">{walls}</body>
    <body name="robot"><inertial pos="0 0 0" mass="1e5" diaginertia="1e4 1e4 1e4"/>
      <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="hinge" axis="0 0 1"/>
      {_rim(robot)}</body>
    {bodies}</worldbody></mujoco>"""


def _rim(robot: FloorRobot) -> str:
    """A sphere, or a thin upright board inside each edge of the outline."""
    touches = 'contype="2" conaffinity="2" friction="0 0 0"'
    if not robot.footprint_m:
        return f'<geom type="sphere" size="{robot.radius_m}" pos="0 0 {PUSH_HEIGHT_M}" {touches}/>'
    boards = []
    for (ax, ay), (bx, by) in pairwise((*robot.footprint_m, robot.footprint_m[0])):
        yaw, half = math.atan2(by - ay, bx - ax), 0.5 * math.hypot(bx - ax, by - ay)
        x, y = 0.5 * (ax + bx) - EDGE_M * math.sin(yaw), 0.5 * (ay + by) + EDGE_M * math.cos(yaw)
        boards.append(
            f'<geom type="box" pos="{x} {y} {PUSH_HEIGHT_M}" euler="0 0 {yaw}" '
            f'size="{half} {EDGE_M} {0.75 * PUSH_HEIGHT_M}" {touches}/>'
        )
    return "".join(boards)


def _object_mjcf(obj: FloorObject) -> str:
    """A ring of capsules, or a sphere, on feet: pairs with closed-form contacts."""
    centre, height = polygon_centroid(obj.footprint_m), PUSH_HEIGHT_M
    own = obj.footprint_m - centre
    # Foam is between rim and outline: soft, so that forces are measured and no impacts.
    shape = (
        f'mass="0" contype="2" conaffinity="2" priority="1" solref="{FOAM_S} 1" solimp="0.8 0.8 0.001" '
        f'friction="{obj.contact_friction} 0 0"'
    )
    if obj.round_m > 0:
        parts = f'<geom type="sphere" size="{obj.round_m}" pos="0 0 {height}" {shape}/>'
        angle = np.arange(6) * (math.pi / 3)
        feet = 0.7 * obj.round_m * np.column_stack([np.cos(angle), np.sin(angle)])
    else:
        inner = _inset(own)
        parts = "".join(
            f'<geom type="capsule" size="{EDGE_M}" fromto="{a[0]} {a[1]} {height} {b[0]} {b[1]} {height}" '
            f"{shape}/>"
            for a, b in zip(inner, np.roll(inner, -1, axis=0), strict=True)
        )
        feet = 0.8 * own
    # It stands upright with even load on its feet: they are placed relative to the centre of mass.
    feet = feet + np.asarray(obj.centre_offset_m)
    stand = "".join(
        f'<geom type="sphere" size="{FOOT_M}" pos="{u} {v} {FOOT_M}" mass="0" contype="0" conaffinity="1" '
        f'priority="1" solref="{SINK_S} 1" solimp="0.6 0.6 0.001" friction="{obj.floor_friction} 0 0"/>'
        for u, v in feet
    )
    extent = float((own**2).sum(axis=1).mean()) / 2
    inertia = obj.mass_kg * extent
    cx, cy = obj.centre_offset_m
    joints = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
    return (
        f'<body name="object:{obj.id}" pos="{centre[0]} {centre[1]} 0">{joints}'
        f'<joint type="hinge" axis="0 0 1"/><inertial pos="{cx} {cy} 0.05" mass="{obj.mass_kg}" '
        f'diaginertia="{inertia} {inertia} {inertia}"/>{parts}{stand}</body>'
    )


def _inset(outline: Float[np.ndarray, "p 2"]) -> Float[np.ndarray, "q 2"]:
    """The outline moved inwards by the radius of its capsules, so that capsules along it end at the outline."""
    import shapely

    inner = shapely.Polygon(outline).buffer(-EDGE_M, join_style="mitre")
    if inner.is_empty or inner.geom_type != "Polygon":
        return outline
    return np.array(inner.exterior.coords)[:-1]
