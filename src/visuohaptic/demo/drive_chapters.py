"""Plan with the measured tags, push one object aside, and arrive at the table."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from ..core.objects import HapticTag
from ..navigation.planning.policies import make_plan, without_pushing
from ..navigation.problem.path_plan import Plan
from ..navigation.problem.planning_problem import PlanningProblem
from ..simulation.faults import FaultKind
from ..simulation.floor.floor_model import FloorObject
from ..simulation.floor.floor_senses import FloorSenses
from ..simulation.floor.floor_world import FloorWorld
from ..tasks.framework.supervised_parts import Supervisor
from ..tasks.mobile.travel.navigate import Travel, travel
from ..tasks.mobile.travel.travel_memory import map_with_footprints
from ..tasks.mobile.travel.travel_types import TravelSettings
from .office_chapters import GOAL, LOOK, MIN_FIT, ROBOT, fit_fraction, office_map
from .push_demo import show_obstacle
from .story import ChapterResult, Illustration, Measure, Mission, counted, done, failed

__all__ = ["drive_to_the_table"]

#: The table can be served from so far off the goal [m].
NEAR_M = 0.15
#: What is screwed to the floor weighs this much in the simulated world [kg].
FIXED_KG = 500.0


class _LostSenses(FloorSenses):
    """The pose is lost at a time, and taken up elsewhere."""

    jump_at_s = math.inf
    jump = (0.0, 0.0, 0.0)

    def pose(self) -> tuple[float, float, float]:
        x, y, heading = super().pose()
        if self._world.t_s < self.jump_at_s:
            return x, y, heading
        return x + self.jump[0], y + self.jump[1], heading + self.jump[2]


def drive_to_the_table(mission: Mission) -> ChapterResult:
    """Plan, push, look, plan again; at the end see whether the laser agrees.

    Parameters
    ----------
    mission
        With map, pose and tagged objects.
    """
    known = mission.known
    assert known.map is not None
    grid = map_with_footprints(known.map, [item.footprint_m for item in known.objects])
    problem = PlanningProblem(grid, ROBOT, np.array(known.pose[:2]), np.array(GOAL), known.objects)
    plan, detour = make_plan(problem), without_pushing(problem)
    if not plan.reachable:
        return failed(f"there is no plan: {plan.reason}")
    world, senses = _world(mission)
    found, track = _travelled(mission, problem, world, senses)
    true_pose = tuple(float(value) for value in world.pose_m())
    error_m = math.hypot(true_pose[0] - GOAL[0], true_pose[1] - GOAL[1])
    estimated = senses.pose()
    parts = (
        Measure(
            "distance from the goal at the end [m]",
            math.hypot(estimated[0] - GOAL[0], estimated[1] - GOAL[1]),
            error_m,
        ),
        Measure("planned duration [s]", plan.cost_s, None),
        Measure("duration of the drive [s]", found.duration_s, None),
        Measure(
            "length of a path without a push [m]",
            detour.length_m if detour.reachable else "none exists",
            None,
        ),
        _picture(mission, problem, found, track, world),
    )
    if not found.arrived:
        return failed(f"{found.outcome.value}: {found.reason}", *parts)
    # Odometry and wishes are not enough: the laser has to see the map from here.
    known.pose = estimated
    fraction = fit_fraction(mission, known.map, (true_pose[0], true_pose[1], true_pose[2]), estimated)
    if fraction < MIN_FIT:
        return failed(
            f"the platform estimates to be there, but only {100 * fraction:.0f} % of what the laser sees "
            "is on the map: its pose or its map is wrong",
            *parts,
        )
    known.arrived = True
    pushed = sorted({record.object for record in found.records if record.event == "pushed"})
    what = f"{', '.join(pushed)} pushed aside" if pushed else "nothing had to be pushed"
    return done(
        f"arrived after {found.duration_s:.0f} s and {found.length_m:.1f} m, {what}", error_m < NEAR_M, *parts
    )


def _travelled(
    mission: Mission, problem: PlanningProblem, world: FloorWorld, senses: FloorSenses
) -> tuple[Travel, Float[np.ndarray, "n 3"]]:
    """Drive, show it, and take down where everything truly went."""
    track: list[Float[np.ndarray, "3"]] = []

    def wait(seconds: float) -> None:
        world.step(seconds)
        if not track or np.hypot(*(world.pose_m()[:2] - track[-1][:2])) > 0.02:
            track.append(world.pose_m())
            _show(mission, world)

    start_s = world.t_s

    def plan(problem: PlanningProblem) -> Plan:
        """As :func:`make_plan`, and said: travel plans with margins of its own, and again when it has looked."""
        made = make_plan(problem)
        for task in made.tasks:
            what = f"{task.kind} {task.object}".strip()
            mission.log(
                f"  plan: {what}, {task.length_m:.2f} m, {task.cost_s:.0f} s{_why(task.object, mission)}"
            )
        return made

    guard = Supervisor(clock=lambda: world.t_s)
    found = travel(
        problem,
        guard.base(world.base),
        guard.senses(senses),
        guard.wait(wait),
        TravelSettings(timeout_s=600.0),
        plan=plan,
    )
    for record in found.records:
        if record.event in ("pushed", "explored", "bumped", "stalled", "arrived"):
            more = f" {record.object}" if record.object else ""
            mission.log(f"  {record.t_s - start_s:5.0f} s  {record.event}{more}")
    for path in mission.paths:
        x_m, y_m, yaw_rad = map(float, world.item_pose_m(path.obstacle.name))
        mission.placed[path.obstacle.name] = (x_m, y_m, yaw_rad)
    return found, np.array(track).reshape(-1, 3)


def _why(name: str, mission: Mission) -> str:
    tag = mission.tags.get(name)
    if tag is None or tag.static_friction_N is None:
        return ""
    others = [f"{other} {_word(tag)}" for other, tag in mission.tags.items() if other != name]
    return f" (it takes {tag.static_friction_N.value:.1f} N; {', '.join(others)})"


def _word(tag: HapticTag) -> str:
    if tag.fixed:
        return "does not move"
    return f"{tag.static_friction_N.value:.1f} N" if tag.static_friction_N else "is not known"


def _world(mission: Mission) -> tuple[FloorWorld, FloorSenses]:
    """The office with the objects where they are now, with their mass."""
    items = []
    for path in mission.paths:
        true = path.obstacle
        outline = true.outlines[0].moved(*mission.placed[true.name]).polygon_m(math.pi / 8)
        disc = true.outlines[0].radius_m if len(np.atleast_2d(true.outlines[0].vertices_m)) == 1 else 0.0
        items.append(
            FloorObject(
                true.name,
                outline,
                true.mass_kg if true.movable else FIXED_KG,
                true.friction if true.movable else 1.0,
                round_m=float(disc),
            )
        )
    rng = mission.rng(10)
    world = FloorWorld(office_map(), items, LOOK)
    if mission.fault is not FaultKind.LOST_POSE:
        return world, FloorSenses(world, rng)
    senses = _LostSenses(world, rng)
    senses.jump_at_s = world.t_s + float(mission.rng(11).uniform(2.0, 25.0))
    angle = float(mission.rng(11).uniform(0, 2 * math.pi))
    senses.jump = (0.6 * math.cos(angle), 0.6 * math.sin(angle), 0.3)
    return world, senses


def _show(mission: Mission, world: FloorWorld) -> None:
    """Things and platform on the live page."""
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
    for path in mission.paths:
        x, y, turn = (float(value) for value in world.item_pose_m(path.obstacle.name))
        show_obstacle(mission.page, path.obstacle, (x, y, turn))


def _picture(
    mission: Mission,
    problem: PlanningProblem,
    found: Travel,
    track: Float[np.ndarray, "n 3"],
    world: FloorWorld,
) -> Illustration:
    from ..report.floor_chart import MapObject, floor_map

    objects = [
        MapObject(item.id, item.footprint_m, item.tag, world.footprint_m(item.id)) for item in problem.objects
    ]
    grid = mission.known.map
    assert grid is not None
    x, y, _ = grid.origin
    path = track[:, :2] if len(track) else None
    figure = floor_map(
        grid.cells,
        grid.resolution_m,
        (x, y),
        path_world_m=path,
        objects=objects,
        robot_radius_m=ROBOT.radius_m,
    )
    return Illustration(
        figure,
        "The path through the door: footprints as felt with their tags, dashed where the objects truly ended; "
        f"{counted(found.pushes, 'push', 'pushes')}, {counted(found.plans, 'plan')}",
    )


def default_arrival(mission: Mission) -> None:
    """The platform stands where the table can be served from."""
    mission.known.arrived = True
    mission.known.pose = (*GOAL, 0.0)
