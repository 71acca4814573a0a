"""Rigid bodies on a floor in MuJoCo: a disc drives along paths with limited force, and pushes obstacles.

Bodies stand on feet with Coulomb friction, their mass off the centroid where specified; outlines are capsules
and discs are spheres, whose contacts have closed formulas. The rim is fixed to the robot: while the robot turns, it rolls
along what it touches. This module is independent of the planner: ``drive``, without turning, returns whether the end of the
path was reached, and ``bodies`` the positions of the objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import mujoco
import numpy as np
import shapely

from .maps import GRAVITY_M_S2, Body, Robot

__all__ = ["CONTACT_FRICTION", "FloorPhysics", "feet_of"]

#: Height of the contact with the robot [m]: low, so that pushing moves little load from foot to foot.
PUSH_HEIGHT_M = 0.02
FOOT_M, EDGE_M, INSET_M = 0.004, 0.004, 0.015
STEP_S, CONTROL_STEPS = 0.001, 4
#: Gains of the platform's servo: 20 N cause 4 mm of lag, critically damped.
ROBOT_KG, STIFFNESS_N_M = 5.0, 5000.0
DAMPING_N_S_M = 2.0 * (ROBOT_KG * STIFFNESS_N_M) ** 0.5
#: Of its heading: the largest force, at the rim, turns it by a hundredth of a radian; moment of inertia of a disc.
YAW_STIFFNESS_N = 2000.0
#: A platform that lags its reference by more than this is blocked [m].
STUCK_M = 0.03
CONTACT_FRICTION, WALL_FRICTION = 0.2, 0.2


class FloorPhysics:
    """Simulation of a floor.

    Parameters
    ----------
    solid
        Walls, convex polygons [m].
    bodies
        What stands on the floor; ``fixed`` ones are walls.
    robot, at_m
        The disc and where its centre is.
    contact_friction
        Between robot and bodies.
    """

    def __init__(
        self,
        solid: Sequence[shapely.Polygon],
        bodies: Sequence[Body],
        robot: Robot,
        at_m: Sequence[float],
        *,
        contact_friction: float = CONTACT_FRICTION,
    ) -> None:
        self.robot, self.first = robot, tuple(bodies)
        walls = [*solid, *(body.polygon for body in bodies if body.fixed)]
        self.moving = [body for body in bodies if not body.fixed]
        text = _mjcf(walls, self.moving, robot, at_m, contact_friction)
        self.model = mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self.start, self._heading = np.asarray(at_m, dtype=float), 0.0
        self.run(0.2)  # the feet settle

    @property
    def robot_m(self) -> np.ndarray:
        """The robot's centre."""
        return self.start + self.data.qpos[:2]

    def pose(self, index: int) -> tuple[np.ndarray, float]:
        """Centroid [m] and angle [rad] of a moving body."""
        q = self.data.qpos[3 + 7 * index : 10 + 7 * index]
        return q[:2].copy(), float(2.0 * np.arctan2(q[6], q[3]))

    @property
    def bodies(self) -> tuple[Body, ...]:
        """All bodies at their current poses."""
        now = {}
        for index, body in enumerate(self.moving):
            centre, turn = self.pose(index)
            now[body.id] = body.moved(centre - body.centre_m, turn)
        return tuple(now.get(body.id, body) for body in self.first)

    def launch(self, index: int, velocity_m_s: Sequence[float]) -> None:
        """Give a body a velocity."""
        self.data.qvel[3 + 6 * index : 5 + 6 * index] = velocity_m_s

    def run(self, seconds: float) -> None:
        """Advance the time; the robot holds its position."""
        hold = self.robot_m.copy()
        for _ in range(int(seconds / (STEP_S * CONTROL_STEPS))):
            self._control(hold, np.zeros(2))

    @property
    def touch(self) -> tuple[float, np.ndarray | None]:
        """Force against the robot's rim [N] and its place [m]; none without."""
        total, moment, force = 0.0, np.zeros(2), np.zeros(6)
        robot = self.model.body("robot").id
        for index, contact in enumerate(self.data.contact):
            if robot in self.model.geom_bodyid[contact.geom]:
                mujoco.mj_contactForce(self.model, self.data, index, force)
                total, moment = total + force[0], moment + force[0] * contact.pos[:2]
        return total, moment / total if total > 0.0 else None

    def follow(
        self, at_m: np.ndarray, velocity_m_s: np.ndarray, seconds: float, rate_rad_s: float = 0.0
    ) -> None:
        """Let the robot follow a moving and turning reference from its current position and heading."""
        period = STEP_S * CONTROL_STEPS
        for step in range(1, round(seconds / period) + 1):
            self._heading += period * rate_rad_s
            self._control(at_m + step * period * velocity_m_s, velocity_m_s, rate_rad_s)

    def drive(self, path_m: np.ndarray, speed_m_s: float) -> bool:
        """Follow a path with the robot's centre; False if it is blocked."""
        path = np.asarray(path_m, dtype=float)
        lengths = np.hypot(*np.diff(path, axis=0).T)
        along = np.concatenate([[0.0], np.cumsum(lengths)])
        step = speed_m_s * STEP_S * CONTROL_STEPS
        for s in np.arange(step, along[-1] + step, step):
            at = np.array([np.interp(s, along, path[:, axis]) for axis in (0, 1)])
            part = min(int(np.searchsorted(along, s, side="right")) - 1, len(lengths) - 1)
            velocity = (path[part + 1] - path[part]) / max(lengths[part], 1e-12) * speed_m_s
            self._control(at, velocity if s < along[-1] else np.zeros(2))
            if np.hypot(*(self.robot_m - at)) > STUCK_M:
                self.run(0.2)
                return False
        self.run(0.2)
        return bool(np.hypot(*(self.robot_m - path[-1])) < STUCK_M)

    def _control(self, at_m: np.ndarray, velocity_m_s: np.ndarray, rate_rad_s: float = 0.0) -> None:
        force = STIFFNESS_N_M * (at_m - self.robot_m) + DAMPING_N_S_M * (velocity_m_s - self.data.qvel[:2])
        size = float(np.hypot(*force))
        self.data.qfrc_applied[:2] = force * min(1.0, self.robot.push_force_max_N / max(size, 1e-12))
        arm, inertia = self.robot.radius_m, 0.5 * ROBOT_KG * self.robot.radius_m**2
        damping = 2.0 * (inertia * YAW_STIFFNESS_N * arm) ** 0.5
        self.data.qfrc_applied[2] = YAW_STIFFNESS_N * arm * (self._heading - self.data.qpos[2]) + damping * (
            rate_rad_s - self.data.qvel[2]
        )
        mujoco.mj_step(self.model, self.data, CONTROL_STEPS)


