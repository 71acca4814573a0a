"""The platform touches what stands in the door, and every push becomes a haptic tag."""

from __future__ import annotations

import math
from dataclasses import replace

from ..core.objects import Estimate, HapticTag
from ..core.robots import FrameSource
from ..navigation.problem.planning_problem import MovableObject
from ..simulation.faults import FaultyFrames, frame_faults
from ..tasks.mobile.explore_records import ExploreSettings
from ..tasks.mobile.felt_footprint import felt_footprint
from .office_chapters import ROBOT, approach_to, set_the_door
from .push_demo import SLOWLY, DemoObject, DemoResult, run_demo
from .story import ChapterResult, Illustration, Measure, Mission, done, failed

__all__ = ["default_tags", "explore_obstacles", "tag_is_right"]

#: Friction that is measured must be true within this fraction, or this many of its standard deviations.
FRACTION, SIGMAS = 0.12, 3.0
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
    paths = []
    for group in known.obstacle_points_m:
        # Driven at where the laser has seen it; what stands there is the world's business.
        x, y = float(group[:, 0].min()), float(group[:, 1].mean())
        true = min(mission.paths, key=lambda path: abs(path.obstacle.y_m - y))
        paths.append(approach_to(true.obstacle, x, y))
    if mission.obstacles < len(paths):
        movable = sorted(paths, key=lambda path: path.obstacle.mass_kg if path.obstacle.movable else math.inf)
        paths = movable[: mission.obstacles]
    found = run_demo(
        mission.folder / "touch",
        seed=mission.seed,
        on_message=lambda line: mission.log(f"  {line}" if line else ""),
        page=mission.page,
        scene=(grid, paths),
        explore=_settings(mission),
        through=lambda source: _through(mission, source),
    )
    objects, rights, measures = [], [], []
    for group, one in zip(known.obstacle_points_m, found.objects, strict=False):
        mission.placed[one.name] = one.end_pose
        felt = HapticTag() if one.exploration.fit_state is None else one.tag
        ready = felt.fixed is not None
        mission.tags[one.name] = felt
        outline = felt_footprint(one.exploration, group, front_m=ROBOT.radius_m)
        objects.append(MovableObject(one.name, outline, felt if ready else None))
        if ready:
            rights.append(tag_is_right(one))
        measures += _against_truth(one)
        mission.log(f"  {one.name}: {_felt_text(felt) if ready else one.exploration.outcome.value}")
    known.objects = tuple(objects)
    tagged = sum(item.tag is not None for item in objects)
    parts = (*measures, *_pictures(mission, found.objects, found))
    if not tagged:
        why = ", ".join(f"{one.name} {one.exploration.outcome.value}" for one in found.objects)
        return failed(f"nothing could be tagged: {why}", *parts)
    rest = "" if tagged == len(objects) else f"; {len(objects) - tagged} stay unknown"
    return done(f"{tagged} of {len(objects)} objects were pushed and tagged{rest}", all(rights), *parts)


def _settings(mission: Mission) -> ExploreSettings:
    return QUICK if mission.quick else EXPLORE


def _through(mission: Mission, source: FrameSource) -> FrameSource:
    if mission.fault is None:
        return source
    at_s = float(mission.rng(7).uniform(1.0, 6.0))
    return FaultyFrames(source, frame_faults(mission.fault, at_s), mission.rng(8))


def tag_is_right(one: DemoObject) -> bool:
    """Whether what the tag says is true of the obstacle.

    Parameters
    ----------
    one
        The push with its true obstacle.
    """
    tag, true = one.tag, one.path.obstacle
    if bool(tag.fixed) == true.movable:
        return False
    if not true.movable:
        return True
    felt = tag.static_friction_N
    return felt is None or abs(felt.value - true.static_friction_N) <= max(
        FRACTION * true.static_friction_N, SIGMAS * felt.sigma
    )


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
    if not mission.paths:
        set_the_door(mission)
    rng = mission.rng(9)
    objects = []
    for path in mission.paths:
        true = path.obstacle
        outline = true.outlines[0].moved(*mission.placed[true.name]).polygon_m(math.pi / 8)
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
