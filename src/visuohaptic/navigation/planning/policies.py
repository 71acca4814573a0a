"""Plans under side conditions, and what to do about objects that nobody has touched (Alt 2016, Sec. 4.2.1)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...core.objects import HapticTag
from ..problem.path_plan import Plan
from ..problem.planning_problem import MovableObject, PlanningProblem
from ..problem.push_costs import PushCosts
from .planner import plan_in_domain
from .search.domain_builder import build_search_domain
from .search.push_states import Deadline, SearchLimits
from .search.search_domain import SearchDomain

__all__ = ["alternatives", "make_plan", "without_pushing"]

#: How much reliability is worth to the most reliable plan [s per -log(1 - p)].
RELIABLE_RISK_S = 600.0
#: Fraction of the budget for the search.
SEARCH_FRACTION = 0.9
#: Fraction of the budget for a plan that explores nothing, where objects are unknown.
KNOWN_FRACTION = 0.5
#: Of the unknown objects on the map, so many nearest ones are considered for the most informative plan.
MAX_UNKNOWN = 5


def make_plan(
    problem: PlanningProblem, costs: PushCosts | None = None, limits: SearchLimits | None = None
) -> Plan:
    """The plan of minimum expected time.

    An object that was never touched is explored first; the plan through it is
    taken when its expected time - movable with a prior probability, the best
    detour otherwise - beats the best plan that needs no exploration.

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
    deadline = Deadline.after(limits.budget_s)
    domain = build_search_domain(problem, costs)
    return _cheapest(problem, domain, costs, _until(deadline, limits))


def _cheapest(problem: PlanningProblem, domain: SearchDomain, costs: PushCosts, limits: SearchLimits) -> Plan:
    # What is left is for the drives of the plan.
    limits = replace(limits, budget_s=SEARCH_FRACTION * limits.budget_s)
    deadline = Deadline.after(limits.budget_s)
    unknown = any(body.allowed.unknown for body in domain.bodies)
    first = replace(limits, budget_s=limits.budget_s * (KNOWN_FRACTION if unknown else 1.0))
    safe_plan = _planned(problem, domain, costs, first, unknown=False)
    if not unknown:
        return safe_plan
    risky_plan = _planned(problem, domain, costs, _until(deadline, limits), unknown=True)
    explored = next((i for i, task in enumerate(risky_plan.tasks) if task.kind == "explore"), None)
    if not risky_plan.reachable or explored is None:
        return safe_plan if safe_plan.reachable else risky_plan
    expected_s = _expected(problem, risky_plan, explored, costs, _until(deadline, limits))
    if safe_plan.reachable and safe_plan.cost_s <= expected_s:
        return safe_plan
    return replace(risky_plan, expected_s=expected_s)


def _until(deadline: Deadline, limits: SearchLimits) -> SearchLimits:
    """Limits for what is left of a budget, at least a tenth of it."""
    left_s = max(deadline.left_s, 0.1 * limits.budget_s)
    return replace(limits, budget_s=min(left_s, limits.budget_s))


def without_pushing(problem: PlanningProblem, limits: SearchLimits | None = None) -> Plan:
    """The cheapest plan that leaves every object where it is: the detour.

    Parameters
    ----------
    problem
        Map, objects, robot, start and goal.
    limits
        How long to search.
    """
    return plan_in_domain(problem, build_search_domain(problem), None, limits, active=(), name="no pushing")


def alternatives(
    problem: PlanningProblem, costs: PushCosts | None = None, limits: SearchLimits | None = None
) -> dict[str, Plan]:
    """Plans under side conditions: cheapest, most reliable, no pushing, most information.

    Parameters
    ----------
    problem
        Map, objects, robot, start and goal.
    costs
        What a push costs.
    limits
        How long to search.

    Returns
    -------
    Plans by name.
    """
    costs, limits = costs or PushCosts(), limits or SearchLimits()
    domain = build_search_domain(problem, costs)
    cautious = replace(costs, risk_s=RELIABLE_RISK_S)
    reliable = _planned(problem, domain, cautious, limits, unknown=True, report_costs=costs)
    cheapest = _cheapest(problem, domain, costs, limits)
    free = plan_in_domain(problem, domain, costs, limits, active=(), name="no pushing")
    found = {
        "cheapest": cheapest,
        "most reliable": min(
            (plan for plan in (reliable, cheapest, free) if plan.reachable),
            key=lambda plan: (plan.failure_probability, plan.cost_s),
            default=reliable,
        ),
        "no pushing": free,
        "most information": _most_information(problem, domain, costs, limits, cheapest),
    }
    return {name: replace(plan, name=name) for name, plan in found.items()}


