"""From a problem to a plan: search over pushes, then string-pulled paths between them (Alt 2016, Sec. 4.2.1)."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from ..problem.path_plan import Plan, Task
from ..problem.planning_problem import PlanningProblem
from ..problem.push_costs import PushCosts, push_cost
from ..pushing._outline_kernels import polygon_distance
from .arrays import Point, Shifts
from .drive_tasks import drive_tasks
from .footprint.footprint_drives import FootprintDrives
from .place_costs import place_s
from .search._travel_kernels import clearances_at
from .search.drives import pull_string
from .search.push_ends import turn_probability
from .search.push_lengths import end_of_push
from .search.push_search import load_kernels, search_pushes
from .search.push_states import Deadline, PushStep, SearchLimits, SearchResult
from .search.search_domain import SearchDomain, world_from_grid

#: Fraction of the budget for the search; the rest is for the drives of the plan.
SEARCH_FRACTION = 0.9
#: Allowed decrease of the interpolated clearance along a straight escape path [cells].
ESCAPE_SLACK = 0.02


def plan_in_domain(
    domain: SearchDomain,
    limits: SearchLimits | None = None,
    *,
    active: Collection[int] | None = None,
    oblique: bool = False,
    name: str = "cheapest",
    weights: PushCosts | None = None,
) -> Plan:
    """Search and assemble a plan in a prepared domain.

    Parameters
    ----------
    domain
        From :func:`~visuohaptic.navigation.planning.search.domain_builder.build_search_domain`.
    limits
        Limits of the search.
    active
        Indices of the bodies that may be pushed; all of them by default.
    oblique
        Whether pushes may be oblique to a face.
    name
        Side condition, for the plan's label.
    weights
        Costs of the search, if they weigh other quantities than the durations of the tasks.
    """
    limits, weights, robot = limits or SearchLimits(), weights or domain.costs, domain.robot
    load_kernels()
    deadline, receive = Deadline.after(limits.budget_s), limits.found
    begin = domain.start if robot.footprint_m else escape(domain, domain.start)
    if begin is None:
        return Plan(False, reason=_stuck(domain, domain.start), proved=True, name=name)

    def searched(among: SearchDomain, limits: SearchLimits) -> SearchResult:
        return search_pushes(among, begin, limits, costs=weights, active=active, oblique=oblique)

    def report(first: SearchResult) -> None:
        plan = _assembled(domain, first, begin, deadline, name)
        if receive is not None and plan.reachable:
            receive(plan)

    first_s = SEARCH_FRACTION * limits.budget_s
    result = searched(domain, replace(limits, budget_s=first_s, found=report if receive else None))
    plan = _assembled(domain, result, begin, deadline, name)
    if plan.reachable or not (robot.footprint_m and result.found) or deadline.passed:
        return plan
    # The circle in the footprint fits where the footprint does not: now with room between objects for the one around it.
    room = (robot.reach_m - robot.radius_m) / domain.map.resolution_m
    wide = replace(domain, bodies=tuple(replace(body, room=room) for body in domain.bodies))
    found = searched(wide, replace(limits, budget_s=max(deadline.left_s, 1e-9), found=None))
    other = _assembled(wide, replace(found, bound=result.bound), begin, deadline, name)
    return other if other.reachable else plan


def _assembled(
    domain: SearchDomain, result: SearchResult, begin: Point, deadline: Deadline, name: str
) -> Plan:
    """Tasks of a search result that starts at ``begin``: driving along string-pulled paths, pushes with goal and risk."""
    notes, narrow = _notes(domain, result), result.narrow
    if not result.found:
        proved, expanded = result.exhausted, result.expanded
        return Plan(False, (), result.reason, proved, expanded, name, notes=notes, narrow=narrow)
    tasks: list[Task] = []
    at = domain.start
    shifts = np.zeros((len(domain.bodies), 2))
    if (begin != at).any():
        slowly = float(np.hypot(*(begin - at))) * domain.slow
        tasks += drive_tasks(domain, shifts, np.array([at, begin]), slowly)
        notes = (
            f"the start is too near to an obstacle: {tasks[0].length_m:.2f} m away from it first",
            *notes,
        )
        at = begin
    ends = [*(step.approach for step in result.steps), domain.goal]
    shaped = FootprintDrives(domain, deadline) if domain.robot.footprint_m else None
    heading, longer = _heading(domain.problem), 0.0
    for last, step, end in zip([None, *result.steps], [*result.steps, None], ends, strict=True):
        path, cost = pull_string(domain, shifts, at, end, deadline)
        if shaped is not None:
            longer -= cost
            path, cost, back = shaped.leg(shifts, (at, heading), last, step, end)
            longer, heading = longer + cost, shaped.heading(step)
            if last is not None and back:
                tasks[-1] = _backed_off(domain, tasks[-1], last, back)
                longer += back * last.length * domain.slow
        if not len(path):
            what = "a drive" if shaped is None else "a drive or push of its footprint"
            return Plan(False, reason=f"{what} of the plan is too narrow on the map", name=name, notes=notes)
        tasks += drive_tasks(domain, shifts, path, cost)
        if step is not None:
            tasks += _push_tasks(domain, step)
            at, shifts = step.retreat, step.shifts_after
    notes += _place_notes(domain, shifts)
    gap = max((result.cost + longer) / result.bound - 1.0, 0.0) if result.bound > 0 else float("inf")
    return Plan(True, tuple(tasks), expanded=result.expanded, name=name, notes=notes, gap=gap, narrow=narrow)


def _place_notes(domain: SearchDomain, shifts: Shifts) -> tuple[str, ...]:
    """The bodies that end in places with a cost."""
    return tuple(
        f"{body.obj.id} ends in a place to avoid, at {cost_s:g} s"
        for body, shift in zip(domain.bodies, shifts, strict=True)
        if shift.any() and (cost_s := place_s(domain, body, shift)) > 0
    )


def _backed_off(domain: SearchDomain, push: Task, step: PushStep, share: float) -> Task:
    """A push whose robot backs off farther, by a share of the push."""
    at = step.retreat + share * (step.approach - step.retreat)
    more_m = share * step.length * domain.map.resolution_m
    return replace(
        push,
        path_m=(*push.path_m[:-1], _pair(world_from_grid(domain.map, at))),
        length_m=push.length_m + more_m,
        cost_s=push.cost_s + more_m / domain.robot.v_min_m_s,
    )


def _heading(problem: PlanningProblem) -> float:
    """Heading of the start on the grid [rad]; NaN: any."""
    yaw = problem.start_yaw_rad
    return math.nan if yaw is None else yaw - problem.map.origin[2]


def escape(domain: SearchDomain, start: Point) -> Point | None:
    """Position to which a robot that starts in collision can escape straight without approaching an obstacle; else its start.

    Parameters
    ----------
    domain
        Static map and bodies.
    start
        Grid coordinates [cells].

    Returns
    -------
    The start if the robot fits there or next to it; none if no free cell is within its radius.
    """

    reach = int(np.ceil(domain.radius)) + 1
    low = np.maximum(np.floor(start).astype(int) - 2 * reach, 0)
    shifts = np.zeros((len(domain.bodies), 2))
    clearance = domain.part(domain.clearance, low, low + 4 * reach, shifts, 1)
    near, _ = domain.seeds(clearance, start - low, reach=2, block=1)
    places = np.column_stack([near % clearance.shape[1], near // clearance.shape[1]]) + low + 0.5
    if near.size and domain.clear_straight(shifts, start, places).any():
        return start
    start = start - low
    if clearances_at(clearance, start[None])[0] <= 0.0:
        return None
    cells, costs = domain.seeds(clearance, start, reach=reach, block=1)
    columns = clearance.shape[1]
    for cell in cells[np.argsort(costs, kind="stable")]:
        place = np.array([cell % columns + 0.5, cell // columns + 0.5])
        steps = np.linspace(0.0, 1.0, 4 * reach)[:, None]
        if (np.diff(clearances_at(clearance, start + steps * (place - start))) >= -ESCAPE_SLACK).all():
            return place + low
    return None


def _stuck(domain: SearchDomain, start: Point) -> str:
    """Reason why a robot cannot leave its start."""

    outlines = [(body.obj.id, body.outline) for body in domain.bodies]
    outlines += [
        (obj.id, outline) for obj, outline in zip(domain.immovable, domain.immovable_outlines, strict=True)
    ]
    near = [id for id, outline in outlines if polygon_distance(*start, outline) < domain.radius]
    blamed = " and ".join(near) or "a wall or unknown cells"
    return f"the robot does not fit at its start, next to {blamed}, and cannot leave it in a straight line"


def _push_tasks(domain: SearchDomain, step: PushStep) -> list[Task]:
    body, costs = domain.bodies[step.body], domain.costs
    contact = body.push(step.contact)
    before, after = step.shifts_before[step.body], step.shifts_after[step.body]
    bodies = body.centre + np.array([before + contact.contact, after, before])
    contact_m, goal_m, from_m = world_from_grid(domain.map, bodies)
    way_m = world_from_grid(domain.map, np.array([step.approach, step.touch + after - before, step.retreat]))
    moved_m = goal_m - from_m
    length_m = float(np.hypot(*moved_m))
    turned = turn_probability(domain, step.body, step.contact, step.length) if contact.oblique else 0.0
    push = push_cost(body.obj.tag, length_m, domain.robot, costs, turn_probability=turned)
    driven_m = float(np.hypot(*np.diff(way_m, axis=0).T).sum())
    tasks: list[Task] = []
    if body.allowed.unknown and not np.any(before):
        touch = Task("explore", costs.explore_time_s, object=body.obj.id, contact_m=_pair(contact_m))
        tasks.append(replace(touch, failure_probability=push.failure_probability))
    cost_s = push.total_s - (push.fail_s if body.allowed.unknown else 0.0)
    known = push.failure_probability
    if body.allowed.unknown:  # once it has been explored, only the risk of a first push remains
        known = costs.prior_failures / (1.0 + costs.prior_failures + costs.prior_successes)
    turn_rad, covariance = end_of_push(domain, step)
    pushed = Task(
        "push", cost_s, driven_m, tuple(map(_pair, way_m)), body.obj.id, _pair(contact_m), _pair(goal_m), _pair(moved_m),
        turn_rad, failure_probability=known, end_covariance=tuple(map(tuple, covariance.tolist())),
    )  # fmt: skip
    return [*tasks, pushed]


def _pair(point: Point) -> tuple[float, float]:
    return float(point[0]), float(point[1])


def _notes(domain: SearchDomain, result: SearchResult) -> tuple[str, ...]:
    notes = [f"{obj.id} is not pushed: {domain.why_immovable[obj.id]}" for obj in domain.immovable]
    if result.left_out:
        names = ", ".join(domain.bodies[index].obj.id for index in result.left_out)
        notes.append(f"left out, not near a bottleneck between start and goal: {names}")
    return tuple(notes)
