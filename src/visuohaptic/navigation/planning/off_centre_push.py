"""Off-centre pushes, which rotate an object where no straight push through its centre clears a passage (Sec. 4.3.2).

A box that stands obliquely in a door has no face that a straight push
could use. Pushed at its end it rotates; then either the passage is clear or a
straight push is possible again. The object's motion is predicted by the quasi-static
model, and each push is rated by the resulting situation: a clear passage at best, otherwise a
problem that the planner can solve. Alt 2016 has sideward pushes only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import numpy as np

from ...core import InputError, rotation_2d
from ..problem import Plan, PlanningProblem, Task, failure_probability
from ..pushing.push_failure import sampled_pushes
from .arrays import Path, Point
from .off_centre_rollouts import (
    BACK_OFF_M,
    Rollout,
    contacts_after,
    drive_of,
    fits,
    opens_passage,
    retreat,
    rollouts,
)
from .replanning import after_push
from .search.domain_builder import build_search_domain
from .search.drives import pull_string
from .search.search_domain import world_from_grid

#: Maximum number of simulated candidates, and number of samples of the uncertain parameters for each.
MAX_PLANS, SAMPLES = 6, 12


@dataclass(frozen=True, slots=True, eq=False)
class OffCentrePush:
    """A straight drive against an object that rotates it; map frame."""

    object: str
    approach_m: Path  #: path of the robot's centre to the start of the push
    direction_rad: float
    length_m: float  #: path length of the robot from there
    free_m: float  #: part of that length before the contact
    displacement_m: Point  #: predicted, of the object's centroid
    turn_rad: float  #: predicted
    failure_probability: float
    cost_s: float  #: setup and drive
    opens: bool  #: whether no further push is needed after it
    approach_s: float  #: part of the cost: the drive to the start
    goal_m: tuple[float, float]  #: predicted position of the object's centroid

    @property
    def tasks(self) -> tuple[Task, ...]:
        """The drive to its start, if there is one, and the push: start, contact, end and retreat of the robot's centre."""
        ahead = np.array([math.cos(self.direction_rad), math.sin(self.direction_rad)])
        along = self.start_m + np.outer([0.0, self.free_m, self.length_m], ahead)
        approach, path = (
            tuple((float(x), float(y)) for x, y in points)
            for points in (self.approach_m, (*along, self.retreat_m))
        )
        driven_m = float(np.hypot(*np.diff(self.approach_m, axis=0).T).sum())
        x, y = (float(value) for value in self.displacement_m)
        turn = Task(
            "turn",
            self.cost_s - self.approach_s,
            self.length_m + float(np.hypot(*(along[2] - self.retreat_m))),
            path,
            self.object,
            displacement_m=(x, y),
            goal_m=self.goal_m,
            turn_rad=self.turn_rad,
            failure_probability=self.failure_probability,
        )
        return (Task("navigate", self.approach_s, driven_m, approach), turn)[len(approach) < 2 :]

    @property
    def start_m(self) -> Point:
        """Approach pose: start of the push, x, y [m]."""
        return self.approach_m[-1]

    @property
    def retreat_m(self) -> Point:
        """Retreat pose: position of the robot after backing off, x, y [m]."""
        ahead = np.array([math.cos(self.direction_rad), math.sin(self.direction_rad)])
        return self.start_m + max(self.length_m - BACK_OFF_M, 0.0) * ahead


def plan_off_centre_pushes(
    problem: PlanningProblem,
    planner: Callable[[PlanningProblem], Plan] | None = None,
    *,
    margin_m: float = 0.0,
    among: Collection[str] | None = None,
) -> tuple[OffCentrePush, ...]:
    """Pushes that rotate an object and clear a passage, the best first; empty if none was found.

    Parameters
    ----------
    problem
        Map, objects, robot, start and goal; unexplored objects stay in place.
    planner
        Planner that tests whether the problem after a push can be solved, if no push clears a passage by itself.
    margin_m
        Difference between the radius of the problem's robot and that of the pushing rim [m].
    among
        Ids of the objects that may be pushed; all by default.

    Returns
    -------
    Sorted by expected cost, cost / (1 - probability of failure); those that clear a passage come first.

    Raises
    ------
    InputError
        The margin is not less than the robot's radius.
    """
    problem.robot.check_disc("off-centre pushes are planned")
    if not 0 <= margin_m < problem.robot.radius_m:
        raise InputError(
            "plan_off_centre_pushes", f"found a margin of {margin_m} m, expected 0 to the robot's radius"
        )
    domain = build_search_domain(problem)
    ends = rollouts(domain, margin_m, among)
    opening = [rollout for rollout in ends if opens_passage(rollout, rollout.pose)]
    if opening:
        chosen = _diverse(sorted(opening, key=_seconds))
    elif planner is not None:
        ranked = sorted(ends, key=lambda rollout: (-contacts_after(rollout), _seconds(rollout)))
        chosen = [rollout for rollout in _diverse(ranked) if _solved_after(rollout, planner)]
    else:
        chosen = []
    plans = [_evaluated(rollout, opens=bool(opening)) for rollout in chosen]
    pushes = [push for push in plans if len(push.approach_m)]
    return tuple(sorted(pushes, key=lambda push: push.cost_s / max(1.0 - push.failure_probability, 1e-3)))


