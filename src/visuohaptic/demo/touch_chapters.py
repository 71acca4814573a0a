"""The platform touches what stands in the door, and every push becomes a haptic tag."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..core.geometry import compose_2d, relative_2d, rotation_2d
from ..core.objects import Estimate, HapticTag
from ..core.robots import FrameSource
from ..navigation.problem.planning_problem import MovableObject
from ..simulation.faults import FaultyFrames, frame_faults
from ..simulation.mobile.office import ApproachPath
from ..tasks.mobile.explore_records import ExploreSettings
from ..tasks.mobile.felt_footprint import felt_footprint
from .floor_chapters import ROBOT, default_door, near_side, nearest_obstacle, outline_m
from .judge import Claim
from .push_demo import SLOWLY, DemoObject, DemoResult, run_demo
from .story import ChapterResult, Illustration, Measure, Mission, done, failed

__all__ = ["default_tags", "explore_obstacles", "tag_claims"]

#: From the platform's hull to what it drives at: the foam, and floor on which the camera sees it come [m].
START_M = 0.03 + 0.17
EXPLORE = replace(SLOWLY, free_ahead_m=0.1, search_m=0.4)
#: A shorter drive and a shorter push: for tests.
QUICK = replace(
    SLOWLY, approach_m_s=0.05, push_m_s=0.04, search_m=0.3, push_m=0.035, halt_s=0.3, back_off_m=0.02
)


def explore_obstacles(mission: Mission) -> ChapterResult:
    """Drive at each, push, and take down friction, shape and whether it moves.

    Parameters
    ----------
    mission
        With the laser points of each object; receives tags and footprints.
    """
    known = mission.known
    grid = known.map_now
    assert grid is not None
    if not known.obstacle_points_m:
        return done("nothing is in the way that could be touched")
    paths = [_approach(mission, group) for group in known.obstacle_points_m]
    order = sorted(range(len(paths)), key=lambda k: _mass_kg(paths[k]))[: mission.obstacles]
    found = run_demo(
        mission.folder / "touch",
        seed=mission.seed,
        on_message=lambda line: mission.log(f"  {line}" if line else ""),
        page=mission.page,
        scene=(grid, [paths[k] for k in sorted(order)]),
        explore=_settings(mission),
        through=lambda source: _through(mission, source),
    )
    objects, claims, measures = [], [], []
    for k, one in zip(sorted(order), found.objects, strict=True):
        mission.placed[one.name] = one.end_pose
        mission.spent(one.exploration.states[-1].t_s - one.exploration.states[0].t_s, 1)
        felt = HapticTag() if one.exploration.fit_state is None else one.tag
        ready = felt.fixed is not None
        mission.tags[one.name] = felt
        # The push is told by the platform's own motion, and seen from where the laser had it.
        outline = felt_footprint(
            one.exploration, _moved(known.obstacle_points_m[k], known.pose, _true_pose(mission)),
            front_m=ROBOT.radius_m, heading_rad=paths[k].start[2],
        )  # fmt: skip
        outline = _moved(outline, _true_pose(mission), known.pose)
        objects.append(MovableObject(one.name, outline, felt if ready else None))
        if ready:
            claims += tag_claims(one)
        measures += _against_truth(one)
        mission.log(f"  {one.name}: {_felt_text(felt) if ready else one.exploration.outcome.value}")
    known.objects = tuple(objects)
    tagged = sum(item.tag is not None for item in objects)
    parts = (*claims, *measures, *_pictures(mission, found.objects, found))
    if not tagged:
        why = ", ".join(f"{one.name} {one.exploration.outcome.value}" for one in found.objects)
        return failed(f"nothing could be tagged: {why}", *parts)
    rest = "" if tagged == len(objects) else f"; {len(objects) - tagged} stay unknown"
    return done(f"{tagged} of {len(objects)} objects were pushed and tagged{rest}", *parts)


def _approach(mission: Mission, group: Float[np.ndarray, "k 2"]) -> ApproachPath:
    """Driven at where the laser has seen it; what stands there, and where that truly is, are the world's business."""
    ahead = mission.known.ahead_rad
    x, y = near_side(group, ahead)[0]
    true = nearest_obstacle(mission, group.mean(axis=0))
    here = relative_2d(mission.known.pose, (float(x), float(y), ahead))
    before = ROBOT.radius_m + START_M
    start = compose_2d(compose_2d(_true_pose(mission), here), (-before, 0.0, 0.0))
    return ApproachPath(true.moved(*mission.placed[true.name]), start, before)


