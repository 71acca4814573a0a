"""From a problem to a plan: search over pushes, then string-pulled paths between them (Alt 2016, Sec. 4.2.1)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32

from ..problem.path_plan import Plan, Task
from ..problem.planning_problem import PlanningProblem
from ..problem.push_costs import PushCosts, push_cost
from .search.push_search import search_pushes
from .search.push_states import PushStep, SearchLimits, SearchResult, seed_cells
from .search.search_domain import SearchDomain, grid_from_world, world_from_grid

__all__ = ["assemble", "plan_in_domain"]

#: Points of a grid path that one straight segment may span.
STRING_WINDOW = 80
#: Corners are cut at most so many times.
STRING_ROUNDS = 12


def plan_in_domain(
    problem: PlanningProblem,
    domain: SearchDomain,
    costs: PushCosts | None = None,
    limits: SearchLimits | None = None,
    *,
    name: str = "cheapest",
    report_costs: PushCosts | None = None,
) -> Plan:
    """Search and assemble a plan in a domain that was prepared before.

    Parameters
    ----------
    problem
        Start and goal; its map and objects are those that ``domain`` was made from.
    domain
        From :func:`~visuohaptic.navigation.planning.search.search_domain.build_search_domain`.
    costs, limits
        What a push costs; how long to search.
    name
        Side condition, for the plan's label.
    report_costs
        What the tasks' seconds are computed with, where ``costs`` weighs something else than time.
    """
    costs = costs or PushCosts()
    start = grid_from_world(problem.map, problem.start_m)
    goal = grid_from_world(problem.map, problem.goal_m)
    result = search_pushes(domain, start, goal, costs, limits)
    return assemble(problem, domain, result, report_costs or costs, name=name)


def assemble(
    problem: PlanningProblem,
    domain: SearchDomain,
    result: SearchResult,
    costs: PushCosts,
    *,
    name: str = "cheapest",
) -> Plan:
    """Tasks of a search result: driving along string-pulled paths, pushes with contact, goal and risk.

    Parameters
    ----------
    problem
        Start and goal.
    domain
        What was searched.
    result
        Pushes in order.
    costs
        What the seconds of the tasks are computed with.
    name
        Side condition, for the plan's label.
    """
    notes = _notes(domain)
    if not result.found:
        return Plan(
            False,
            reason=result.reason,
            proved=result.exhausted,
            expanded=result.expanded,
            name=name,
            notes=notes,
        )
    tasks: list[Task] = []
    at = grid_from_world(problem.map, problem.start_m)
    shifts = np.zeros((len(domain.bodies), 2))
    for step in result.steps:
        tasks += _drive(domain, shifts, at, step.approach)
        tasks += _push_tasks(domain, step, costs)
        at, shifts = step.retreat, step.shifts_after
    tasks += _drive(domain, shifts, at, grid_from_world(problem.map, problem.goal_m))
    return Plan(True, tuple(tasks), expanded=result.expanded, name=name, notes=notes)


def _drive(
    domain: SearchDomain,
    shifts: Float[np.ndarray, "bodies 2"],
    start: Float[np.ndarray, "2"],
    goal: Float[np.ndarray, "2"],
) -> list[Task]:
    clearance = domain.clearance_with(shifts)
    path, cost = pull_string(domain, clearance, start, goal)
    if len(path) < 2:
        return []
    path_m = world_from_grid(domain.map, path)
    length_m = float(np.hypot(*np.diff(path_m, axis=0).T).sum())
    return [Task("navigate", domain.seconds(cost), length_m, tuple((float(x), float(y)) for x, y in path_m))]


def pull_string(
    domain: SearchDomain,
    clearance: Float32[np.ndarray, "rows columns"],
    start: Float[np.ndarray, "2"],
    goal: Float[np.ndarray, "2"],
) -> tuple[Float[np.ndarray, "k 2"], float]:
    """Cheapest any-angle path between two points: over the grid, then string pulling where that costs no more.

    Returns
    -------
    corners in grid coordinates, cost [cells at full speed]; empty and infinite when there is none
    """
    from .search._travel_kernels import FAR, UNITS, string_pull, travel_field

    if np.hypot(*(goal - start)) < 1e-9:
        return start[None], 0.0
    radius, slow = domain.radius, domain.slow
    cells, costs = seed_cells(clearance, start, radius, slow, UNITS, reach=2)
    ends, end_costs = seed_cells(clearance, goal, radius, slow, UNITS, reach=1)
    nothing = np.zeros((0, 0), np.int32)
    none = np.zeros(0, np.int32)
    if not cells.size or not ends.size:
        return np.zeros((0, 2)), float("inf")
    cost, came, _ = travel_field(clearance, radius, slow, cells, costs, nothing, none, none, 0)
    total = cost[ends].astype(np.int64) + end_costs
    if total.min() >= FAR:
        return np.zeros((0, 2)), float("inf")
    cell = int(ends[int(total.argmin())])
    columns = clearance.shape[1]
    points = [goal]
    while cell >= 0:
        points.append(np.array([cell % columns + 0.5, cell // columns + 0.5]))
        cell = int(came[cell])
    points.append(start)
    path = np.array(points[::-1])
    kept, string_pulled_cost = string_pull(clearance, radius, slow, path, STRING_WINDOW)
    path = path[kept]
    # A second look joins pieces that were cut by the window.
    kept, string_pulled_cost = string_pull(clearance, radius, slow, path, STRING_WINDOW)
    path = path[kept]
    # The path over cells has eight directions only; chords between points along it cut its corners.
    for _ in range(STRING_ROUNDS):
        dense = _resampled(path, STRING_WINDOW)
        kept, cost_now = string_pull(clearance, radius, slow, dense, STRING_WINDOW)
        if not cost_now < string_pulled_cost:
            break
        gain = 1.0 - cost_now / string_pulled_cost
        path, string_pulled_cost = dense[kept], cost_now
        if gain < 1e-4:
            break
    distinct = np.ones(len(path), dtype=bool)
    distinct[1:] = np.hypot(*np.diff(path, axis=0).T) > 1e-9
    return path[distinct], float(string_pulled_cost)


def _resampled(path: Float[np.ndarray, "k 2"], count: int) -> Float[np.ndarray, "n 2"]:
    """The corners of a path and about ``count`` points between them, evenly along it."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    places = np.union1d(along, np.linspace(0.0, along[-1], max(count - len(path), 2)))
    return np.column_stack([np.interp(places, along, path[:, axis]) for axis in (0, 1)])


