"""A floor with the walls of a map, sliding objects, and a robot that drives among them.

MuJoCo moves the objects, independently of the planners. The robot follows
its wheel commands until the reaction exceeds the force of its drive: then it
stalls. Objects that are not near the robot are at rest, so that no physics is computed while
it drives through free space.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ...core import BaseState, above, check_numbers
from ...core.errors import InputError, needs
from ...core.geometry import polygon_centroid, rotation_2d
from ...io.maps.occupancy_map import OCCUPIED, OccupancyMap
from ..mobile.platform import CommandedBase, towards
from .floor_model import FloorObject, FloorRobot, floor_mjcf

#: Minimum occupancy of a wall [%], as for planners.
WALL = OCCUPIED // 2
#: Physics is computed while the rim is nearer than this to anything (m).
NEAR_M = 0.03
#: The drive stalls when the reaction is too large for this time (s).
STALL_S = 0.1


@dataclass(frozen=True, slots=True)
class FloorTouch:
    """Measurement of the rim: the sum of the forces, and its point of application."""

    force_N: float
    point_m: tuple[float, float]  #: in the map frame
    objects: tuple[str, ...]  #: true ids of the touched objects; "" for a wall


class FloorWorld:
    """The floor, in the frame of the map.

    Parameters
    ----------
    map
        Its occupied cells are walls; the objects are not part of it.
    objects
        Objects, each on feet at its corners or, round ones, on a ring of feet. They slide and rotate, but do not tip.
    start_m
        Pose of the robot (x, y, heading).
    robot
        Size and strength.

    Raises
    ------
    InputError
        ``robot`` is of another kind, such as the planner's model of it, or an object stands in a wall.
    """

    def __init__(
        self,
        map: OccupancyMap,
        objects: Sequence[FloorObject],
        start_m: Sequence[float],
        robot: FloorRobot | None = None,
    ) -> None:
        with needs("mujoco-core", "sim", "the simulated floor"):
            import mujoco
        self._mujoco: Any = mujoco
        self.robot = robot if robot is not None else FloorRobot()
        if not isinstance(self.robot, FloorRobot):
            raise InputError(
                "FloorWorld", f"found {type(robot).__name__}, expected FloorRobot", field="robot"
            )
        self.objects = tuple(objects)
        _check_places(map, self.objects)
        self._map, self._boxes = map, wall_boxes(map)
        self._model: Any = mujoco.MjModel.from_xml_string(
            floor_mjcf(map, self._boxes, self.objects, self.robot)
        )
        self._data: Any = mujoco.MjData(self._model)
        self._pose = np.array(start_m, dtype=np.float64)
        self._data.qpos[:3] = self._pose
        self._rim = np.flatnonzero(self._model.geom_bodyid == self._model.body("robot").id)
        names = [self._model.body(int(b)).name for b in self._model.geom_bodyid]
        self._owner = [name.removeprefix("object:") if name.startswith("object:") else "" for name in names]
        self._centres = [polygon_centroid(obj.footprint_m) for obj in self.objects]
        self._reach = [
            float(np.hypot(*(obj.footprint_m - centre).T).max())
            for obj, centre in zip(self.objects, self._centres, strict=True)
        ]
        self.base = FloorBase(self)
        self.speed_m_s = self.turn_rate_rad_s = 0.0
        self._back = np.zeros(2)  # force against the heading, moment against a turn to the left [N, N m]
        self.touch: FloorTouch | None = None
        #: simulated time in which the rim touched a wall (s), and physics steps that were computed
        self.wall_s, self.steps = 0.0, 0
        # Objects sink into their feet.
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

    def object_pose_m(self, id: str) -> Float[np.ndarray, "3"]:
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
        x, y, yaw = self.object_pose_m(id)
        index = self._index(id)
        own = self.objects[index].footprint_m - self._centres[index]
        return own @ rotation_2d(yaw).T + (x, y)

    def step(self, duration_s: float) -> None:
        """Advance the simulation.

        Parameters
        ----------
        duration_s
            Simulated time [s].
        """
        check_numbers("FloorWorld.step", above(0, 10), duration_s=duration_s)
        step_s = float(self._model.opt.timestep)
        for _ in range(max(1, round(duration_s / step_s))):
            if self._gap() > NEAR_M:
                self.touch, self._back = None, np.zeros(2)
                self._coast(step_s)
            else:
                self._physics(step_s)

    def _index(self, id: str) -> int:
        for index, obj in enumerate(self.objects):
            if obj.id == id:
                return index
        names = ", ".join(obj.id for obj in self.objects) or "none"
        raise InputError("FloorWorld", f"found no object '{id}', expected one of: {names}")

    def _gap(self) -> float:
        """Distance from the circle around the robot to the nearest wall or object, or a lower bound."""
        x, y = float(self._pose[0]), float(self._pose[1])
        gap = math.inf
        for index, reach in enumerate(self._reach):
            at = 3 + 4 * index
            du = self._centres[index][0] + float(self._data.qpos[at]) - x
            dv = self._centres[index][1] + float(self._data.qpos[at + 1]) - y
            gap = min(gap, math.hypot(du, dv) - reach)
        if gap - self.robot.reach_m > NEAR_M and len(self._boxes):
            ox, oy, yaw = self._map.origin
            c, s = math.cos(yaw), math.sin(yaw)
            u, v = c * (x - ox) + s * (y - oy), c * (y - oy) - s * (x - ox)
            b = self._boxes
            wide = np.maximum(np.maximum(b[:, 0] - u, u - b[:, 2]), 0.0)
            high = np.maximum(np.maximum(b[:, 1] - v, v - b[:, 3]), 0.0)
            gap = min(gap, math.sqrt(float((wide * wide + high * high).min())))
        return gap - self.robot.reach_m

    def _ramp(self, step_s: float) -> None:
        base, robot = self.base, self.robot
        self.speed_m_s = towards(self.speed_m_s, base.target_speed_m_s, robot.acceleration_m_s2 * step_s)
        self.turn_rate_rad_s = towards(
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
        """Its mass is several tons, and it is moved kinematically by its wheels."""
        self._pose += way
        self._data.qpos[:3] = self._pose

    def _feel(self, step_s: float) -> None:
        data, force = self._data, np.zeros(6)
        total, moment, back = 0.0, np.zeros(2), np.zeros(2)
        heading = np.array([math.cos(self._pose[2]), math.sin(self._pose[2])])
        touched: set[str] = set()
        geoms = data.contact.geom
        for c in np.flatnonzero(np.isin(geoms, self._rim).any(axis=1)):
            contact = data.contact[c]
            one, other = geoms[c]
            self._mujoco.mj_contactForce(self._model, data, c, force)
            if force[0] < 1e-3:
                continue
            first = one in self._rim
            owner = self._owner[other if first else one]
            touched.add(owner)
            total += force[0]
            moment += force[0] * contact.pos[:2]
            # The contact frame's first axis points from the first to the second: the force on the robot is opposite to it.
            outward = np.asarray(contact.frame[:2]) * (1.0 if first else -1.0)
            outward = outward / max(float(np.hypot(*outward)), 1e-9)
            lever = np.asarray(contact.pos[:2]) - self._pose[:2]
            back += force[0] * np.array([outward @ heading, lever[0] * outward[1] - lever[1] * outward[0]])
        if "" in touched:
            self.wall_s += step_s
        point = moment / total if total > 0 else moment
        self.touch = (
            FloorTouch(float(total), (float(point[0]), float(point[1])), tuple(sorted(touched)))
            if total > 0
            else None
        )
        # Sustained force counts, not the impact of the first contact.
        self._back += (back - self._back) * min(1.0, step_s / STALL_S)
        # The wheels slip: it stops, and the overshoot is taken back.
        if self._back[0] * math.copysign(1.0, self.speed_m_s) > self.robot.force_max_N:
            self._pose[:2] -= self.speed_m_s * step_s * heading
            self.speed_m_s = 0.0
        moment_max_Nm = self.robot.force_max_N * self.robot.radius_m
        if self._back[1] * math.copysign(1.0, self.turn_rate_rad_s) > moment_max_Nm:
            self._pose[2] -= self.turn_rate_rad_s * step_s
            self.turn_rate_rad_s = 0.0
        self._data.qpos[:3] = self._pose


def _check_places(map: OccupancyMap, objects: Sequence[FloorObject]) -> None:
    """Refuse objects that stand in walls: contacts would press them out with any force."""
    import shapely

    walls_m = map.world_from_cell(np.argwhere(map.cells >= WALL))
    for obj in objects:
        outline = shapely.Polygon(obj.footprint_m)
        if obj.round_m > 0:
            outline = shapely.Point(polygon_centroid(obj.footprint_m)).buffer(obj.round_m)
        inside = np.flatnonzero(shapely.contains_xy(outline, walls_m))
        if len(inside):
            (x, y), count = walls_m[inside[0]], len(inside)
            found = f"found '{obj.id}' on {count} cells of walls, such as ({x:.2f}, {y:.2f}) m, expected free floor"
            raise InputError("FloorWorld", found, field="objects")


class FloorBase(CommandedBase):
    """The robot of a :class:`FloorWorld` as a ``robots.MobileBase``.

    Parameters
    ----------
    world
        Simulated world that moves the platform.
    """

    def __init__(self, world: FloorWorld) -> None:
        self._world = world

    def state(self) -> BaseState:
        """Exact odometry in the map frame."""
        world = self._world
        x, y, heading = (float(v) for v in world.pose_m())
        return BaseState(world.t_s, x, y, heading, world.speed_m_s, world.turn_rate_rad_s)


def wall_boxes(map: OccupancyMap) -> Float[np.ndarray, "n 4"]:
    """Occupied cells that can be touched, merged; those farther than two cells from every other cell are omitted.

    Parameters
    ----------
    map
        Cells of :data:`WALL` and more are walls.

    Returns
    -------
    (x0, y0, x1, y1) [m] in the frame of the grid: from the outer corner of cell
    (0, 0), along its rows and columns; transform by ``map.origin``.
    """
    from scipy.ndimage import binary_dilation

    wall = map.cells >= WALL
    near = binary_dilation(~wall, iterations=2)
    return merged_rectangles(wall & near) * map.resolution_m


def merged_rectangles(cells: Bool[np.ndarray, "rows columns"]) -> Float[np.ndarray, "n 4"]:
    """Rectangles (x0, y0, x1, y1) [cells] that cover the true cells once each.

    Runs along the rows, joined with the run above where both have the same ends.

    Parameters
    ----------
    cells
        Mask (rows, columns) of the cells to cover.
    """
    padded = np.pad(cells, ((0, 0), (1, 1))).astype(np.int8)
    change = np.diff(padded, axis=1)
    found: list[tuple[int, int, int, int]] = []
    open_: dict[tuple[int, int], int] = {}
    for row in range(cells.shape[0] + 1):
        runs: set[tuple[int, int]] = set()
        if row < cells.shape[0]:
            begins, ends = np.flatnonzero(change[row] == 1), np.flatnonzero(change[row] == -1)
            runs = set(zip(begins.tolist(), ends.tolist(), strict=True))
        for run in [run for run in open_ if run not in runs]:
            found.append((run[0], open_.pop(run), run[1], row))
        for run in runs:
            open_.setdefault(run, row)
    return np.array(sorted(found), dtype=np.float64).reshape(-1, 4)
