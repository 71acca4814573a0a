"""Plans under side conditions, and what to do about objects that nobody has touched (Alt 2016, Sec. 4.2.1)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...core.objects import HapticTag
from ..problem.path_plan import Plan
from ..problem.planning_problem import MovableObject, PlanningProblem
from ..problem.push_costs import PushCosts
from .planner import plan_world
from .push_states import SearchLimits
from .search_domain import push_world

__all__ = ["alternatives", "make_plan", "without_pushing"]

#: How much reliability is worth to the most reliable plan [s per -log(1 - p)].
RELIABLE_RISK_S = 600.0
#: Slanting pushes are searched with this share of the budget: they are a last resort.
SLANTING_SHARE = 0.25
#: ... of which little goes to the cheapest one: that there is one at all is what counts.
SLANTING_FIRST, SLANTING_GREED = 60, (4.0,)
#: Of the unknown objects on the map, so many nearest ones are considered for the most informative plan.
MAX_UNKNOWN = 5


def make_plan(
    problem: PlanningProblem, costs: PushCosts | None = None, limits: SearchLimits | None = None
) -> Plan:
    """The plan of least expected time.

    An object that was never touched is explored first; the plan through it is
    taken when its expected time - movable with a prior probability, the best
    way round otherwise - beats the best plan that needs no exploration.

    Parameters
    ----------
    problem
        Map, objects, robot, start and goal.
    costs, limits
        What the text leaves open; how long to search.

    Examples
    --------
    >>> import numpy as np
    >>> from visuohaptic.io.maps import OccupancyMap
    >>> from visuohaptic.navigation.problem import RobotModel
    >>> walls = np.zeros((30, 40), dtype=bool)
    >>> walls[[0, -1]] = walls[:, [0, -1]] = True
    >>> plan = make_plan(
    ...     PlanningProblem(OccupancyMap(walls, 0.05), RobotModel(0.15), np.array([0.4, 0.7]), np.array([1.6, 0.7]))
    ... )
    >>> [task.kind for task in plan.tasks], round(plan.length_m, 2)
    (['navigate'], 1.2)
    """
    costs, limits = costs or PushCosts(), limits or SearchLimits()
    unknown = [item for item in problem.objects if item.tag is None]
    sure = _planned(problem, costs, limits, unknown=False)
    if sure.pushes:
        # The search compares estimates on the grid; what is driven is pulled taut.
        around = without_pushing(problem, limits)
        if around.reachable and around.cost_s < sure.cost_s:
            sure = replace(around, name=sure.name, notes=sure.notes)
    if not unknown:
        return sure
    risky_plan = _planned(problem, costs, limits, unknown=True)
    first = next((i for i, task in enumerate(risky_plan.tasks) if task.kind == "explore"), None)
    if not risky_plan.reachable or first is None:
        return sure if sure.reachable else risky_plan
    expected_s = _expected(problem, risky_plan, first, costs, limits)
    if sure.reachable and sure.cost_s <= expected_s:
        return sure
    return replace(risky_plan, expected_s=expected_s)


def without_pushing(problem: PlanningProblem, limits: SearchLimits | None = None) -> Plan:
    """The cheapest plan that leaves everything where it is."""
    return plan_world(problem, push_world(problem, pushes=False), None, limits, name="no pushing")


def alternatives(
    problem: PlanningProblem, costs: PushCosts | None = None, limits: SearchLimits | None = None
) -> dict[str, Plan]:
    """Plans under side conditions: cheapest, most reliable, no pushing, most information."""
    costs, limits = costs or PushCosts(), limits or SearchLimits()
    reliable = _planned(problem, replace(costs, risk_s=RELIABLE_RISK_S), limits, unknown=True, told=costs)
    cheapest = make_plan(problem, costs, limits)
    free = without_pushing(problem, limits)
    found = {
        "cheapest": cheapest,
        "most reliable": min(
            (plan for plan in (reliable, cheapest, free) if plan.reachable),
            key=lambda plan: (plan.failure_probability, plan.cost_s),
            default=reliable,
        ),
        "no pushing": free,
        "most information": _most_information(problem, costs, limits, cheapest),
    }
    return {name: replace(plan, name=name) for name, plan in found.items()}


def _planned(
    problem: PlanningProblem,
    costs: PushCosts,
    limits: SearchLimits,
    *,
    unknown: bool,
    told: PushCosts | None = None,
) -> Plan:
    world = push_world(problem, costs, unknown=unknown)
    found = plan_world(problem, world, costs, limits, told=told)
    if found.reachable or not world.bodies:
        return found
    # Slanting pushes hold by friction alone: only where nothing else opens a way.
    world = push_world(problem, costs, unknown=unknown, oblique=True)
    less = replace(
        limits,
        expansions=max(1, int(limits.expansions * SLANTING_SHARE)),
        first_expansions=min(limits.first_expansions, SLANTING_FIRST),
        heuristic_weight=SLANTING_GREED,
    )
    slanting = plan_world(problem, world, costs, less, told=told)
    return slanting if slanting.reachable or not slanting.proved else found


def _expected(
    problem: PlanningProblem, risky_plan: Plan, first: int, costs: PushCosts, limits: SearchLimits
) -> float:
    """Expected time of a plan with an exploration: the best way from there when nothing moves."""
    explore = risky_plan.tasks[first]
    before_s = sum(task.cost_s for task in risky_plan.tasks[: first + 1])
    after_s = sum(task.cost_s for task in risky_plan.tasks[first + 1 :])
    stand_m = next((task.path_m[-1] for task in reversed(risky_plan.tasks[:first]) if task.path_m), None)
    at = problem.start_m if stand_m is None else np.array(stand_m)
    refused = replace(
        problem,
        start_m=at,
        objects=tuple(
            replace(item, tag=HapticTag(fixed=True)) if item.id == explore.object else item
            for item in problem.objects
        ),
    )
    other = _planned(refused, costs, limits, unknown=False)
    p = explore.failure_probability
    return before_s + (1.0 - p) * after_s + p * other.cost_s


def _most_information(
    problem: PlanningProblem, costs: PushCosts, limits: SearchLimits, cheapest: Plan
) -> Plan:
    """The plan that learns most per second: of what it touches, the entropy of "it moves"."""
    world = push_world(problem, costs)
    middle = 0.5 * (problem.start_m + problem.goal_m)
    doubtful = sorted(
        (body.item for body in world.bodies if _entropy(body.item, costs) > 0.3),
        key=lambda item: float(np.hypot(*(item.centre_m - middle))),
    )
    best, best_rate = cheapest, _rate(problem, cheapest, costs)
    for item in doubtful[:MAX_UNKNOWN]:
        from .exploration import via_exploration

        plan = via_exploration(problem, item, costs, limits)
        rate = _rate(problem, plan, costs)
        if rate > best_rate:
            best, best_rate = plan, rate
    return best


def _entropy(item: MovableObject, costs: PushCosts) -> float:
    """Bits that touching an object once yields: of its probability to move."""
    if item.tag is None:
        p = costs.unknown_movable
    else:
        tries = max(item.tag.explored, item.tag.failed)
        p = (item.tag.failed + costs.prior_failures) / (tries + costs.prior_failures + costs.prior_successes)
    return float(-(p * np.log2(p) + (1 - p) * np.log2(1 - p))) if 0 < p < 1 else 0.0


def _rate(problem: PlanningProblem, plan: Plan, costs: PushCosts) -> float:
    if not plan.reachable:
        return -1.0
    touched = {task.object for task in plan.tasks if task.kind in {"push", "explore"}}
    bits = sum(_entropy(item, costs) for item in problem.objects if item.id in touched)
    return bits / max(plan.cost_s, 1e-9)