def _push_tasks(domain: SearchDomain, step: PushStep, costs: PushCosts) -> list[Task]:
    body = domain.bodies[step.body]
    contact = body.contacts[step.contact]
    before, after = step.shifts_before[step.body], step.shifts_after[step.body]
    grid = np.array(
        [
            body.centre + before + contact.contact,
            body.centre + after,
            body.centre + before,
            step.approach,
            step.approach + after - before + (step.touch - step.approach),
            step.retreat,
        ]
    )
    contact_m, goal_m, from_m, stand_m, pushed_m, retreat_m = world_from_grid(domain.map, grid)
    moved_m = goal_m - from_m
    length_m = float(np.hypot(*moved_m))
    push = push_cost(body.obj.tag, length_m, domain.robot, costs, oblique=contact.oblique)
    path_m = tuple((float(x), float(y)) for x, y in (stand_m, pushed_m, retreat_m))
    driven_m = float(np.hypot(*(pushed_m - stand_m)) + np.hypot(*(retreat_m - pushed_m)))
    tasks: list[Task] = []
    first = not np.any(before)
    if body.allowed.unknown and first:
        tasks.append(
            Task(
                "explore",
                costs.explore_time_s,
                object=body.obj.id,
                contact_m=_pair(contact_m),
                failure_probability=push.failure_probability,
            )
        )
    cost_s = push.total_s - (push.fail_s if body.allowed.unknown else 0.0)
    known = push.failure_probability
    if body.allowed.unknown:  # once it has been explored, what is left is the risk of a first push
        known = costs.prior_failures / (1.0 + costs.prior_failures + costs.prior_successes)
    tasks.append(
        Task(
            "push",
            cost_s,
            driven_m,
            path_m,
            body.obj.id,
            _pair(contact_m),
            _pair(goal_m),
            _pair(moved_m),
            known,
        )
    )
    return tasks


def _pair(point: Float[np.ndarray, "2"]) -> tuple[float, float]:
    return float(point[0]), float(point[1])


def _notes(domain: SearchDomain) -> tuple[str, ...]:
    notes = [f"{obj.id} is not pushed: {domain.why_immovable[obj.id]}" for obj in domain.immovable]
    notes += [f"{body.obj.id} has no stable contact" for body in domain.bodies if not body.contacts]
    return tuple(notes)
