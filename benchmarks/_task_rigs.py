"""Every task on its simulated robot under a supervisor, with one fault between robot and supervisor.

The worlds provide the ground truth: the force on the robot, whether it moves, the correct result. Faults
change only the data and commands between both, except for a bump, which moves the robot in the world.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from visuohaptic.core import BaseState, Frame, Pose, Reason, Wrench
from visuohaptic.navigation.mapping import HapticMap
from visuohaptic.navigation.problem import MovableObject, PlanningProblem
from visuohaptic.reconstruction import SurfaceMesh
from visuohaptic.reconstruction.completion import Completion, HoleRegion
from visuohaptic.rigs import ROBOT, rooms, with_objects
from visuohaptic.rigs import box as square
from visuohaptic.rigs.virtual_crown_cap import SCAN_M, virtual_opener
from visuohaptic.simulation.floor import FloorObject, FloorSenses, FloorWorld
from visuohaptic.simulation.foam import FoamStripGeometry
from visuohaptic.simulation.mobile import (
    FoamPushWorld,
    PlatformConfig,
    QuickFoam,
    QuickFrames,
    QuickWorld,
    cylinder,
    touch_room,
)
from visuohaptic.simulation.tabletop import (
    Bottle,
    DeformableContainer,
    KitchenTable,
    ProbeCell,
    SimulatedArm,
)
from visuohaptic.tasks.framework import SafetyLimits, Supervisor
from visuohaptic.tasks.manipulation import (
    CapSettings,
    CompleteSettings,
    Hand,
    LiftPlan,
    Place,
    complete_by_touch,
    grasp_and_lift,
    open_crown_cap,
    squeeze,
)
from visuohaptic.tasks.mobile import ExploreSettings, explore_obstacle
from visuohaptic.tasks.mobile.touch_map import MapSettings, map_by_touch
from visuohaptic.tasks.mobile.travel import TravelOutcome, TravelSettings, travel

__all__ = ["FAULTS", "STOPPING", "TASKS", "Claim", "Fault", "Record", "Rig"]

#: Permanent failures, after which nothing may move.
STOPPING = (
    "camera frozen", "camera stops", "state frozen", "pose frozen", "force unread", "clock stops", "clock jumps",
)  # fmt: skip
FAULTS = ("none", "frames dropped", "frames late", "force outliers", "pose wrong", "bumped", *STOPPING)
#: Friction and stiffness are right within this fraction or three declared sigmas, places within this [m].
FRACTION, PLACE_M = 0.12, 0.1
#: Mass of the platform [kg], and its deceleration when it is pushed over the floor: a coefficient of friction of 0.5 [m/s^2].
PLATFORM_KG, SLIDE_M_S2 = PlatformConfig().mass_kg, 0.5 * 9.81


@dataclass(slots=True)
class Fault:
    """One thing that goes wrong from a time on."""

    kind: str
    at_s: float
    rng: np.random.Generator
    clock: Callable[[], float] = lambda: 0.0
    _last: dict[str, Any] = field(default_factory=dict)
    _jump_s: float = 0.0

    def __post_init__(self) -> None:
        self._jump_s = float(self.rng.choice([-1.0, 1.0]) * self.rng.uniform(0.7, 20.0))

    def on(self, *kinds: str) -> bool:
        return self.kind in kinds and self.clock() >= self.at_s

    def time_s(self, name: str, t_s: float) -> float:
        """Reading of a clock."""
        if self.on("clock stops"):
            return self._last.setdefault(f"{name} time", t_s)
        return t_s + self._jump_s if self.on("clock jumps") else t_s

    def state(self, name: str, state: Any) -> Any:
        """State reported by a part."""
        if self.on("state frozen", "pose frozen"):
            frozen = self._last.setdefault(name, state)
            t_s = frozen.t_s if self.kind == "state frozen" else state.t_s
            return replace(frozen, t_s=t_s)
        if self.on("pose wrong") and isinstance(state, BaseState):
            state = replace(state, x_m=state.x_m + 0.4, y_m=state.y_m - 0.3)
        if self.on("pose wrong") and isinstance(state, _ArmState):
            at = state.pose
            state = replace(state, pose=Pose(at.rotation, np.add(at.translation_m, (0.0, 0.07, 0.05))))
        return replace(state, t_s=self.time_s(name, state.t_s))

    def force(self, value: Any) -> Any:
        """Reading of a force sensor: a number or a vector [N]."""
        if self.on("force unread"):
            return value * math.nan
        if self.on("force outliers") and self.rng.random() < 0.05:
            return value * float(self.rng.choice([0.0, 3.0]))
        return value

    def frames(self, source: Any) -> Iterator[Frame]:
        """Frames of a camera; each image has its own noise."""
        held: list[tuple[int, Frame]] = []
        last: Frame | None = None
        for k, true in enumerate(source):
            image = self.rng.integers(0, 255, (4, 6), dtype=np.uint8)
            frame = replace(true, image=image, t_s=self.time_s("camera", true.t_s))
            drop, late = self.rng.random(2)
            if self.on("camera stops"):
                continue
            if self.on("camera frozen") and last is not None:
                frame = replace(last, t_s=frame.t_s, index=frame.index)
            gap = self.kind == "frames dropped" and 0.0 <= self.clock() - self.at_s < 0.5
            if gap or (self.on("frames dropped") and drop < 0.3):
                continue
            if self.on("frames late") and late < 0.3:
                held.append((k + 3, frame))
                continue
            yield frame
            last = frame
            yield from (old for due, old in held if due <= k)
            held = [one for one in held if one[0] > k]


@dataclass(frozen=True, slots=True)
class Claim:
    """Ending of a task, and whether its claims are true."""

    success: bool  #: whether it ended as the world permits
    outcome: str
    why: str
    right: bool  #: of what it claims; what fails claims nothing


@dataclass(slots=True)
class Record:
    """Ground truth of a run, tick by tick."""

    t_s: list[float] = field(default_factory=list)
    force_N: list[float] = field(default_factory=list)
    moving: list[bool] = field(default_factory=list)

    def longest_motion_s(self, from_s: float) -> float:
        """The longest motion without a stop from a time on [s]; ticks are counted whole."""
        longest = began = 0.0
        moved, last = False, from_s
        for t_s, moving in zip(self.t_s, self.moving, strict=True):
            if t_s >= from_s:
                began = last if moving and not moved else began
                longest = max(longest, t_s - began) if moving else longest
            moved, last = moving and t_s >= from_s, t_s
        return longest


class Rig(ABC):
    """A task, its world, and the ground truth."""

    name = ""
    limits = SafetyLimits()
    ends_s = 300.0  #: time of the world after which its camera ends

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)

    @abstractmethod
    def now_s(self) -> float:
        """Time of the world [s]."""

    @abstractmethod
    def tick(self) -> tuple[float, bool]:
        """True force on the robot [N], and whether it moves."""

    @abstractmethod
    def bump(self) -> None:
        """An external push displaces the robot."""

    @abstractmethod
    def attempt(self, guard: Supervisor, fault: Fault, record: Record) -> Claim:
        """Do the task under the supervisor, with the fault in between."""

    def watch(self, guard: Supervisor, fault: Fault, record: Record) -> None:
        """Called as the world's time advances: the supervisor's check, and the record."""
        guard.check()
        if fault.on("bumped") and "bump" not in fault._last:
            fault._last["bump"] = True
            self.bump()
        force_N, moving = self.tick()
        record.t_s.append(self.now_s())
        record.force_N.append(force_N)
        record.moving.append(moving)

    def camera(self, source: Any, guard: Supervisor, fault: Fault, record: Record) -> Any:
        """The frames of a world through its fault."""

        def watched() -> Iterator[Frame]:
            for frame in source:
                self.watch(guard, fault, record)
                if self.now_s() > self.ends_s:
                    return
                yield frame

        class Camera:
            camera, frame_count = None, None

            def __iter__(self) -> Iterator[Frame]:
                return fault.frames(watched())

        return guard.frames(Camera())


class _Device:
    """A part whose readings pass through a fault; other members are forwarded."""

    def __init__(self, part: Any, fault: Fault) -> None:
        self._part, self._fault = part, fault

    def __getattr__(self, name: str) -> Any:
        return getattr(self._part, name)

    def state(self) -> Any:
        return self._fault.state(type(self._part.state()).__name__, self._part.state())

    def pose(self) -> tuple[float, Pose]:
        t_s, pose = self._part.pose()
        told = self._fault.state("arm", _ArmState(t_s, pose))
        return told.t_s, told.pose


@dataclass(frozen=True, slots=True)
class _ArmState:
    t_s: float
    pose: Pose


class Travel(Rig):
    """Navigation through a door blocked by a stool, with or without its tag."""

    name = "travel"

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self.friction_N = float(self.rng.choice([8.0, 14.0, 40.0]))
        walls = rooms(4.0, 3.0, [(1.9, 0.0, 2.0, 1.0), (1.9, 1.9, 2.0, 3.0)])
        stool = MovableObject("stool", square(1.95, 1.45, 0.35), None)
        self.problem = PlanningProblem(
            with_objects(walls, [stool]), ROBOT, np.array([0.7, 1.4]), np.array([3.4, 1.4]), (stool,)
        )
        item = FloorObject("stool", stool.footprint_m, self.friction_N / (9.81 * 0.3), 0.3)
        self.world = FloorWorld(walls, [item], (0.7, 1.4, 0.3))
        self.senses = FloorSenses(self.world, self.rng)
        self._slide_m_s = np.zeros(2)  #: velocity of a platform that was bumped

    def now_s(self) -> float:
        return self.world.t_s

    def tick(self) -> tuple[float, bool]:
        base = self.world.base
        # Sustained force: the impacts of a rigid contact are shorter than any reading.
        return abs(float(self.world._back[0])), bool(base.target_speed_m_s or base.target_turn_rate_rad_s)

    def bump(self) -> None:
        way_m = 0.03 * self.rng.standard_normal(2).clip(-1, 1)
        self._slide_m_s = way_m * math.sqrt(2.0 * SLIDE_M_S2 / float(np.hypot(*way_m)))

    def step(self, duration_s: float) -> None:
        """Advance the world; a bumped platform slides until friction, or what it meets, has stopped it."""
        step_s, end_s = float(self.world._model.opt.timestep), self.world.t_s + duration_s
        while (speed := float(np.hypot(*self._slide_m_s))) > 0.0 and self.world.t_s < end_s - 0.5 * step_s:
            self.world._pose[:2] += step_s * self._slide_m_s
            self.world.step(step_s)
            met_N = self.world.touch.force_N if self.world.touch else 0.0
            slower = (SLIDE_M_S2 + met_N / PLATFORM_KG) * step_s
            self._slide_m_s *= max(0.0, 1.0 - slower / speed)
        if (left_s := end_s - self.world.t_s) > 0.5 * step_s:
            self.world.step(left_s)

    def attempt(self, guard: Supervisor, fault: Fault, record: Record) -> Claim:
        senses = self.senses

        class Told:
            look = staticmethod(senses.look)

            @staticmethod
            def pose() -> tuple[float, float, float]:
                pose = senses.pose()
                if fault.on("pose frozen", "state frozen", "camera frozen"):
                    pose = fault._last.setdefault("localizer", pose)
                if fault.on("pose wrong"):
                    pose = (pose[0] + 0.4, pose[1] - 0.3, pose[2])
                return pose if not fault.on("camera stops") else (math.nan,) * 3

            @staticmethod
            def touch() -> tuple[float, Any]:
                force_N, point_m = senses.touch()
                return fault.force(force_N), point_m

        def wait(duration_s: float) -> None:
            self.step(duration_s)
            self.watch(guard, fault, record)

        base = guard.base(_Device(self.world.base, fault))
        done = travel(self.problem, base, guard.senses(Told()), wait, TravelSettings(timeout_s=150.0))
        error_m = float(np.hypot(*(self.world.pose_m()[:2] - self.problem.goal_m)))
        tag = done.problem.objects[0].tag
        right = (not done.arrived or error_m < PLACE_M) and _tag_right(tag, self.friction_N)
        # Beside the stool the door is narrower than the platform: if the stool withstands its force, there is no path.
        blocked = self.friction_N > ROBOT.push_force_max_N
        success = done.outcome is TravelOutcome.NO_PLAN if blocked else done.arrived
        return Claim(success, str(done.outcome), done.reason, right)


def _tag_right(tag: Any, friction_N: float) -> bool:
    """Whether a tag is true for an object that slides at ``friction_N``."""
    if tag is None:
        return True
    bound, felt = tag.min_static_friction_N, tag.static_friction_N
    if bound is not None and bound > 1.1 * friction_N:
        return False
    if felt is None:
        return True
    return bool(abs(felt.value - friction_N) <= max(FRACTION * friction_N, 3.0 * felt.sigma))


class Explore(Rig):
    """Touch a bin, push it, and tag it.

    In physics: the static friction is estimated from the inertia of the object, which a world without masses does not have.
    """

    name = "explore"
    ends_s = 60.0  #: physics take a while; ten times as long as a push
    world: FoamPushWorld | QuickWorld

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        mass = float(self.rng.choice([0.5, 1.2, 20.0]))
        self.bin = cylinder("bin", 0.42, 0.0, 0.1, 0.3, mass_kg=mass, friction=0.35, static_ratio=1.2)
        self.world = FoamPushWorld(
            [self.bin], PlatformConfig(strip=FoamStripGeometry(spacing_m=0.002)), seed=seed
        )
        self.foam = QuickFoam(self.world, self.rng)

    def now_s(self) -> float:
        return self.world.t_s

    def tick(self) -> tuple[float, bool]:
        base = self.world.base
        return float(self.world.truth.strip.load_N), (
            base.target_speed_m_s,
            base.target_turn_rate_rad_s,
        ) != (0.0, 0.0)

    def bump(self) -> None:
        assert isinstance(self.world, FoamPushWorld)
        self.world._data.qpos[:3] += (-0.01, 0.01, 0.03)

    def parts(self, guard: Supervisor, fault: Fault, record: Record) -> tuple[Any, Any, Any]:
        foam = self.foam

        class Told:
            setup, reset = foam.setup, foam.reset
            last: Any = None

            def read(self, frame: Frame) -> Any:
                # A frozen camera shows the same foam again.
                profile = (
                    self.last if fault.on("camera frozen") and self.last is not None else foam.read(frame)
                )
                self.last = profile
                force_N = fault.force(profile.force_N)
                valid = bool(profile.valid and math.isfinite(force_N))
                reason = profile.reason if math.isfinite(force_N) else Reason.LOST
                return replace(profile, t_s=frame.t_s, force_N=force_N, valid=valid, reason=reason)

        source = self.camera(QuickFrames(self.world), guard, fault, record)
        return guard.base(_Device(self.world.base, fault)), source, guard.sensor(Told())

    def attempt(self, guard: Supervisor, fault: Fault, record: Record) -> Claim:
        settings = ExploreSettings(approach_m_s=0.05, push_m_s=0.03, push_m=0.03, halt_s=0.3, search_m=0.4)
        found = explore_obstacle(*self.parts(guard, fault, record), settings)
        right = _tag_right(found.tag, self.bin.static_friction_N)
        if found.tag.fixed is not None:
            # An object that needs more force than the platform has is fixed for it.
            right &= found.tag.fixed == (self.bin.static_friction_N > 0.9 * 20.0)
        return Claim(found.ending.success, found.ending.outcome, found.ending.why, right)


class TouchMap(Explore):
    """Three contacts on the way around a room."""

    name = "map_by_touch"
    ends_s = 300.0
    # 80 mm/s against foam of 20 mm: after 0.1 s and a frame without a reading half of it is left; at 0.5 m/s2 it stands
    # after 0.16 s.
    limits = SafetyLimits(max_age_s=0.1, brake_s=0.16)

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self.room = touch_room(seed)
        x, y, heading = self.room.start
        config = PlatformConfig(x_m=x, y_m=y, heading_rad=heading, strip=self.world.config.strip)
        self.world = QuickWorld(self.room.obstacles, config)
        self.foam = QuickFoam(self.world, self.rng)

    def bump(self) -> None:
        assert isinstance(self.world, QuickWorld)
        x, y, heading = self.world.pose
        self.world.pose = (x - 0.01, y + 0.01, heading + 0.03)

    def attempt(self, guard: Supervisor, fault: Fault, record: Record) -> Claim:
        wide, deep = self.room.size_m
        grid = HapticMap.empty((-0.5, -0.5), (wide + 1.0, deep + 1.0))
        base, source, sensor = self.parts(guard, fault, record)
        done = map_by_touch(base, source, sensor, grid, MapSettings(contacts=3, timeout_s=200.0))
        right = True
        for contact in done.contacts if done.ending.success else ():
            x, y, yaw = contact.T_map_foam
            c, s = math.cos(yaw), math.sin(yaw)
            points = contact.points_foam_m @ np.array([[c, s], [-s, c]]) + (x, y)
            near = [self.room.occupied(points, movable=m, grow_m=PLACE_M).any() for m in (False, True)]
            right &= any(near)
        return Claim(done.ending.success, done.ending.outcome, done.ending.why, bool(right))


class Table(Rig):
    """A container between the fingers."""

    limits = SafetyLimits(max_force_N=12.0)

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self.k = float(self.rng.uniform(1500.0, 4000.0))
        heights_m, depths_m = np.array([0.0, 0.1, 0.2]), np.linspace(0.0, 0.02, 25)
        force_N = self.k * np.ones((3, 1)) * depths_m
        thing = DeformableContainer("bottle", heights_m, np.full(3, 0.035), depths_m, force_N, mass_kg=0.2)
        self.table = KitchenTable(thing, self.rng)
        self._before = np.zeros(0)

    def now_s(self) -> float:
        return self.table.arm.t_s

    def tick(self) -> tuple[float, bool]:
        now = np.array((self.table.state().opening_m, *self.table.arm.pose()[1].translation_m))
        step = now - (self._before if len(self._before) else now)
        step[0] = min(step[0], 0.0)  # fingers may always open
        moved = float(np.abs(step).max()) > 1e-6
        self._before = now
        return self.table.force_N, moved

    def bump(self) -> None:
        x, y = self.table.place_m
        self.table.place_m = (x + 0.005, y)

    def hand(self, guard: Supervisor, fault: Fault, record: Record) -> Hand:
        table, last = self.table, []

        def feel(frame: Frame) -> Any:
            reading = last[-1] if fault.on("camera frozen") and last else table.feel(frame)
            last[:] = [reading]
            force_N = fault.force(reading.force_N)
            return replace(reading, force_N=force_N, valid=reading.valid and math.isfinite(force_N))

        gripper: Any = _Device(table, fault)
        arm: Any = _Device(table.arm, fault)
        source = self.camera(table, guard, fault, record)
        return Hand(guard.arm(arm), guard.gripper(gripper), source, guard.force(feel), table.weigh)


class Squeeze(Table):
    """Force against deformation at two heights."""

    name = "squeeze"

    def attempt(self, guard: Supervisor, fault: Fault, record: Record) -> Claim:
        done = squeeze(self.hand(guard, fault, record), [Place(0.06), Place(0.14)])
        claimed = done.curves if done.ending.success else ()
        right = all(abs(curve.stiffness_N_per_m / self.k - 1.0) <= FRACTION for curve in claimed)
        return Claim(done.ending.success, done.ending.outcome, done.ending.why, right)


class Grasp(Table):
    """Grasp and lift, with an alternative grasp."""

    name = "grasp"

    def attempt(self, guard: Supervisor, fault: Fault, record: Record) -> Claim:
        plans = [LiftPlan(Place(height_m), 6.0) for height_m in (0.1, 0.06)]
        done = grasp_and_lift(self.hand(guard, fault, record), *plans)
        right = not done.ending.success or self.table.lifted_m > 0.08
        return Claim(done.ending.success, done.ending.outcome, done.ending.why, right)


class Complete(Rig):
    """Touch the hidden part of a bottle."""

    name = "complete"
    # 30 mm/s against 2 N/mm: what is not read for 0.1 s and a frame has become 8 N more.
    limits = SafetyLimits(max_force_N=10.0, max_age_s=0.1)

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        belly = float(self.rng.uniform(0.004, 0.012))
        self.bottle = Bottle(
            "round", 0.2, np.array([0.0, 0.065, 0.135, 0.16, 0.185, 0.2]),
            np.array([0.03, 0.03, 0.03, 0.028, 0.015, 0.015]), np.array([0.0, belly, 0.0, 0.0, 0.0]), 1.0, 10.0,
        )  # fmt: skip
        self.place = Pose.from_rotation_vector([0.0, 0.0, 0.7], [0.5, 0.1, 0.0])
        self.arm = SimulatedArm(Pose(np.eye(3), np.array([0.3, 0.0, 0.3])), rng=self.rng)
        self.cell = ProbeCell(self.arm, self.bottle, self.rng, T_base_bottle=self.place)
        self._before = np.zeros(3)

    def now_s(self) -> float:
        return self.arm.t_s

    def tick(self) -> tuple[float, bool]:
        now = self.arm.pose()[1].translation_m
        moved = float(np.abs(now - self._before).max()) > 1e-6
        self._before = now
        noise, self.cell.force_sigma_N = self.cell.force_sigma_N, 0.0
        force_N = float(np.linalg.norm(self.cell.force()))
        self.cell.force_sigma_N = noise
        return force_N, moved

    def bump(self) -> None:
        at = self.cell.T_base_bottle
        self.cell.T_base_bottle = Pose(at.rotation, np.add(at.translation_m, (0.003, 0.0, 0.0)))

    def attempt(self, guard: Supervisor, fault: Fault, record: Record) -> Claim:
        visible = SurfaceMesh(*self.bottle.mesh(0.0, 0.054)).joined(
            SurfaceMesh(*self.bottle.mesh(0.146, 0.2))
        )
        hidden, _ = self.bottle.mesh(0.054, 0.146, caps=False)
        centre = hidden.mean(axis=0)
        region = HoleRegion.of_points(centre + 0.9 * (hidden - centre))
        completion = Completion(visible, region, T_visual_haptic=self.place.inverse())
        last: list[np.ndarray] = []

        def feel(frame: Frame) -> Wrench:
            force = last[-1] if fault.on("camera frozen") and last else self.cell.force()
            last[:] = [force]
            told = fault.force(force)
            valid = bool(np.isfinite(told).all())
            return Wrench(frame.t_s, valid, Reason.OK, told, np.zeros(3), np.eye(6))

        arm: Any = _Device(self.arm, fault)
        source = self.camera(self.cell, guard, fault, record)
        settings = CompleteSettings(bound_m=0.002, touches=5, top_m=0.2, compliance_m_per_N=1 / 2000.0)
        done = complete_by_touch(
            guard.arm(arm), source, guard.force(feel), completion, settings, T_base_visual=self.place
        )
        points = completion.surface().vertices_m
        points = points[(points[:, 2] > 0.054) & (points[:, 2] < 0.146)]
        wall = self.bottle.radius_m(np.arctan2(points[:, 1], points[:, 0]), points[:, 2])
        rms_m = float(np.sqrt(np.mean((np.hypot(points[:, 0], points[:, 1]) - wall) ** 2)))
        right = not done.ending.success or rms_m <= 2.0 * settings.bound_m
        return Claim(done.ending.success, done.ending.outcome, done.ending.why, right)


class Cap(Rig):
    """Open a crown cap; the hook alone pulls up to 110 N."""

    name = "crown_cap"
    limits = SafetyLimits(max_force_N=130.0)

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self.cell = virtual_opener(seed, "tracked")
        self._before = np.zeros(3)

    def now_s(self) -> float:
        return self.cell.arm.t_s

    def tick(self) -> tuple[float, bool]:
        pose = self.cell.arm.pose()[1]
        now = np.concatenate([pose.translation_m, pose.rotation[0]])
        moved = len(self._before) == 6 and float(np.abs(now - self._before).max()) > 1e-6
        self._before = now
        return float(np.linalg.norm(self.cell.wrench_tool[:3])), moved

    def bump(self) -> None:
        self.cell.position_base_m = np.add(self.cell.position_base_m, (0.003, 0.0, 0.0))

    def attempt(self, guard: Supervisor, fault: Fault, record: Record) -> Claim:
        last: list[Any] = []

        def feel(frame: Frame) -> Wrench:
            wrench, covariance = last[-1] if fault.on("camera frozen") and last else self.cell.feel(frame)
            last[:] = [(wrench, covariance)]
            told = fault.force(wrench)
            valid = bool(np.isfinite(told).all())
            return Wrench(frame.t_s, valid, Reason.OK, told[:3], told[3:], covariance, "tool")

        arm: Any = _Device(self.cell.arm, fault)
        source = self.camera(self.cell, guard, fault, record)
        done = open_crown_cap(
            guard.arm(arm), source, guard.force(feel), self.cell.look, CapSettings(scan_m=SCAN_M)
        )
        right = self.cell.opened or not done.opened
        return Claim(done.opened, done.ending.outcome, done.ending.why, right)


TASKS: tuple[type[Rig], ...] = (Travel, Explore, TouchMap, Squeeze, Grasp, Complete, Cap)