def via_off_centre(
    problem: PlanningProblem,
    rest: Callable[[PlanningProblem, str], Plan],
    among: Collection[str],
    left: Callable[[], bool],
) -> Plan:
    """The cheapest plan that starts with an off-centre push, by the expected time of its tasks.

    Parameters
    ----------
    problem
        Map, objects, robot, start and goal.
    rest
        Planner for the problem after the push of an object with this id.
    among
        Ids of the objects that may be pushed.
    left
        Whether there is time left.
    """
    found, best_s = Plan(False, reason="off-centre pushes clear no path either"), math.inf
    for push in plan_off_centre_pushes(problem, lambda after: rest(after, ""), among=among):
        after = after_push(problem, push.object, push.displacement_m, push.retreat_m, turn_rad=push.turn_rad)
        plan = rest(after, push.object) if left() else Plan(False)
        expected_s = push.cost_s / max(1.0 - push.failure_probability, 1e-3) + plan.cost_s
        if expected_s < best_s:
            found, best_s = replace(plan, tasks=(*push.tasks, *plan.tasks), gap=math.inf), expected_s
    return found


def _solved_after(rollout: Rollout, planner: Callable[[PlanningProblem], Plan]) -> bool:
    problem, body = rollout.scene.domain.problem, rollout.scene.body
    moved_m, at_m = _predicted(rollout)[0], world_from_grid(problem.map, retreat(rollout))
    return planner(after_push(problem, body.obj.id, moved_m, at_m, turn_rad=float(rollout.pose[2]))).reachable


def _predicted(rollout: Rollout) -> tuple[Point, float]:
    """Displacement of the body's centroid in the map frame [m], and the direction of the drive there [rad]."""
    turned = rotation_2d(rollout.scene.domain.map.origin[2]).T
    ahead = rollout.direction @ turned
    return rollout.pose[:2] @ turned, math.atan2(ahead[1], ahead[0])


def _evaluated(rollout: Rollout, *, opens: bool) -> OffCentrePush:
    domain, obj = rollout.scene.domain, rollout.scene.body.obj
    moved_m, direction_rad = _predicted(rollout)
    goal_m = obj.centre_m + moved_m
    path, _ = pull_string(domain, np.zeros((len(domain.bodies), 2)), domain.start, rollout.approach_at)
    # Drift and rotation of straight pushes do not apply here; the counters and the force do.
    holds = 1.0 - failure_probability(obj.tag, 0.0, domain.robot, domain.costs)
    holds *= 1.0 - _missed(rollout, opens=opens)
    return OffCentrePush(
        obj.id,
        world_from_grid(domain.map, path),
        direction_rad,
        rollout.length_m,
        rollout.scene.stand_off * domain.map.resolution_m,
        moved_m,
        float(rollout.pose[2]),
        1.0 - holds,
        domain.robot.setup_time_s + _seconds(rollout),
        opens,
        rollout.approach_s,
        (float(goal_m[0]), float(goal_m[1])),
    )


def _missed(rollout: Rollout, *, opens: bool) -> float:
    """Fraction of simulated pushes that collide or do not produce the intended result."""
    path = drive_of(rollout.scene, rollout.direction, rollout.approach_at, rollout.length_m)
    _, along, blocked = sampled_pushes(
        rollout.scene.model,
        (0.0, 0.0, 0.0),
        path,
        rollout.scene.radius_m,
        np.random.default_rng(0),
        samples=SAMPLES,
    )
    failed = 0
    for poses in along[~blocked]:
        pose = poses[-1]
        off = np.abs(pose - rollout.pose)
        arrived = np.hypot(*off[:2]) < 0.05 and off[2] < 0.3
        held = opens_passage(rollout, pose) if opens else arrived
        failed += not (held and fits(rollout.scene, poses).all())
    return failed / SAMPLES


def _seconds(rollout: Rollout) -> float:
    return rollout.approach_s + rollout.length_m / rollout.scene.domain.robot.v_push_m_s


def _diverse(ends: list[Rollout]) -> list[Rollout]:
    """The first rollouts that differ in object, position or rotation."""
    kept: list[Rollout] = []
    for rollout in ends:
        if len(kept) == MAX_PLANS:
            break
        if all(
            rollout.scene is not other.scene
            or np.hypot(*(rollout.pose[:2] - other.pose[:2])) > 0.08
            or abs(rollout.pose[2] - other.pose[2]) > 0.25
            for other in kept
        ):
            kept.append(rollout)
    return kept
