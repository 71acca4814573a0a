"""The platform touches the objects in the door; every push provides a haptic tag."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.geometry import compose_2d, relative_2d
from ..core.objects import Estimate, HapticTag
from ..core.robots import FrameSource
from ..navigation.planning.exploration import Tour, exploration_tour
from ..navigation.planning.policies import make_plan
from ..navigation.problem.planning_problem import MovableObject
from ..report.floor_chart import MapObject
from ..rigs.virtual_office import ROBOT
from ..sensing.push.tag import BOUND_PROBABILITY, fixed_probability
from ..simulation.faults import FaultyFrames, frame_faults
from ..simulation.mobile.obstacles import SimulatedObstacle
from ..simulation.mobile.office import ApproachPath
from ..tasks.memory import MOVED_M
from ..tasks.mobile.floor_outline import FloorOutline
from ..tasks.mobile.footprint_after_push import footprint_after_push
from ..tasks.mobile.known_objects import recognise
from .drive_chapters import TIMEOUT_S
from .floor_chapters import default_door, map_picture, outline_m, route_problem
from .judge import Claim
from .push_demo import (
    SLOW_EXPLORATION,
    DemoObject,
    DemoResult,
    annotated_push,
    force_of_push,
    run_demo,
)
from .results import ChapterResult, Illustration, Measure, counted, done, failed
from .story import Mission, Story

if TYPE_CHECKING:
    from ..viewer.page import LivePage


#: Distance from the platform's hull to its target: the foam of the virtual sensor, 2 cm wide, and floor on which the camera can
#: observe the target, 18 cm [m].
FOAM_M, FLOOR_M = 0.02, 0.18
START_M = FOAM_M + FLOOR_M
#: Position from the laser: an object that looks like the floor is not detected by the camera.
EXPLORE = replace(SLOW_EXPLORATION, free_ahead_m=0.1, search_m=0.4, expected_m=FLOOR_M)
#: A shorter drive and a shorter push: for tests.
QUICK = replace(EXPLORE, free_ahead_m=0.2, search_m=0.3, push_m=0.035, halt_s=0.3, back_off_m=0.02)


def explore_obstacles(mission: Mission) -> ChapterResult:
    """Drive to each object, push, and record friction, shape and whether it moves.

    Parameters
    ----------
    mission
        Mission with the laser points of each object; receives tags and footprints.
    """
    known = mission.known
    grid = known.map_now
    if not known.obstacles:
        return done("there is no obstacle that could be touched")
    objects: list[MovableObject] = []
    claims: list[Claim] = []
    unknown = []
    for (seen, _), recalled in zip(known.obstacles, _recall(mission), strict=True):
        if recalled is None:
            unknown.append(seen)
            continue
        objects.append(recalled)
        claims += tag_claims(mission.nearest_obstacle(seen.centre_m), recalled.tag)
    if not unknown:
        known.objects = tuple(objects)
        return done(f"all {len(objects)} objects are known from an earlier visit", *claims)
    order, tour = choose_objects(mission, unknown, objects)
    mission.log(f"  tour of exploration: {tour.summary}{_after(order, tour)}")
    found = run_demo(
        mission.folder / "touch",
        (grid, [_approach(mission, unknown[k]) for k in order]),
        seed=mission.seed,
        on_message=lambda line: mission.log(f"  {line}" if line else ""),
        page=mission.page,
        explore=QUICK if mission.quick else EXPLORE,
        wrap_frames=lambda source: _with_faults(mission, source),
    )
    measures = [
        Measure("expected passages opened by the tour of exploration", tour.opens),
        Measure("planned duration of this tour [s]", tour.time_s),
    ]
    for k, one in zip(order, found.objects, strict=True):
        objects.append(_take(mission, one, unknown[k]))
        if objects[-1].tag is not None:
            claims += tag_claims(one.path.obstacle, one.tag)
        measures += _against_truth(one)
    known.objects = tuple(objects)
    tagged = sum(item.tag is not None for item in objects)
    parts = (
        *claims,
        *measures,
        _tour_picture(mission, unknown, order, tour),
        *_pictures(found, *found.objects),
    )
    if not tagged:
        why = ", ".join(f"{one.name} {one.exploration.ending.why}" for one in found.objects)
        return failed(f"nothing could be tagged: {why}", *parts)
    rest = "" if tagged == len(objects) else f"; {len(objects) - tagged} stay unknown"
    before = f", {len(objects) - len(order)} known from before" if len(objects) > len(order) else ""
    return done(f"{tagged} of {len(objects)} objects were pushed and tagged{rest}{before}", *parts)


def choose_objects(
    mission: Mission, unknown: Sequence[FloorOutline], recalled: Sequence[MovableObject] = ()
) -> tuple[list[int], Tour]:
    """Objects to touch, in the order of the tour with the greatest expected benefit; then the others, the nearest first.

    If not all of them can be touched, those that a plan to the table would explore come before all others.

    Parameters
    ----------
    mission
        Mission with map, pose, goal, and the maximum number of objects to touch.
    unknown
        Outlines of objects without a tag.
    recalled
        Objects that are known from an earlier visit.

    Returns
    -------
    indices into ``unknown``, and the tour
    """
    names = [f"new {k + 1}" for k in range(len(unknown))]
    untouched = [MovableObject(name, one.corners_m) for name, one in zip(names, unknown, strict=True)]
    problem = route_problem(mission, mission.known.map, (*recalled, *untouched))
    tour = exploration_tour(problem, TIMEOUT_S)
    some = len(unknown) > mission.obstacles
    explored = [task.object for task in make_plan(problem).tasks] if some else []
    ranks = {step.object: rank for rank, step in enumerate(tour.steps)}
    here = mission.known.pose[:2]

    def late_and_far(k: int) -> tuple[bool, int, float]:
        away_m = math.dist(here, tuple(unknown[k].centre_m))
        return names[k] not in explored, ranks.get(names[k], len(ranks)), away_m

    return sorted(range(len(unknown)), key=late_and_far)[: mission.obstacles], tour


def _after(order: Sequence[int], tour: Tour) -> str:
    """What is touched without being in the tour."""
    others = len(order) - len(tour.steps)
    return f"; then {counted(others, 'other object')}" if tour.steps and others > 0 else ""


def _tour_picture(
    mission: Mission, unknown: Sequence[FloorOutline], order: Sequence[int], tour: Tour
) -> Illustration:
    """The planned tour on the map, with the place of each object in the order and its benefit."""
    benefits = {step.object: f"opens a passage ({step.opens:.2f})" for step in tour.steps} | tour.left_out
    objects = []
    for place, k in enumerate(order, 1):
        name = mission.nearest_obstacle(unknown[k].centre_m).name
        objects.append(MapObject(f"{place}. {name}: {benefits[f'new {k + 1}']}", unknown[k].corners_m))
    paths_m = [np.array(task.path_m) for task in tour.tasks if task.path_m]
    return map_picture(
        mission.known.map_now,
        np.concatenate(paths_m) if paths_m else np.array([mission.known.pose[:2]]),
        objects,
        f"Which objects to touch, and in which order: {tour.summary}{_after(order, tour)}; in brackets the probability",
    )


def touch_in_map(
    folder: Path,
    map_path: Path,
    *,
    seed: int,
    on_message: Callable[[str], None],
    page: LivePage | None = None,
) -> Story:
    """Touch three obstacles in a user's map; one chapter each.

    Parameters
    ----------
    folder
        Receives the recordings.
    map_path
        A map_server YAML.
    seed
        Seed of all random numbers.
    on_message
        Called with each line of the log.
    page
        Live page.
    """
    found = run_demo(folder, map_path, seed=seed, on_message=on_message, page=page)
    chapters = []
    for one in found.objects:
        ended = done if one.exploration.ending.success else failed
        why = f"{one.exploration.outcome.value}: {_felt_text(one.tag)}"
        on_message(f"{one.name}: {why}")
        parts = (*tag_claims(one.path.obstacle, one.tag), *_against_truth(one), *_pictures(found, one))
        chapters.append(replace(ended(why, *parts), name=one.name, title=one.name))
    return Story(tuple(chapters), Mission(seed, folder), found.duration_s)


def _take(mission: Mission, one: DemoObject, seen: FloorOutline) -> MovableObject:
    """Result of a push, and the current pose of the object."""
    known, true = mission.known, mission.platform.pose
    mission.placed[one.name] = one.end_pose
    mission.record_cost(one.exploration.states[-1].t_s - one.exploration.states[0].t_s, 1)
    felt = HapticTag() if one.exploration.fit_state is None else one.tag
    mission.tags[one.name] = felt
    # The push is known from the platform's own motion, relative to the laser's position of the object.
    outline = footprint_after_push(one.exploration, _moved(seen, known.pose, true), front_m=ROBOT.radius_m)
    outline = _moved(outline, true, known.pose)
    ready = felt.fixed is not None or felt.min_static_friction_N is not None
    if ready and mission.memory is not None:
        others = set(mission.remembered.values())
        mission.remembered[one.name] = mission.memory.store_floor_object(outline, felt, others)
    ending = one.exploration.ending
    mission.log(f"  {one.name}: {_felt_text(felt) if ready else f'{ending.outcome}: {ending.why}'}")
    return MovableObject(one.name, outline.corners_m, felt if ready else None)


def _approach(mission: Mission, seen: FloorOutline) -> ApproachPath:
    """Drive to the near side by the laser; the object there and its true pose are taken from the simulated world."""
    true = mission.nearest_obstacle(seen.centre_m)
    here = relative_2d(mission.known.pose, seen.pose)
    here = compose_2d(here, (0.0, 0.25 * seen.size_m[0] * mission.attempt, 0.0))
    before = ROBOT.radius_m + START_M
    start = compose_2d(compose_2d(mission.platform.pose, here), (-before, 0.0, 0.0))
    return ApproachPath(true.moved(*mission.placed[true.name]), start, before)


def _moved(
    outline: FloorOutline, before: tuple[float, float, float], after: tuple[float, float, float]
) -> FloorOutline:
    """Transform an outline, observed from one pose, to a frame with another pose."""
    return replace(outline, pose=compose_2d(after, relative_2d(before, outline.pose)))


def _with_faults(mission: Mission, source: FrameSource) -> FrameSource:
    if mission.fault is None:
        return source
    at_s = float(mission.rng(7).uniform(1.0, 6.0))
    return FaultyFrames(source, frame_faults(mission.fault, at_s), mission.rng(8))


def tag_claims(true: SimulatedObstacle, tag: HapticTag | None) -> list[Claim]:
    """Compare a tag with the obstacle's ground truth.

    Parameters
    ----------
    true
        The obstacle.
    tag
        Measured tag, from now or an earlier visit.
    """
    if tag is None:
        return []
    claims, bound = [], tag.min_static_friction_N
    needed_N = true.static_friction_N if true.movable else math.inf
    if tag.fixed is not None:
        sure = fixed_probability(bound, EXPLORE.max_force_N) if tag.fixed and bound is not None else 1.0
        fixed = needed_N > EXPLORE.max_force_N
        claims.append(Claim("fixed", true.name, tag.fixed, fixed, probability=sure))
    if bound is not None:
        # Two standard deviations below the measured value.
        claims.append(Claim("withstood", true.name, True, needed_N > bound, probability=BOUND_PROBABILITY))
    felt = tag.static_friction_N
    if felt is not None and true.movable:
        claims.append(Claim("friction", true.name, felt.value, true.static_friction_N, sigma=felt.sigma))
    return claims


def _recall(mission: Mission) -> list[MovableObject | None]:
    """Stored data for each object on the path."""
    known = mission.known
    if mission.memory is None:
        return [None] * len(known.obstacles)
    found: list[MovableObject | None] = []
    matches = recognise(known.obstacles, mission.memory.floor_objects())
    for (seen, _), match in zip(known.obstacles, matches, strict=True):
        if match is None:
            found.append(None)
            continue
        one, probability, outline = match
        name = mission.nearest_obstacle(seen.centre_m).name
        mission.remembered[name] = one.id.removeprefix(f"{mission.memory.place}.")
        assert one.tag is not None
        mission.tags[name] = one.tag
        found.append(MovableObject(name, outline.corners_m, one.tag))
        moved_m = math.dist(one.seen.position_m[:2], outline.centre_m) if one.seen else math.nan
        been = f", {moved_m:.1f} m from where it was left" if moved_m > MOVED_M else ""
        mission.log(
            f"  {mission.remembered[name]} is known (probability {probability:.2f}){been}: {_felt_text(one.tag)}"
        )
    return found


def _felt_text(tag: HapticTag) -> str:
    from ..report.run_tables import primitive_text, tag_text

    return f"{tag_text(tag)}; {primitive_text(tag.primitive) or 'no shape'}"


def _against_truth(one: DemoObject) -> list[Measure]:
    true, tag = one.path.obstacle, one.tag
    rows, bound = [], tag.min_static_friction_N
    if bound is not None:
        rows.append(Measure(f"{one.name}: static friction, lower bound [N]", bound, true.static_friction_N))
    if true.movable:
        felt = tag.dynamic_friction_N
        value = felt.value if felt else None
        rows.append(Measure(f"{one.name}: dynamic friction [N]", value, true.dynamic_friction_N))
    errors = [felt.force_N - true_N for felt, true_N in one.samples if felt.valid and true_N > 0.1]
    if errors:
        rms_N = float(np.sqrt(np.mean(np.square(errors))))
        rows.append(Measure(f"{one.name}: rms error of the force [N]", rms_N, None))
    return rows


def _pictures(result: DemoResult, *objects: DemoObject) -> list[Illustration]:
    """Camera image and force of every object that was touched, as measured or in truth."""
    found = []
    for one in objects:
        picture = annotated_push(result, one)
        if one.exploration.events and picture is not None:
            what = "what the camera sees at the largest force, and what is read from it"
            found.append(Illustration(picture, f"{one.name}: {what}"))
        if one.exploration.events or any(true_N > 0.05 for _, true_N in one.samples):
            what = "force over time with two sigma, the truth, and the events"
            found.append(Illustration(force_of_push(one), f"{one.name}: {what}"))
    return found


def default_tags(mission: Mission) -> None:
    """Tags as a push would provide them: ground truth with errors of a few per cent.

    Parameters
    ----------
    mission
        Receives tags and footprints.
    """
    if not mission.known.obstacles:
        default_door(mission)
    rng = mission.rng(9)
    objects = []
    near = [mission.nearest_obstacle(seen.centre_m) for seen, _ in mission.known.obstacles]
    for true in near:
        outline = outline_m(mission, true, math.pi / 8)
        tag = HapticTag(fixed=not true.movable, explored=1, failed=0)
        if true.movable:
            off = 1.0 + 0.03 * float(rng.standard_normal())
            tag = HapticTag(
                static_friction_N=Estimate(off * true.static_friction_N, 0.05 * true.static_friction_N),
                dynamic_friction_N=Estimate(off * true.dynamic_friction_N, 0.05 * true.dynamic_friction_N),
                fixed=False,
                explored=1,
                failed=0,
            )
        mission.tags[true.name] = tag
        objects.append(MovableObject(true.name, outline, tag))
    mission.known.objects = tuple(objects)
