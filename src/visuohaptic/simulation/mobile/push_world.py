"""The push world: MuJoCo moves platform and obstacles, which interact only through the foam strip."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core import Event, EventKind, Pose, above, check_numbers
from ...core.errors import InputError, needs
from ...core.geometry import rotation_2d
from ..foam import SOFT_FOAM, FoamStrip, Outline, StripLaw
from ..rendering.scene import FoamScene, SceneObject
from .mujoco_model import world_mjcf
from .obstacles import (
    ObstacleKind,
    SimulatedObstacle,
    leaning_solid,
    section,
)
from .platform import PlatformConfig, SimulatedBase
from .push_truth import BodyTruth, PushTruth

#: Target interval of the foam's equilibrium (s); MuJoCo takes two steps in it.
FOAM_STEP_S = 0.002
#: Objects nearer than this to the strip are in the scene (m).
SCENE_RADIUS_M = 0.7
#: Speed over which static friction changes to dynamic friction (m/s).
STRIBECK_M_S = 0.002
#: Thresholds of contact (force, N), motion (m) and fall (tilt, rad).
TOUCH_N, MOTION_M, FALL_RAD = 1e-3, 5e-4, 0.5


class FoamPushWorld:
    """Platform, foam and obstacles.

    Friction, mass and inertia are MuJoCo's. Every two milliseconds, the cross
    sections of near obstacles at the foam's height are transformed to frame F at
    their predicted pose in the middle of the interval (a force held constant from its
    start would add energy), the equilibrium of the strip is computed, and its force
    acts on the obstacle at that height and, reversed, on the platform. There is no other
    contact between them until the foam has bottomed out.

    Parameters
    ----------
    obstacles
        Obstacles with unique names.
    platform
        Shape and start.
    law
        Material law of the foam.
    seed
        Seed of all random numbers; friction varies by ``friction_sigma`` between worlds.
    friction_sigma
        Relative standard deviation of every movable obstacle's friction.
    """

    def __init__(
        self,
        obstacles: Sequence[SimulatedObstacle] = (),
        platform: PlatformConfig | None = None,
        law: StripLaw = SOFT_FOAM,
        seed: int = 0,
        *,
        friction_sigma: float = 0.0,
    ) -> None:
        with needs("mujoco-core", "sim", "the simulated world"):
            import mujoco
        from dataclasses import replace

        names = [o.name for o in obstacles]
        if len(set(names)) != len(names):
            raise InputError("FoamPushWorld", f"found obstacles {names}, expected different names")
        rng = np.random.default_rng(seed)
        factor = np.maximum(0.2, 1.0 + friction_sigma * rng.standard_normal(len(names)))
        self.obstacles = tuple(
            replace(o, friction=o.friction * float(f)) for o, f in zip(obstacles, factor, strict=True)
        )
        self.config = platform if platform is not None else PlatformConfig()
        self.base = SimulatedBase(self)
        self.events: list[tuple[str, Event]] = []  #: true events by obstacle name
        self._strip = FoamStrip(self.config.strip, law)
        self._mujoco: Any = mujoco
        self._model: Any = mujoco.MjModel.from_xml_string(world_mjcf(self.config, self.obstacles))
        self._data: Any = mujoco.MjData(self._model)
        self._data.qpos[:3] = self.config.x_m, self.config.y_m, self.config.heading_rad
        mujoco.mj_forward(self._model, self._data)
        self._bodies = [self._model.body(f"obstacle:{name}").id for name in names]
        self._feet = [
            [i for i in range(self._model.npair) if self._model.pair(i).name.split(":", 1)[1] == name]
            for name in names
        ]
        self._dofs = [int(self._model.body_dofadr[body]) for body in self._bodies]
        self._start: dict[str, Float[np.ndarray, "3"]] = {}
        self._happened: set[tuple[str, EventKind]] = set()
        self._drive_N = 0.0
        self._near: list[tuple[int, Outline]] = []
        self._state = self._strip.press([])
        self.truth = self._record(0.0)

    @property
    def t_s(self) -> float:
        """Time of the world."""
        return float(self._data.time)

    def platform_pose(self) -> tuple[float, float, float]:
        """(x [m], y [m], heading [rad]) of the platform's centre in the world."""
        x, y, heading = self._data.qpos[:3]
        return float(x), float(y), float(heading)

    def platform_velocity(self) -> tuple[float, float, float]:
        """(forward, left [m/s], turn rate [rad/s])."""
        vx, vy, turn = (float(v) for v in self._data.qvel[:3])
        c, s = math.cos(self._data.qpos[2]), math.sin(self._data.qpos[2])
        return c * vx + s * vy, c * vy - s * vx, turn

    def place_platform(self, x_m: float, y_m: float, heading_rad: float) -> None:
        """Move the platform to another pose, at rest and with undeformed foam, and start a new push.

        Parameters
        ----------
        x_m, y_m
            Position in the world [m].
        heading_rad
            Heading [rad].
        """
        self._data.qpos[:3] = x_m, y_m, heading_rad
        self._data.qvel[:3] = 0.0
        self._mujoco.mj_forward(self._model, self._data)
        self.base.halt()
        self._strip.reset()
        self._near = []
        self._state = self._strip.press([])
        self.forget_events()
        self.truth = self._record(self.t_s)

    def step(self, dt_s: float) -> PushTruth:
        """Advance the simulation; the last equilibrium of the foam is the new :attr:`truth`.

        Parameters
        ----------
        dt_s
            Simulated time [s], more than 0 and at most 10.

        Raises
        ------
        InputError
            The time is out of range or the physics diverged.
        """
        check_numbers("FoamPushWorld.step", above(0, 10), dt_s=dt_s)
        count = max(1, round(dt_s / FOAM_STEP_S))
        interval = dt_s / count
        self._model.opt.timestep = 0.5 * interval
        for _ in range(count):
            middle = self._data.time + 0.5 * interval
            self._equilibrium(0.5 * interval, interval)
            self._apply(interval)
            self._watch(middle)
            self._mujoco.mj_step(self._model, self._data, 2)
            if not np.isfinite(self._data.qpos).all():
                raise InputError(
                    "FoamPushWorld.step", f"the physics diverged at {middle:.3f} s", remedy="lower dt_s"
                )
        self.truth = self._record(middle, 0.5 * interval)
        return self.truth

    def scene(self) -> FoamScene:
        """View of the sensor's camera at ``truth.t_s``."""
        truth = self.truth
        x, y, heading = truth.platform_pose
        c, s = math.cos(heading), math.sin(heading)
        pose = Pose.from_rotation_vector(
            [0.0, 0.0, heading],
            np.array([x + c * self._front_m, y + s * self._front_m, self.config.floor_below_m]),
        )
        objects = []
        for index, obstacle in enumerate(self.obstacles):
            position, rotation = self._pose(index)
            if np.hypot(position[0] - x, position[1] - y) > SCENE_RADIUS_M + obstacle.reach_m + self._front_m:
                continue
            near = [outline for i, outline in self._near if i == index]
            cuts = near or [self._to_foam(c, (x, y, heading)) for c in self._cut(index, 0.0)]
            top = (
                float(position[2] + obstacle.height_m * max(rotation[2, 2], 0.1)) - self.config.floor_below_m
            )
            solid = leaning_solid(obstacle, Pose(rotation, position), pose.inverse())
            if solid is not None and not cuts:
                # It is lower than the foam, so it cannot occlude the sensor.
                hull = solid.T_foam_solid.apply(np.column_stack([solid.outline_m, 0 * solid.outline_m[:, 0]]))
                cuts, top = [Outline(hull[:, :2])], 0.0
            objects += [
                SceneObject(
                    cut.polygon_m(),
                    top,
                    obstacle.grey,
                    obstacle.texture,
                    obstacle.seed,
                    obstacle.material,
                    obstacle.bgr,
                    solid,
                )
                for cut in cuts
            ]
        return FoamScene(
            t_s=truth.t_s,
            back_m=self.config.strip.back_m(self._strip.s_m),
            front_m=truth.strip.front_m,
            objects=tuple(objects),
            floor_below_m=self.config.floor_below_m,
            T_world_foam=pose,
        )

    @property
    def _front_m(self) -> float:
        """Distance from the platform's centre to the origin of F."""
        return self.config.radius_m

    def _pose(self, index: int) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        body = self._bodies[index]
        return self._data.xpos[body], self._data.xmat[body].reshape(3, 3)

    def _velocity(self, index: int) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Velocity of its frame's origin and angular velocity, both in the world."""
        obstacle, dof = self.obstacles[index], self._dofs[index]
        if not obstacle.movable:
            return np.zeros(3), np.zeros(3)
        if obstacle.kind is ObstacleKind.DOOR:
            return np.zeros(3), np.array([0.0, 0.0, self._data.qvel[dof]])
        return self._data.qvel[dof : dof + 3], self._pose(index)[1] @ self._data.qvel[dof + 3 : dof + 6]

    def _cut(self, index: int, ahead_s: float) -> tuple[Outline, ...]:
        """Cross section at the foam's height, extrapolated by a short time."""
        height = self.config.foam_height_m
        position, rotation = self._pose(index)
        if ahead_s > 0 and self.obstacles[index].movable:
            velocity, turn = self._velocity(index)
            lean = np.array([turn[1], -turn[0]]) * height
            position = position.copy()
            position[:2] += (velocity[:2] + lean) * ahead_s
            rotation = rotation.copy()
            rotation[:2] = rotation_2d(turn[2] * ahead_s) @ rotation[:2]
        return section(self.obstacles[index], position, rotation, height)

    def _to_foam(self, outline: Outline, pose: tuple[float, float, float]) -> Outline:
        """From the world to frame F of a platform at ``pose``."""
        x, y, heading = pose
        c, s = math.cos(heading), math.sin(heading)
        x, y = x + c * self._front_m, y + s * self._front_m
        return outline.moved(-c * x - s * y, s * x - c * y, -heading)

    def _ahead(self, ahead_s: float) -> tuple[float, float, float]:
        pose = self._data.qpos[:3] + self._data.qvel[:3] * ahead_s
        return float(pose[0]), float(pose[1]), float(pose[2])

    def _equilibrium(self, ahead_s: float, interval_s: float) -> None:
        """Equilibrium of the strip with everything near it."""
        pose = self._ahead(ahead_s)
        reach = self._front_m + self.config.strip.length_m
        self._near = []
        for index, obstacle in enumerate(self.obstacles):
            position = self._data.xpos[self._bodies[index]]
            if math.hypot(position[0] - pose[0], position[1] - pose[1]) < reach + obstacle.reach_m:
                self._near += [(index, self._to_foam(cut, pose)) for cut in self._cut(index, ahead_s)]
        self._state = self._strip.press([outline for _, outline in self._near], interval_s)

    def _apply(self, interval_s: float) -> None:
        """Forces of foam and drive for the next interval, friction by speed."""
        data, height, config = self._data, self.config.foam_height_m, self.config
        x, y, heading = self._ahead(0.5 * interval_s)
        c, s = math.cos(heading), math.sin(heading)
        data.xfrc_applied[:] = 0.0
        forces = zip(self._near, self._state.body_force_N, self._state.body_moment_Nm, strict=True)
        for (index, _), force, moment in forces:
            if not force.any():
                continue
            body = self._bodies[index]
            world = np.array([c * force[0] - s * force[1], s * force[0] + c * force[1]])
            # From the moment about the origin of F to that about the body's centre of mass.
            arm = data.xipos[body, :2] - (x + c * self._front_m, y + s * self._front_m)
            lever = height - data.xipos[body, 2]
            turn = moment - (arm[0] * world[1] - arm[1] * world[0])
            data.xfrc_applied[body] += (world[0], world[1], 0.0, -lever * world[1], lever * world[0], turn)
        for index, obstacle in enumerate(self.obstacles):
            if self._feet[index] and obstacle.static_ratio > 1.0:
                velocity, turn_rate = self._velocity(index)
                speed = math.hypot(velocity[0], velocity[1]) + abs(turn_rate[2]) * obstacle.reach_m
                raised = 1.0 + (obstacle.static_ratio - 1.0) * math.exp(-speed / STRIBECK_M_S)
                self._model.pair_friction[self._feet[index], :2] = obstacle.friction * raised
        target, turn_target = self.base.ramp(interval_s)
        forward, left, turning = self.platform_velocity()
        back = -self._state.force_N
        if config.kinematic:
            data.qvel[:3] = c * target, s * target, turn_target
            self._drive_N = -float(back[0])
            return
        gain = 0.3 / interval_s
        drive = config.mass_kg * gain * (target - forward) - back[0]
        drive = max(-config.max_force_N, min(config.max_force_N, drive))
        # Wheels prevent sideward motion and rotation of the platform.
        side = -config.mass_kg * gain * left - back[1]
        self._drive_N = float(drive)
        ahead, across = drive + back[0], side + back[1]
        data.qfrc_applied[:2] = c * ahead - s * across, s * ahead + c * across
        # A rotating velocity vector requires its centripetal force.
        data.qfrc_applied[:2] += config.mass_kg * turning * forward * np.array([-s, c])
        inertia = 0.5 * config.mass_kg * config.radius_m**2
        data.qfrc_applied[2] = inertia * gain * (turn_target - turning)

    def _watch(self, t_s: float) -> None:
        """Record contact, motion, release and fall of every obstacle, each once."""
        load: dict[str, float] = {}
        for (index, _), force in zip(self._near, self._state.body_force_N, strict=True):
            name = self.obstacles[index].name
            load[name] = load.get(name, 0.0) + float(np.hypot(force[0], force[1]))
        self._load = {name: value for name, value in load.items() if value > 0.0}
        for index, obstacle in enumerate(self.obstacles):
            name = obstacle.name
            touching = load.get(name, 0.0) > TOUCH_N
            if touching and (name, EventKind.CONTACT) not in self._happened:
                self._start[name] = self._placement(index)
                place = [k for k, (i, _) in enumerate(self._near) if i == index]
                centres = np.array([self._state.centre_m(k) for k in place])
                known = centres[np.isfinite(centres)]  # none if the foam has just released it
                centre = float(known.mean()) if len(known) else float("nan")
                self._note(name, EventKind.CONTACT, t_s, centre)
            if name not in self._start:
                continue
            if not touching:
                self._note(name, EventKind.RELEASE, t_s)
            if obstacle.movable:
                moved = np.abs(self._placement(index) - self._start[name])
                if math.hypot(moved[0], moved[1]) + moved[2] * obstacle.reach_m > MOTION_M:
                    self._note(name, EventKind.MOTION, t_s)
                if self._pose(index)[1][2, 2] < math.cos(FALL_RAD):
                    self._note(name, EventKind.FALL, t_s)

    def _placement(self, index: int) -> Float[np.ndarray, "3"]:
        position, rotation = self._pose(index)
        return np.array([position[0], position[1], math.atan2(rotation[1, 0], rotation[0, 0])])

    def _note(self, name: str, kind: EventKind, t_s: float, s_m: float = math.nan) -> None:
        if (name, kind) not in self._happened:
            self._happened.add((name, kind))
            self.events.append((name, Event(kind, float(t_s), s_m)))

    def forget_events(self) -> None:
        """Start a new push: events may occur again."""
        self.events.clear()
        self._happened.clear()
        self._start.clear()

    def _record(self, t_s: float, before_s: float = 0.0) -> PushTruth:
        """Collect the ground truth; poses are set back to the middle of the last interval."""
        bodies = []
        parts = list(zip(self._near, self._state.body_force_N, strict=True))
        force_on: dict[str, float] = {}
        for index, obstacle in enumerate(self.obstacles):
            force = sum((f for (i, _), f in parts if i == index), np.zeros(2))
            if force.any():
                force_on[obstacle.name] = float(np.hypot(force[0], force[1]))
            if not obstacle.movable:
                continue
            velocity, turn = self._velocity(index)
            x, y, yaw = self._placement(index) - before_s * np.array([velocity[0], velocity[1], turn[2]])
            tilt = math.acos(min(1.0, max(-1.0, float(self._pose(index)[1][2, 2]))))
            bodies.append(
                BodyTruth(
                    obstacle.name,
                    float(x),
                    float(y),
                    float(yaw),
                    tilt,
                    velocity[:2].copy(),
                    float(turn[2]),
                    force,
                )
            )
        return PushTruth(
            t_s=float(t_s),
            load_N=self._state.load_N,
            force_foam_N=self._state.force_N,
            strip=self._state,
            bodies=tuple(bodies),
            force_on=force_on,
            platform_pose=self._ahead(-before_s),
            platform_velocity=self.platform_velocity(),
            drive_N=self._drive_N,
        )