def _planned(
    problem: PlanningProblem,
    domain: SearchDomain,
    costs: PushCosts,
    limits: SearchLimits,
    *,
    unknown: bool,
    report_costs: PushCosts | None = None,
) -> Plan:
    deadline = Deadline.after(limits.budget_s)
    active = [k for k, body in enumerate(domain.bodies) if unknown or not body.allowed.unknown]
    found = plan_in_domain(problem, domain, costs, limits, active=active, report_costs=report_costs)
    if found.reachable or not active:
        return found
    # Oblique pushes hold by friction alone: only where nothing else clears a path.
    left = _until(deadline, limits)
    oblique = plan_in_domain(
        problem, domain, costs, left, active=active, oblique=True, report_costs=report_costs
    )
    if oblique.reachable:
        return oblique
    note = "oblique pushes do not help either" + ("" if oblique.proved else ", as far as was looked")
    return replace(found, notes=(*found.notes, note))


def _expected(
    problem: PlanningProblem, risky_plan: Plan, first: int, costs: PushCosts, limits: SearchLimits
) -> float:
    """Expected time of a plan with an exploration: the best path from there when nothing moves."""
    explore = risky_plan.tasks[first]
    before_s = sum(task.cost_s for task in risky_plan.tasks[: first + 1])
    after_s = sum(task.cost_s for task in risky_plan.tasks[first + 1 :])
    retreat_m = next((task.path_m[-1] for task in reversed(risky_plan.tasks[:first]) if task.path_m), None)
    at = problem.start_m if retreat_m is None else np.array(retreat_m)
    refused = replace(
        problem,
        start_m=at,
        objects=tuple(
            replace(obj, tag=HapticTag(fixed=True)) if obj.id == explore.object else obj
            for obj in problem.objects
        ),
    )
    other = _planned(refused, build_search_domain(refused, costs), costs, limits, unknown=False)
    p = explore.failure_probability
    return before_s + (1.0 - p) * after_s + p * other.cost_s


def _most_information(
    problem: PlanningProblem,
    domain: SearchDomain,
    costs: PushCosts,
    limits: SearchLimits,
    cheapest: Plan,
) -> Plan:
    """The plan that learns most per second: of what it touches, the entropy of "it moves"."""
    middle = 0.5 * (problem.start_m + problem.goal_m)
    uncertain = sorted(
        (body.obj for body in domain.bodies if _entropy(body.obj, costs) > 0.3),
        key=lambda obj: float(np.hypot(*(obj.centre_m - middle))),
    )
    best, best_rate = cheapest, _rate(problem, cheapest, costs)
    for obj in uncertain[:MAX_UNKNOWN]:
        from .exploration import via_exploration

        plan = via_exploration(problem, obj, costs, limits)
        rate = _rate(problem, plan, costs)
        if rate > best_rate:
            best, best_rate = plan, rate
    return best


def _entropy(obj: MovableObject, costs: PushCosts) -> float:
    """Bits that touching an object once yields: of its probability to move."""
    if obj.tag is None:
        p = costs.unknown_movable
    else:
        tries = max(obj.tag.explored, obj.tag.failed)
        p = (obj.tag.failed + costs.prior_failures) / (tries + costs.prior_failures + costs.prior_successes)
    return float(-(p * np.log2(p) + (1 - p) * np.log2(1 - p))) if 0 < p < 1 else 0.0


def _rate(problem: PlanningProblem, plan: Plan, costs: PushCosts) -> float:
    if not plan.reachable:
        return -1.0
    touched = {task.object for task in plan.tasks if task.kind in {"push", "explore"}}
    bits = sum(_entropy(obj, costs) for obj in problem.objects if obj.id in touched)
    return bits / max(plan.cost_s, 1e-9)
