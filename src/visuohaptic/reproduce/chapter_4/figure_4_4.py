"""Planning of the sideward push (Fig. 4.4).

Two scenes with static obstacles (grey), a movable object (orange) and the platform (blue). Left: straight
candidates, green where the object separates in time, dotted grey otherwise. Right: one success and one failure,
the object's path in red; dashed is the MuJoCo simulation of the same drive (the dissertation used simulation too).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...core.geometry import rotation_2d
from ...io.maps.occupancy_map import OccupancyMap
from ...navigation.planning.off_centre_rollouts import scene_of
from ...navigation.planning.search.domain_builder import build_search_domain
from ...navigation.planning.sideward_push import SidewardOutcome, evaluate_push, sideward_candidates
from ...navigation.problem.planning_problem import MovableObject, PlanningProblem
from ...navigation.pushing.push_model import PushModel, load_of_feet, patch_points
from ...navigation.pushing.quasi_static import PushTrace, arc_path
from ...report.style import COLOURS, draw_axes
from ...rigs.virtual_office import ROBOT, box, rooms
from .._building import draw_map, outline
from ..output import Columns, Output
from ..pushes.floor_push import FloorBody, FloorPush

FRICTION, FLOOR, HEIGHT_m, ROUND_m = 0.2, 0.3, 0.03, 0.005
LENGTH_m = 1.0
#: Of the simulated drive: friction stops what slides at it within v^2 / (2 mu g) = 0.4 mm; twice it, 1.7 mm.
SPEED_m_s = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """One map with one obstacle on the path."""

    name: str
    grid: OccupancyMap
    footprint_m: np.ndarray
    enter_m: tuple[float, float]
    leave_m: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    """One straight drive."""

    path_m: np.ndarray
    outcome: SidewardOutcome
    trace: PushTrace | None


def _scenes() -> tuple[Scene, Scene]:
    """A round object in a wide passage, a box in a narrow one."""
    angle = np.linspace(0, 2 * math.pi, 24, endpoint=False)
    disc = 0.16 * np.column_stack([np.cos(angle), np.sin(angle)]) + (1.5, 1.05)
    wide = rooms(3.4, 2.1, [(0.9, 0.0, 1.1, 0.4), (0.9, 1.75, 1.1, 2.1), (2.6, 1.5, 2.9, 1.8)])
    narrow = rooms(3.4, 2.1, [(0.9, 0.0, 2.3, 0.45), (0.9, 1.65, 1.2, 2.1), (2.3, 1.6, 2.7, 2.1)])
    return (
        Scene("round object", wide, disc, (0.5, 1.0), (3.0, 1.0)),
        Scene("box", narrow, box(1.55, 1.05, 0.3, 0.36, 0.3), (0.5, 1.1), (3.0, 1.1)),
    )


def run(out: Output) -> None:
    """Evaluate all straight candidates, then simulate a success and a failure in MuJoCo.

    Parameters
    ----------
    out
        Receives the table ``candidates``, picture ``sideward_push``, and the comparisons; its seed and size are used.
    """
    rows = Columns("scene x0_m y0_m x1_m y1_m outcome")
    shown, off, agree = [], [], []
    counts = dict.fromkeys(SidewardOutcome, 0)
    for scene in _scenes()[:1] if out.quick else _scenes():
        found, model, at = _candidates(scene)
        for one in found:
            counts[one.outcome] += 1
            rows.add(scene.name, *one.path_m[0, :2], *one.path_m[-1, :2], str(one.outcome))
        chosen = _two(found)
        truths = []
        for one in chosen:
            truth = _driven(model, at, one, 6 * SPEED_m_s if out.quick else SPEED_m_s)
            truths.append(truth)
            assert one.trace is not None
            away = truth.object_m[-1, :2] - one.trace.object_m[-1, :2]
            off.append(float(np.hypot(*away)))
            agree.append(truth.dropped == one.trace.released)
        shown.append((scene, found, model, chosen, truths))
    out.table("candidates", rows)
    out.picture("sideward_push", draw_axes(2, 3, lambda *axes: _draw(axes, shown), size=(13.0, 6.4)))
    for outcome in (SidewardOutcome.RELEASED, SidewardOutcome.CONTACT, SidewardOutcome.COLLISION):
        out.compare(
            f"straight candidates that end as: {outcome}", counts[outcome], f"of {sum(counts.values())}"
        )
    out.compare("shown drives: end of the object off MuJoCo's, largest", 100 * max(off), "cm",
                note="before it meets a wall, which MuJoCo was not given")  # fmt: skip
    out.compare("shown drives: drop predicted as in MuJoCo", sum(agree), f"of {len(agree)}")


def _candidates(scene: Scene) -> tuple[list[_Candidate], PushModel, tuple[float, float, float]]:
    enter_m, leave_m = np.array(scene.enter_m), np.array(scene.leave_m)
    obstacle = MovableObject(scene.name, scene.footprint_m)
    centre = obstacle.centre_m
    # MuJoCo's outlines have rounded corners; a push above the floor shifts the load.
    outline_m = (obstacle.footprint_m - centre) * (1 - ROUND_m / 0.15)
    feet, _ = patch_points(outline_m, 16)
    model = PushModel(outline_m, feet, load_of_feet(feet), FRICTION, ROUND_m, FLOOR * HEIGHT_m)
    domain = build_search_domain(PlanningProblem(scene.grid, ROBOT, enter_m, leave_m, (obstacle,)))
    pushed = replace(scene_of(domain, 0), model=model)
    starts, ends = sideward_candidates(
        pushed, enter_m - centre, leave_m - centre, slide_m=LENGTH_m, starts=7, ends=4
    )
    found, at = [], np.array([*centre, 0.0])
    for start in starts:
        for end in ends:
            path = arc_path(start, end, 0.0)
            outcome, trace = evaluate_push(pushed, path)
            placed = path + at
            if trace is not None:
                trace = replace(trace, platform_m=placed, object_m=trace.object_m + at)
            found.append(_Candidate(placed, outcome, trace))
    return found, model, (float(centre[0]), float(centre[1]), 0.0)


def _two(found: list[_Candidate]) -> list[_Candidate]:
    """The success that moves the object most, and a failure: a collision before contact at the end."""
    good = [one for one in found if one.outcome is SidewardOutcome.RELEASED]
    chosen = sorted(good, key=lambda one: -one.trace.moved_m if one.trace else 0.0)[:1]
    for outcome in (SidewardOutcome.COLLISION, SidewardOutcome.CONTACT):
        bad = [one for one in found if one.outcome is outcome]
        if bad:
            return [*chosen, bad[len(bad) // 2]]
    return chosen


def _driven(model: PushModel, at: tuple[float, float, float], one: _Candidate, speed_m_s: float) -> Any:
    obstacle = FloorBody(
        model.outline_m, model.support_m, model.round_m, mass_kg=2.0, push_height_m=HEIGHT_m,
        floor_friction=FLOOR, contact_friction=FRICTION,
    )  # fmt: skip
    fine = arc_path(one.path_m[0, :2], one.path_m[-1, :2], 0.0, 0.01)
    return FloorPush(obstacle, at, fine[0], ROBOT.radius_m).drive(fine, speed_m_s)


def _draw(axes: Any, shown: list[Any]) -> None:
    for row, (scene, found, model, chosen, truths) in enumerate(shown):
        three = axes[3 * row : 3 * row + 3]
        for axis in three:
            draw_map(axis, scene.grid)
            axis.fill(*scene.footprint_m.T, color=COLOURS["orange"], alpha=0.45, lw=0)
            axis.set(
                xlabel="x [m]" if row == len(shown) - 1 else "", ylabel="y [m]" if axis is three[0] else ""
            )
        for one in found:
            good = one.outcome is SidewardOutcome.RELEASED
            three[0].plot(*one.path_m[:, :2].T, "-" if good else ":", lw=1.1 if good else 0.8,
                          color=COLOURS["green"] if good else COLOURS["grey"])  # fmt: skip
        three[0].set_title(f"{'ad'[row]}  {scene.name}: candidates")
        for axis, one, truth, letter in zip(three[1:], chosen, truths, ("bc", "ef")[row], strict=False):
            _drive(axis, one, truth, model)
            axis.set_title(f"{letter}  {one.outcome}")


def _drive(axis: Any, one: _Candidate, truth: Any, model: PushModel) -> None:
    trace = one.trace
    assert trace is not None
    axis.plot(*one.path_m[:, :2].T, color=COLOURS["blue"], lw=1.2)
    angle = np.linspace(0, 2 * math.pi, 60)
    rim = ROBOT.radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
    for k in (0, len(one.path_m) - 1):
        axis.fill(*(rim + one.path_m[k, :2]).T, color=COLOURS["sky"], alpha=0.35, lw=0)
    for k in range(0, len(trace.object_m), max(1, len(trace.object_m) // 6)):
        outline(axis, _placed(model, trace.object_m[k]), color="red", lw=0.5, alpha=0.6)
    outline(axis, _placed(model, trace.object_m[-1]), color="red", lw=1.6)
    axis.plot(*trace.object_m[:, :2].T, color="red", lw=1.0)
    outline(axis, _placed(model, truth.object_m[-1]), color=COLOURS["ink"], lw=1.0, ls="--")


def _placed(model: PushModel, pose: np.ndarray) -> np.ndarray:
    out: np.ndarray = model.outline_m @ rotation_2d(pose[2]).T + pose[:2]
    return out
