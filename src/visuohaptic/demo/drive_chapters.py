"""Plan with the measured tags, push one object aside, and drive to the table."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..core.geometry import compose_2d, relative_2d
from ..navigation.mapping.mapper import OccupancyMapper
from ..navigation.planning.policies import make_plan, without_pushing
from ..navigation.problem import Plan, PlanningProblem
from ..report.floor_chart import MapObject
from ..rigs.virtual_office import ROBOT
from ..simulation.faults import FaultKind
from ..simulation.floor import FloorObject, FloorSenses, FloorWorld
from ..simulation.mobile import DriftingBase, SimulatedLaser
from ..tasks.framework.supervised_parts import Supervisor
from ..tasks.manipulation.hand import as_vector
from ..tasks.memory import MOVED_M
from ..tasks.mobile.travel import Travel, TravelRecord, TravelSettings, travel
from .floor_chapters import (
    MIN_FIT,
    SEEN_SIGMA_M,
    fit_fraction,
    map_picture,
    outline_m,
    route_problem,
    world_map,
)
from .judge import Claim
from .push_demo import show_obstacle
from .results import ChapterResult, Illustration, Measure, counted, done, failed
from .story import Mission

#: Time between two scans that are matched to the map [s].
SCAN_S = 0.33
#: Limit of the drive to the table, and of a tour of exploration before it [s].
TIMEOUT_S = 600.0
#: Mass of fixed objects in the simulated world [kg].
FIXED_KG = 500.0


class _ScanSenses(FloorSenses):
    """Pose by scan matching, and by odometry between scans; touched and observed objects are relative to it."""

    def __init__(self, mission: Mission, world: FloorWorld) -> None:
        super().__init__(world, mission.rng(10))
        self._mission, self._mapper = mission, mission.mapper
        self._odometry = DriftingBase(world.base, mission.rng(12), mission.house.odometry)
        self._laser_rng = mission.rng(13)
        # Odometry continues from the position to which it has led the platform.
        self._counted, self._start = mission.platform.odometry(), as_vector(world.pose_m())
        self._scanned = (world.t_s, self._counted)
        self.jump_at_s, self.jump = math.inf, (0.0, 0.0, 0.0)
        self.pose()

    def pose(self) -> tuple[float, float, float]:
        """Estimated pose of the platform on the map."""
        state, now, true = self._odometry.state(), self._world.t_s, as_vector(self._world.pose_m())
        step = relative_2d(self._start, (state.x_m, state.y_m, state.heading_rad))
        wheels = compose_2d(self._counted, step)
        if now - self._scanned[0] >= SCAN_S:
            self._scanned = (now, wheels)
            place_objects(self._mission, self._world)
            laser = SimulatedLaser(world_map(self._mission), None, self._laser_rng)
            self._mapper.locate(laser.scan(true, now), wheels)
        x, y, heading = compose_2d(self._mapper.pose, relative_2d(self._scanned[1], wheels))
        if now >= self.jump_at_s:
            x, y, heading = x + self.jump[0], y + self.jump[1], heading + self.jump[2]
        self._bias = np.array([x, y, heading]) - true
        return x, y, heading

    def look(self, id: str) -> tuple[float, float, float] | None:
        """Pose of an object on the map, observed from the platform."""
        seen = super().look(id)
        if seen is None:
            return None
        x, y, _ = compose_2d(self.pose(), relative_2d(as_vector(self._world.pose_m()), seen))
        return x, y, seen[2]


def place_objects(mission: Mission, world: FloorWorld) -> None:
    """Record the current true poses.

    Parameters
    ----------
    mission
        Receives the poses.
    world
        World in which the objects were moved.
    """
    for one in mission.house.obstacles:
        x, y, turned = (float(value) for value in world.object_pose_m(one.name))
        mission.placed[one.name] = (x, y, mission.yaw_rad[one.name] + turned)


def drive_to_the_table(mission: Mission) -> ChapterResult:
    """Plan, push, observe, replan; at the end, verify the pose with the laser.

    Parameters
    ----------
    mission
        Mission with map, pose and tagged objects.
    """
    known = mission.known
    fraction = fit_fraction(mission, known.map, mission.platform.pose, known.pose)
    if fraction < MIN_FIT:
        return failed(
            f"only {100 * fraction:.0f} % of the laser scan matches the map: the platform does not start"
        )
    problem = route_problem(mission, known.map, known.objects)
    plan, detour = make_plan(problem), without_pushing(problem)
    if not plan.reachable:
        return failed(f"there is no plan: {plan.reason}")
    world, senses = _world(mission)
    found, track = _travelled(mission, problem, world, senses)
    true_pose = as_vector(world.pose_m())
    error_m = math.dist(true_pose[:2], mission.house.table_m)
    estimated = senses.pose()
    parts = (
        Measure("distance from the place at the table [m]", math.dist(estimated[:2], known.goal_m), error_m),
        Measure("expected duration of its plan [s]", _first_expected_s(found.records)),
        Measure("duration of the drive [s]", found.duration_s),
        Measure(
            "length of a path without a push [m]", detour.length_m if detour.reachable else "none exists"
        ),
        _picture(mission, problem, found, track, world),
    )
    if not found.arrived:
        # Another attempt starts where the previous one ended, with its results.
        mission.platform.go(relative_2d(mission.platform.pose, true_pose))
        known.pose, known.objects = estimated, found.problem.objects
        mission.mapper = OccupancyMapper.from_map(
            known.map, estimated, mission.platform.odometry(), hits_m=mission.mapper.mean_hits_m()
        )
        return failed(f"{found.outcome.value}: {found.reason}", *parts)
    # Odometry is not sufficient: the laser has to match the map from here.
    known.pose = estimated
    fraction = fit_fraction(mission, known.map, true_pose, estimated)
    if fraction < MIN_FIT:
        return failed(
            f"the platform estimates to be there, but only {100 * fraction:.0f} % of what the laser sees "
            "is on the map: its pose or its map is wrong",
            *parts,
        )
    known.arrived = True
    what = pushed_text(found.records)
    mission.record_cost(found.duration_s, found.pushes)
    if mission.memory is not None:
        for before, after in zip(problem.objects, found.problem.objects, strict=True):
            place, memory_name = senses.look(before.id), mission.remembered.get(before.id)
            if place is None or memory_name is None:
                continue
            # What has gone far is movable, whatever it withstood before.
            far = math.dist(place[:2], tuple(before.centre_m)) > MOVED_M
            mission.memory.move_floor_object(memory_name, place, after.tag if far else None)
    arrived = Claim("place", "platform at the table", estimated[:2], true_pose[:2], sigma=SEEN_SIGMA_M)
    return done(f"arrived after {found.duration_s:.0f} s and {found.length_m:.1f} m, {what}", arrived, *parts)


def pushed_text(records: Sequence[TravelRecord]) -> str:
    """Objects that were pushed aside, and those that did not move.

    Parameters
    ----------
    records
        Log of the drive.
    """
    pushes = [record for record in records if record.event in ("pushed", "brushed")]
    # The displacement along the direction of a push; that of an object pushed aside on the way.
    displacements_m = [(one.object, float(np.ravel(one.values["moved_m"])[0])) for one in pushes]
    moved = {name for name, along_m in displacements_m if along_m > TravelSettings().moved_m}
    tried = {name for name, _ in displacements_m} - moved
    texts = [f"{', '.join(sorted(moved))} pushed aside"] if moved else []
    texts += [f"{', '.join(sorted(tried))} did not move"] if tried else []
    return ", ".join(texts) or "nothing had to be pushed"


def _first_expected_s(records: Sequence[TravelRecord]) -> float | None:
    """Expected duration [s] of the plan on which the drive set out; ``None`` without one."""
    return next((record.values["expected_s"] for record in records if record.event == "set out"), None)


def _travelled(
    mission: Mission, problem: PlanningProblem, world: FloorWorld, senses: FloorSenses
) -> tuple[Travel, Float[np.ndarray, "n 3"]]:
    """Drive, display the drive, and record all true poses."""
    track: list[Float[np.ndarray, "3"]] = []

    def wait(seconds: float) -> None:
        world.step(seconds)
        if not track or np.hypot(*(world.pose_m()[:2] - track[-1][:2])) > 0.02:
            track.append(world.pose_m())
            _show(mission, world)

    start_s = world.t_s

    def plan(problem: PlanningProblem) -> Plan:
        """Like :func:`make_plan`, with a message: travel plans with its own margins, and replans after observations."""
        made = make_plan(problem)
        for task in made.tasks:
            what = f"{task.kind} {task.object}".strip()
            mission.log(f"  plan: {what}, {task.length_m:.2f} m{_why(task.object, mission)}")
        return made

    guard = Supervisor(clock=lambda: world.t_s)
    found = travel(
        problem,
        guard.base(world.base),
        guard.senses(senses),
        guard.wait(wait),
        TravelSettings(timeout_s=TIMEOUT_S),
        plan=plan,
    )
    for record in found.records:
        if record.event in ("set out", "pushed", "brushed", "explored", "bumped", "stalled", "arrived"):
            more = f" {record.object}" if record.object else ""
            if record.event == "set out":
                more = f", expected to take {record.values['expected_s']:.0f} s"
            mission.log(f"  {record.t_s - start_s:5.0f} s  {record.event}{more}")
    place_objects(mission, world)
    return found, np.array(track).reshape(-1, 3)


def _why(name: str, mission: Mission) -> str:
    """Static frictions, or what else is known, of the pushed object and of the others."""
    from ..report.run_tables import tag_text

    felt = {
        one: tag_text(tag) if tag.static_friction_N is None else f"{tag.static_friction_N.value:.2f} N"
        for one, tag in mission.tags.items()
    }
    needed = felt.pop(name, "")
    others = "".join(f"; {other}: {text}" for other, text in felt.items())
    return f" ({name}: {needed}{others})" if needed else ""


def _world(mission: Mission) -> tuple[FloorWorld, FloorSenses]:
    """The floor with the objects at their current poses, with their mass."""
    items = []
    for true in mission.house.obstacles:
        shape = true.outlines[0]
        disc = shape.radius_m if len(np.atleast_2d(shape.vertices_m)) == 1 else 0.0
        items.append(
            FloorObject(
                true.name,
                outline_m(mission, true, math.pi / 8),
                true.mass_kg if true.movable else FIXED_KG,
                true.friction if true.movable else 1.0,
                round_m=float(disc),
            )
        )
        mission.yaw_rad[true.name] = mission.placed[true.name][2]
    world = FloorWorld(mission.house.grid, items, mission.platform.pose)
    senses = _ScanSenses(mission, world)
    if mission.fault is FaultKind.LOST_POSE:
        senses.jump_at_s = world.t_s + float(mission.rng(11).uniform(2.0, 25.0))
        angle = float(mission.rng(11).uniform(0, 2 * math.pi))
        senses.jump = (0.6 * math.cos(angle), 0.6 * math.sin(angle), 0.3)
    return world, senses


def _show(mission: Mission, world: FloorWorld) -> None:
    """Objects and platform on the live page."""
    if mission.page is None:
        return
    from ..core.camera.pose import Pose

    x, y, heading = (float(value) for value in world.pose_m())
    angle = np.arange(24) * math.pi / 12
    disc = ROBOT.radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
    mission.page.set_obstacle(
        "platform",
        disc,
        Pose.from_rotation_vector([0.0, 0.0, heading], [x, y, 0.0]),
        height_m=0.15,
        fixed=False,
    )
    place_objects(mission, world)
    for one in mission.house.obstacles:
        show_obstacle(mission.page, one, mission.placed[one.name])


def _picture(
    mission: Mission,
    problem: PlanningProblem,
    found: Travel,
    track: Float[np.ndarray, "n 3"],
    world: FloorWorld,
) -> Illustration:
    objects = [
        MapObject(item.id, item.footprint_m, item.tag, world.footprint_m(item.id)) for item in problem.objects
    ]
    return map_picture(
        mission.known.map,
        track[:, :2],
        objects,
        "The path through the door: measured footprints with their tags, dashed where the objects truly ended; "
        f"{counted(found.pushes, 'push', 'pushes')}, {counted(found.plans, 'plan')}",
    )


def default_arrival(mission: Mission) -> None:
    """The platform is at the position from which the table is reached.

    Parameters
    ----------
    mission
        State of the mission; what the chapter would have found is set.
    """
    mission.known.arrived = True
    mission.known.pose = (*mission.house.table_m, 0.0)
