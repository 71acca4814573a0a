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
from dataclasses import replace

import numpy as np

from ...core import InputError, rotation_2d
from ..problem import Plan, PlanningProblem, Task, failure_probability
from ..pushing.push_failure import sampled_pushes
from .arrays import Point
from .drive_tasks import drive_tasks
from .off_centre_rollouts import Rollout, contacts_after, drive_of, fits, opens_passage, retreat, rollouts
from .replanning import after_push
from .search.domain_builder import build_search_domain
from .search.drives import pull_string
from .search.push_states import Deadline, SearchLimits
from .search.search_domain import world_from_grid

#: Maximum number of simulated candidates, and number of samples of the uncertain parameters for each.
MAX_PLANS, SAMPLES = 6, 12

#: A drive to the start of a push, if it is elsewhere, and the push: start, contact, end and retreat of the robot's centre.
Tasks = tuple[Task, ...]


def plan_off_centre_pushes(
    problem: PlanningProblem,
    planner: Callable[[PlanningProblem], Plan] | None = None,
    *,
    margin_m: float = 0.0,
    among: Collection[str] | None = None,
    deadline: Deadline | None = None,
) -> tuple[Tasks, ...]:
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
    deadline
        Time limit, by default that of a search: a half of the time is for the simulations, the other half for what the
        pushes lead to.

    Returns
    -------
    The drive to each push, if there is one, and the push; sorted by expected cost, cost / (1 - probability of failure). If
    any of them clears a passage, all do.

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
    deadline = deadline or Deadline.after(SearchLimits().budget_s)
    among = {obj.id for obj in problem.objects} if among is None else among
    ends = rollouts(domain, margin_m, among, deadline.earlier(0.5 * deadline.left_s))
    opening = [end for end in ends if not deadline.passed and opens_passage(end, end.pose)]
    if opening:
        chosen = _diverse(sorted(opening, key=_seconds))
    elif planner is not None:
        ranked = sorted(ends, key=lambda end: (deadline.passed or -contacts_after(end), _seconds(end)))
        chosen = [end for end in _diverse(ranked) if not deadline.passed and _solved_after(end, planner)]
    else:
        chosen = []
    pushes = filter(None, (_tasks(end, deadline, opens=bool(opening)) for end in chosen))
    return tuple(sorted(pushes, key=_expected_s))


def via_off_centre(
    problem: PlanningProblem,
    rest: Callable[[PlanningProblem, str], Plan],
    among: Collection[str],
    deadline: Deadline,
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
    deadline
        Time limit.
    """
    found, best_s = Plan(False, reason="off-centre pushes clear no path either"), math.inf
    pushes = plan_off_centre_pushes(problem, lambda after: rest(after, ""), among=among, deadline=deadline)
    for push in pushes:
        turn = push[-1]
        moved_m, at_m = np.array(turn.displacement_m), np.array(turn.path_m[-1])
        after = after_push(problem, turn.object, moved_m, at_m, turn_rad=turn.turn_rad)
        plan = Plan(False) if deadline.passed else rest(after, turn.object)
        expected_s = _expected_s(push) + plan.cost_s
        if expected_s < best_s:
            found, best_s = replace(plan, tasks=(*push, *plan.tasks), gap=math.inf), expected_s
    return found


def _expected_s(push: Tasks) -> float:
    return sum(task.cost_s for task in push) / max(1.0 - push[-1].failure_probability, 1e-3)


def _solved_after(rollout: Rollout, planner: Callable[[PlanningProblem], Plan]) -> bool:
    problem, body = rollout.scene.domain.problem, rollout.scene.body
    moved_m, at_m = _moved_m(rollout), world_from_grid(problem.map, retreat(rollout))
    return planner(after_push(problem, body.obj.id, moved_m, at_m, turn_rad=float(rollout.pose[2]))).reachable


def _moved_m(rollout: Rollout) -> Point:
    """Displacement of the body's centroid in the map frame [m]."""
    return np.asarray(rollout.pose[:2] @ rotation_2d(rollout.scene.domain.map.origin[2]).T)


def _tasks(rollout: Rollout, deadline: Deadline, *, opens: bool) -> Tasks:
    """The drive and the push; none if there is no drive to its start, or no time left."""
    domain, obj, moved_m = rollout.scene.domain, rollout.scene.body.obj, _moved_m(rollout)
    grid, robot = domain.map, domain.robot
    still = np.zeros((len(domain.bodies), 2))
    path, cost = pull_string(domain, still, domain.start, rollout.approach_at)
    if not len(path) or deadline.passed:
        return ()
    lengths = np.array([0.0, rollout.scene.stand_off, rollout.length_m / grid.resolution_m])
    along = rollout.approach_at + lengths[:, None] * rollout.direction
    way_m = world_from_grid(grid, np.vstack([along, retreat(rollout)]))
    # Drift and rotation of straight pushes do not apply here; the counters and the force do.
    holds = 1.0 - failure_probability(obj.tag, 0.0, robot, domain.costs)
    holds *= 1.0 - _missed(rollout, deadline, opens=opens)
    turn = Task(
        "turn", robot.setup_time_s + rollout.length_m / robot.v_push_m_s,
        float(np.hypot(*np.diff(way_m, axis=0).T).sum()), tuple((float(x), float(y)) for x, y in way_m), obj.id,
        displacement_m=(float(moved_m[0]), float(moved_m[1])),
        goal_m=(float(obj.centre_m[0] + moved_m[0]), float(obj.centre_m[1] + moved_m[1])),
        turn_rad=float(rollout.pose[2]), failure_probability=1.0 - holds,
    )  # fmt: skip
    return (*drive_tasks(domain, still, path, cost), turn)


def _missed(rollout: Rollout, deadline: Deadline, *, opens: bool) -> float:
    """Fraction of simulated pushes that collide, do not produce the intended result, or 1 if the time ends."""
    path = drive_of(rollout.scene, rollout.direction, rollout.approach_at, rollout.length_m)
    scene, rng = rollout.scene, np.random.default_rng(0)
    _, along, blocked = sampled_pushes(
        scene.model, (0.0, 0.0, 0.0), path, scene.radius_m, rng, samples=SAMPLES
    )
    failed = 0
    for poses in along[~blocked]:
        if deadline.passed:
            return 1.0
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