def _mjcf(
    walls: Sequence[shapely.Polygon],
    bodies: Sequence[Body],
    robot: Robot,
    at_m: Sequence[float],
    contact_friction: float,
) -> str:
    h = PUSH_HEIGHT_M
    # Bits: 1 the floor with feet, 2 contacts at push height.
    parts = [
        '<geom name="floor" type="plane" size="0 0 1" contype="1" conaffinity="1" friction="0.01 0 0"/>',
        *(_wall(wall) for wall in walls),
        f'<body name="robot" pos="{at_m[0]:.6f} {at_m[1]:.6f} {h}"><joint type="slide" axis="1 0 0"/>'
        f'<joint type="slide" axis="0 1 0"/><joint type="hinge" axis="0 0 1"/><geom type="sphere" size="{robot.radius_m}" mass="{ROBOT_KG}" '
        f'contype="2" conaffinity="2" priority="1" friction="{contact_friction} 0 0" solref="0.008 1"/></body>',
        *(_body(body) for body in bodies),
    ]
    return (
        f'<mujoco><option timestep="{STEP_S}" gravity="0 0 -{GRAVITY_M_S2}" cone="elliptic" impratio="20" '
        'integrator="implicitfast"/><worldbody>' + "".join(parts) + "</worldbody></mujoco>"
    )


def _wall(wall: shapely.Polygon) -> str:
    """A box: walls are rectangles, along the axes or turned."""
    corners = np.array(wall.minimum_rotated_rectangle.exterior.coords)[:3]
    one, two = corners[0] - corners[1], corners[2] - corners[1]
    middle = 0.5 * (corners[0] + corners[2])
    size = 0.5 * np.hypot(*one), 0.5 * np.hypot(*two)
    return (
        f'<geom type="box" pos="{middle[0]:.6f} {middle[1]:.6f} 0.1" size="{size[0]:.6f} {size[1]:.6f} 0.2" '
        f'euler="0 0 {np.degrees(np.arctan2(one[1], one[0])):.6f}" contype="2" conaffinity="2" '
        f'friction="{WALL_FRICTION} 0 0" solref="0.008 1"/>'
    )


def feet_of(body: Body) -> np.ndarray:
    """Feet of a body about its centroid [m]: below its corners, or six below its rim."""
    if body.round_m:
        angle = np.arange(6) * np.pi / 3
        return (body.round_m - INSET_M) * np.column_stack([np.cos(angle), np.sin(angle)])
    inner = shapely.Polygon(body.outline_m - body.centre_m).buffer(-INSET_M, join_style="mitre")
    return np.array(inner.exterior.coords)[:-1]


def _body(body: Body) -> str:
    centre = body.centre_m
    outline = body.outline_m - centre
    h, m = PUSH_HEIGHT_M, body.mass_kg
    if body.round_m:
        shell = (
            f'<geom type="sphere" pos="0 0 {h}" size="{body.round_m:.6f}" mass="0" contype="2" conaffinity="2" '
            f'friction="{WALL_FRICTION} 0 0" solref="0.008 1"/>'
        )
    else:
        inner = shapely.Polygon(outline).buffer(-EDGE_M, join_style="mitre")
        ring = np.array(inner.exterior.coords)
        shell = "".join(
            f'<geom type="capsule" fromto="{a[0]:.6f} {a[1]:.6f} {h} {b[0]:.6f} {b[1]:.6f} {h}" size="{EDGE_M}" '
            f'mass="0" contype="2" conaffinity="2" friction="{WALL_FRICTION} 0 0" solref="0.008 1"/>'
            for a, b in pairwise(ring)
        )
    feet = feet_of(body)
    feet_text = "".join(
        f'<geom type="sphere" pos="{x:.6f} {y:.6f} {FOOT_M}" size="{FOOT_M}" mass="0" contype="1" conaffinity="1" '
        f'priority="1" friction="{body.friction} 0 0" solref="0.01 1"/>'
        for x, y in feet
    )
    turning = m * float(np.mean(np.hypot(*(feet - feet.mean(axis=0)).T) ** 2)) * 0.6 + 1e-5
    x, y = body.centre_offset_m
    return (
        f'<body pos="{centre[0]:.6f} {centre[1]:.6f} 0"><freejoint/>'
        f'<inertial pos="{x:.6f} {y:.6f} {h}" mass="{m:.6f}" diaginertia="{turning:.6f} {turning:.6f} {turning:.6f}"/>'
        f"{shell}{feet_text}</body>"
    )
