"""A floor with the walls of a map, things that slide on it, and a round robot that drives among them.

MuJoCo moves the things; it knows nothing of the planners. The robot moves as
its wheels are told until something pushes back harder than its drive: then it
stands. What is not near the robot rests, so that no physics is computed while
it drives through free space.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError, MissingExtraError
from ...core.robots import BaseState
from ...io.maps.occupancy_map import OccupancyMap
from .walls import wall_boxes

__all__ = ["FloorBase", "FloorObject", "FloorRobot", "FloorTouch", "FloorWorld"]

GRAVITY_M_S2 = 9.81
#: Height of the rim's equator and of the things' outlines: they meet there (m).
PUSH_HEIGHT_M = 0.04
#: Outlines are rounded by this, feet are spheres of that radius (m).
EDGE_M, FOOT_M = 0.006, 0.004
#: Physics is computed while the rim is nearer than this to anything (m).
NEAR_M = 0.03
#: Time constant of the contact with the rim (s): 10 N press it in by 3 mm with a thing of 3 kg.
FOAM_S = 0.03
#: Time constant of the feet (s): they sink in by 4 mm, so that sliding, which lifts a thing in MuJoCo's
#: convex contacts, does not let it hop.
SINK_S = 0.02
#: The drive stands when it is pushed back too hard for so long (s).
STALL_S = 0.1
#: Walls are as hard as furniture is: friction of outlines against them and each other.
WALL_FRICTION = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class FloorObject:
    """Something that stands on the floor."""

    id: str
    footprint_m: Float[np.ndarray, "p 2"]  #: outline where it stands at first, map frame
    mass_kg: float
    floor_friction: float
    contact_friction: float = 0.3  #: with the robot's rim
    centre_offset_m: tuple[float, float] = (0.0, 0.0)  #: of mass, from the outline's centroid
    round_m: float = (
        0.0  #: radius of a round thing, about the centroid; its footprint is not used for contact
    )

    def __post_init__(self) -> None:
        if (
            not min(self.mass_kg, self.floor_friction) > 0
            or min(self.contact_friction, self.round_m) < 0
            or len(self.footprint_m) < 3
        ):
            raise InputError("FloorObject", f"found {self}, expected an outline, mass and floor friction > 0")

    @property
    def friction_N(self) -> float:
        """Force that moves it."""
        return self.mass_kg * GRAVITY_M_S2 * self.floor_friction


@dataclass(frozen=True, slots=True)
class FloorRobot:
    """A round robot on two wheels."""

    radius_m: float = 0.17
    force_max_N: float = 20.0  #: of the drive; pushed back harder it stands
    acceleration_m_s2: float = 0.5
    turn_acceleration_rad_s2: float = 2.0


@dataclass(frozen=True, slots=True)
class FloorTouch:
    """What the rim feels: the sum of the forces, and where it acts."""

    force_N: float
    point_m: tuple[float, float]  #: in the map frame
    items: tuple[str, ...]  #: true ids of what is touched; "" for a wall


class FloorWorld:
    """The floor, in the frame of the map.

    Parameters
    ----------
    map
        Its occupied cells are walls; things must not be among them.
    items
        What may be pushed, each on feet at its corners or, round ones, on a ring of them. They slide and turn, but do not tip.
    start_m
        Pose of the robot (x, y, heading).
    robot
        Size and strength.
    time_step_s
        Of the physics.
    """

    def __init__(
        self,
        map: OccupancyMap,
        items: Sequence[FloorObject],
        start_m: Sequence[float],
        robot: FloorRobot | None = None,
        *,
        time_step_s: float = 0.004,
    ) -> None:
        try:
            import mujoco
        except ImportError as error:
            raise MissingExtraError("mujoco", "sim", "the simulated floor") from error
        self._mujoco: Any = mujoco
        self.robot = robot if robot is not None else FloorRobot()
        self.items = tuple(items)
        self._map, self._boxes = map, wall_boxes(map)
        self._model: Any = mujoco.MjModel.from_xml_string(
            _mjcf(map, self._boxes, self.items, self.robot, time_step_s)
        )
        self._data: Any = mujoco.MjData(self._model)
        self._pose = np.array(start_m, dtype=np.float64)
        self._data.qpos[:3] = self._pose
        self._rim = int(self._model.geom("rim").id)
        names = [self._model.body(int(b)).name for b in self._model.geom_bodyid]
        self._owner = [name[5:] if name.startswith("item:") else "" for name in names]
        self._centres = [_centroid(item.footprint_m) for item in self.items]
        self._reach = [
            float(np.hypot(*(item.footprint_m - centre).T).max())
            for item, centre in zip(self.items, self._centres, strict=True)
        ]
        self.base = FloorBase(self)
        self.speed_m_s = self.turn_rate_rad_s = 0.0
        self._back_N = 0.0
        self.touch: FloorTouch | None = None
        #: simulated time in which the rim touched a wall (s), and physics steps that were computed
        self.wall_s, self.steps = 0.0, 0
        # Things sink into their feet.
        for _ in range(50):
            mujoco.mj_step(self._model, self._data)
            self._hold(np.zeros(3))

    @property
    def t_s(self) -> float:
        """Time of the world."""
        return float(self._data.time)

    def pose_m(self) -> Float[np.ndarray, "3"]:
        """True pose of the robot (x, y, heading)."""
        return self._pose.copy()

    def item_pose_m(self, id: str) -> Float[np.ndarray, "3"]:
        """True pose of an object: the centroid of its outline [m], and its rotation since the start [rad].

        Parameters
        ----------
        id
            Name of the object.
        """
        index = self._index(id)
        x, y, _, yaw = self._data.qpos[3 + 4 * index : 7 + 4 * index]
        return np.array([*(self._centres[index] + (x, y)), yaw])

    def footprint_m(self, id: str) -> Float[np.ndarray, "p 2"]:
        """True present outline of an object [m].

        Parameters
        ----------
        id
            Name of the object.
        """
        x, y, yaw = self.item_pose_m(id)
        c, s = math.cos(yaw), math.sin(yaw)
        index = self._index(id)
        own = self.items[index].footprint_m - self._centres[index]
        return own @ np.array([[c, s], [-s, c]]) + (x, y)

    def step(self, duration_s: float) -> None:
        """Let time pass.

        Parameters
        ----------
        duration_s
            Simulated time [s].
        """
        if not 0 < duration_s <= 10:
            raise InputError(
                "FloorWorld.step", f"found {duration_s} s, expected more than 0 and at most 10 s"
            )
        step_s = float(self._model.opt.timestep)
        for _ in range(max(1, round(duration_s / step_s))):
            if self._gap() > NEAR_M:
                self.touch, self._back_N = None, 0.0
                self._coast(step_s)
            else:
                self._physics(step_s)

    def _index(self, id: str) -> int:
        for index, item in enumerate(self.items):
            if item.id == id:
                return index
        names = ", ".join(item.id for item in self.items) or "none"
        raise InputError("FloorWorld", f"has no thing '{id}', there are: {names}")

    def _gap(self) -> float:
        """Distance from the rim to the nearest wall or thing, or less."""
        x, y = float(self._pose[0]), float(self._pose[1])
        gap = math.inf
        for index, reach in enumerate(self._reach):
            at = 3 + 4 * index
            du = self._centres[index][0] + float(self._data.qpos[at]) - x
            dv = self._centres[index][1] + float(self._data.qpos[at + 1]) - y
            gap = min(gap, math.hypot(du, dv) - reach)
        if gap - self.robot.radius_m > NEAR_M and len(self._boxes):
            ox, oy, yaw = self._map.origin
            c, s = math.cos(yaw), math.sin(yaw)
            u, v = c * (x - ox) + s * (y - oy), c * (y - oy) - s * (x - ox)
            b = self._boxes
            wide = np.maximum(np.maximum(b[:, 0] - u, u - b[:, 2]), 0.0)
            high = np.maximum(np.maximum(b[:, 1] - v, v - b[:, 3]), 0.0)
            gap = min(gap, math.sqrt(float((wide * wide + high * high).min())))
        return gap - self.robot.radius_m

    def _ramp(self, step_s: float) -> None:
        base, robot = self.base, self.robot
        self.speed_m_s = _towards(self.speed_m_s, base.target_speed_m_s, robot.acceleration_m_s2 * step_s)
        self.turn_rate_rad_s = _towards(
            self.turn_rate_rad_s, base.target_turn_rate_rad_s, robot.turn_acceleration_rad_s2 * step_s
        )

    def _velocity(self) -> Float[np.ndarray, "3"]:
        heading = float(self._pose[2])
        return np.array(
            [self.speed_m_s * math.cos(heading), self.speed_m_s * math.sin(heading), self.turn_rate_rad_s]
        )

    def _coast(self, step_s: float) -> None:
        self._ramp(step_s)
        self._pose += self._velocity() * step_s
        self._data.qpos[:3] = self._pose
        self._data.qvel[:] = 0.0
        self._data.time += step_s

    def _physics(self, step_s: float) -> None:
        self._ramp(step_s)
        velocity = self._velocity()
        self._data.qvel[:3] = velocity
        self._mujoco.mj_step(self._model, self._data)
        self.steps += 1
        self._hold(velocity * step_s)
        self._feel(step_s)

    def _hold(self, way: Float[np.ndarray, "3"]) -> None:
        """It weighs tons, and is where its wheels bring it."""
        self._pose += way
        self._data.qpos[:3] = self._pose

    def _feel(self, step_s: float) -> None:
        data, force = self._data, np.zeros(6)
        total, moment, back = 0.0, np.zeros(2), 0.0
        heading = np.array([math.cos(self._pose[2]), math.sin(self._pose[2])])
        touched: set[str] = set()
        for c in range(data.ncon):
            contact = data.contact[c]
            one, other = (int(g) for g in contact.geom)
            if self._rim not in (one, other):
                continue
            self._mujoco.mj_contactForce(self._model, data, c, force)
            if force[0] < 1e-3:
                continue
            owner = self._owner[other if one == self._rim else one]
            touched.add(owner)
            total += force[0]
            moment += force[0] * contact.pos[:2]
            # Of what the contact frame's axes say: on the robot it acts against the rim's outward normal.
            outward = np.asarray(contact.pos[:2]) - self._pose[:2]
            back += force[0] * float(outward @ heading) / max(float(np.hypot(*outward)), 1e-9)
        if "" in touched:
            self.wall_s += step_s
        point = moment / total if total > 0 else moment
        self.touch = (
            FloorTouch(float(total), (float(point[0]), float(point[1])), tuple(sorted(touched)))
            if total > 0
            else None
        )
        # What lasts counts, not the blow of the first touch.
        self._back_N += (back - self._back_N) * min(1.0, step_s / STALL_S)
        if self._back_N * math.copysign(1.0, self.speed_m_s) > self.robot.force_max_N:
            # The wheels slip: it stands, and gives back what it has gone too far.
            self._pose[:2] -= self.speed_m_s * step_s * heading
            self._data.qpos[:3] = self._pose
            self.speed_m_s = 0.0


class FloorBase:
    """The robot of a :class:`FloorWorld` as a ``robots.MobileBase``.

    Parameters
    ----------
    world
        Simulated world that moves the platform.
    """

    def __init__(self, world: FloorWorld) -> None:
        self._world = world
        self.target_speed_m_s = self.target_turn_rate_rad_s = 0.0

    def drive(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """Set the velocities; they hold until the next call or :meth:`stop`.

        Parameters
        ----------
        speed_m_s
            Forward speed [m/s].
        turn_rate_rad_s
            Turn rate [rad/s].
        """
        if not (math.isfinite(speed_m_s) and math.isfinite(turn_rate_rad_s)):
            raise InputError(
                "drive", f"found {speed_m_s} m/s and {turn_rate_rad_s} rad/s, expected finite numbers"
            )
        self.target_speed_m_s, self.target_turn_rate_rad_s = float(speed_m_s), float(turn_rate_rad_s)

    def stop(self) -> None:
        """Stand still as soon as the acceleration allows."""
        self.drive(0.0, 0.0)

    def state(self) -> BaseState:
        """Exact odometry in the map frame."""
        world = self._world
        x, y, heading = (float(v) for v in world.pose_m())
        return BaseState(world.t_s, x, y, heading, world.speed_m_s, world.turn_rate_rad_s)


def _towards(now: float, target: float, step: float) -> float:
    return now + max(-step, min(step, target - now))


def _centroid(p: Float[np.ndarray, "p 2"]) -> Float[np.ndarray, "2"]:
    q = np.roll(p, -1, axis=0)
    cross = (p[:, 0] - p[0, 0]) * (q[:, 1] - p[0, 1]) - (q[:, 0] - p[0, 0]) * (p[:, 1] - p[0, 1])
    return p[0] + ((p + q - 2 * p[0]) * cross[:, None]).sum(axis=0) / (3 * cross.sum())


def _mjcf(
    map: OccupancyMap,
    boxes: Float[np.ndarray, "n 4"],
    items: Sequence[FloorObject],
    robot: FloorRobot,
    step_s: float,
) -> str:
    """The model. Bit 1 is the floor with the feet, bit 2 what stands on it."""
    x, y, yaw = map.origin
    height = PUSH_HEIGHT_M
    walls = "".join(
        f'<geom type="box" pos="{(x0 + x1) / 2} {(y0 + y1) / 2} {height}" '
        f'size="{(x1 - x0) / 2} {(y1 - y0) / 2} {height}" contype="2" conaffinity="2" '
        f'friction="{WALL_FRICTION} 0 0"/>'
        for x0, y0, x1, y1 in boxes
    )
    bodies = "".join(_item_mjcf(item) for item in items)
    return f"""<mujoco><compiler angle="radian" inertiafromgeom="false"/>
    <option timestep="{step_s}" cone="elliptic" impratio="5" integrator="implicitfast"
      gravity="0 0 {-GRAVITY_M_S2}"/>
    <default><geom condim="3" solref="0.01 1" solimp="0.95 0.99 0.001"/></default>
    <worldbody>
    <geom type="plane" size="500 500 1" contype="1" conaffinity="0"/>
    <body pos="{x} {y} 0" euler="0 0 {yaw}">{walls}</body>
    <body name="robot"><inertial pos="0 0 0" mass="1e5" diaginertia="1e4 1e4 1e4"/>
      <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="hinge" axis="0 0 1"/>
      <geom name="rim" type="sphere" size="{robot.radius_m}" pos="0 0 {height}" contype="2" conaffinity="2"
        friction="0 0 0"/></body>
    {bodies}</worldbody></mujoco>"""


def _item_mjcf(item: FloorObject) -> str:
    """A ring of capsules, or a sphere, on feet: pairs with closed formulas for their contact."""
    centre, height = _centroid(item.footprint_m), PUSH_HEIGHT_M
    own = item.footprint_m - centre
    # Foam is between rim and outline: soft, so that it feels forces and no blows.
    shape = (
        f'mass="0" contype="2" conaffinity="2" priority="1" solref="{FOAM_S} 1" solimp="0.8 0.8 0.001" '
        f'friction="{item.contact_friction} 0 0"'
    )
    if item.round_m > 0:
        parts = f'<geom type="sphere" size="{item.round_m}" pos="0 0 {height}" {shape}/>'
        angle = np.arange(6) * (math.pi / 3)
        feet = 0.7 * item.round_m * np.column_stack([np.cos(angle), np.sin(angle)])
    else:
        inner = _inset(own, EDGE_M)
        parts = "".join(
            f'<geom type="capsule" size="{EDGE_M}" fromto="{a[0]} {a[1]} {height} {b[0]} {b[1]} {height}" '
            f"{shape}/>"
            for a, b in zip(inner, np.roll(inner, -1, axis=0), strict=True)
        )
        feet = 0.8 * own
    # It stands upright and evenly on its feet: they move with the centre of mass.
    feet = feet + np.asarray(item.centre_offset_m)
    stand = "".join(
        f'<geom type="sphere" size="{FOOT_M}" pos="{u} {v} {FOOT_M}" mass="0" contype="0" conaffinity="1" '
        f'priority="1" solref="{SINK_S} 1" solimp="0.6 0.6 0.001" friction="{item.floor_friction} 0 0"/>'
        for u, v in feet
    )
    extent = float((own**2).sum(axis=1).mean()) / 2
    inertia = item.mass_kg * extent
    cx, cy = item.centre_offset_m
    joints = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
    return (
        f'<body name="item:{item.id}" pos="{centre[0]} {centre[1]} 0">{joints}'
        f'<joint type="hinge" axis="0 0 1"/><inertial pos="{cx} {cy} 0.05" mass="{item.mass_kg}" '
        f'diaginertia="{inertia} {inertia} {inertia}"/>{parts}{stand}</body>'
    )


def _inset(outline: Float[np.ndarray, "p 2"], by_m: float) -> Float[np.ndarray, "q 2"]:
    """The outline moved inwards, so that capsules about it end where the outline is."""
    import shapely

    inner = shapely.Polygon(outline).buffer(-by_m, join_style="mitre")
    if inner.is_empty or inner.geom_type != "Polygon":
        return outline
    return np.array(inner.exterior.coords)[:-1]