def _true_pose(mission: Mission) -> tuple[float, float, float]:
    assert mission.platform is not None
    return mission.platform.pose


def _moved(
    points_m: Float[np.ndarray, "k 2"],
    before: tuple[float, float, float],
    after: tuple[float, float, float],
) -> Float[np.ndarray, "k 2"]:
    """Points as seen from one pose, in a frame where that pose is another."""
    turn = rotation_2d(after[2] - before[2])
    return (points_m - before[:2]) @ turn.T + after[:2]


def _mass_kg(path: ApproachPath) -> float:
    return path.obstacle.mass_kg if path.obstacle.movable else math.inf


def _settings(mission: Mission) -> ExploreSettings:
    return QUICK if mission.quick else EXPLORE


def _through(mission: Mission, source: FrameSource) -> FrameSource:
    if mission.fault is None:
        return source
    at_s = float(mission.rng(7).uniform(1.0, 6.0))
    return FaultyFrames(source, frame_faults(mission.fault, at_s), mission.rng(8))


def tag_claims(one: DemoObject) -> list[Claim]:
    """What a tag says beside the obstacle's truth.

    Parameters
    ----------
    one
        The push with its true obstacle.
    """
    tag, true = one.tag, one.path.obstacle
    claims = [Claim("fixed", one.name, bool(tag.fixed), not true.movable)]
    felt = tag.static_friction_N
    if felt is not None and true.movable:
        claims.append(Claim("friction", one.name, felt.value, true.static_friction_N, sigma=felt.sigma))
    return claims


def _felt_text(tag: HapticTag) -> str:
    from ..report.run_tables import primitive_text, tag_text

    return f"{tag_text(tag)}; {primitive_text(tag.primitive) or 'no shape'}"


def _against_truth(one: DemoObject) -> list[Measure]:
    true, tag = one.path.obstacle, one.tag
    rows = [Measure(f"{one.name}: fixed", tag.fixed, not true.movable)]
    if true.movable:
        for what, felt, value in (
            ("static", tag.static_friction_N, true.static_friction_N),
            ("dynamic", tag.dynamic_friction_N, true.dynamic_friction_N),
        ):
            rows.append(Measure(f"{one.name}: {what} friction [N]", felt.value if felt else None, value))
    from .push_demo_report import error_figures

    error = error_figures(one).get("rms error [N]")
    if error is not None:
        rows.append(Measure(f"{one.name}: rms error of the force [N]", error, None))
    return rows


def _pictures(mission: Mission, objects: tuple[DemoObject, ...], result: DemoResult) -> list[Illustration]:
    from .push_demo_report import annotated_push, force_of_push

    found = []
    for one in objects:
        picture = annotated_push(result, one, split=False)
        if picture is not None:
            found.append(
                Illustration(
                    picture,
                    f"{one.name}: what the camera sees at the largest force, and what is read from it",
                )
            )
        if not any(sample.truth_N > 0.05 for sample in one.samples):
            continue
        found.append(
            Illustration(
                force_of_push(one), f"{one.name}: force over time with two sigma, the truth, and the events"
            )
        )
    return found


def default_tags(mission: Mission) -> None:
    """Tags as a push would have given them: the truth, off by a few per cent.

    Parameters
    ----------
    mission
        Receives tags and footprints.
    """
    if not mission.known.obstacle_points_m:
        default_door(mission)
    rng = mission.rng(9)
    objects = []
    near = [nearest_obstacle(mission, group.mean(axis=0)) for group in mission.known.obstacle_points_m]
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
