"""Plans under side conditions, and decisions about unexplored objects (Alt 2016, Sec. 4.2.1)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from ...core.objects import HapticTag
from ...io.maps.occupancy_map import OccupancyMap
from ..problem.path_plan import Plan
from ..problem.planning_problem import PlanningProblem, PushMode
from ..problem.push_costs import PushCosts
from .exploration.tour_planner import exploration_tour
from .off_centre_push import via_off_centre
from .planner import plan_in_domain
from .search.domain_builder import build_search_domain
from .search.push_search import load_kernels
from .search.push_states import Deadline, SearchLimits
from .search.search_domain import SearchDomain
from .sideward_plan import via_sideward

#: Weight of reliability in the most reliable plan [s per -log(1 - p)].
RELIABLE_RISK_S = 600.0
#: Fraction of the budget for a plan of straight pushes without exploration, if there are objects for other plans.
KNOWN_FRACTION = 0.5
#: Maximum number of cells of a map that is divided in two along each axis, and of the result of a division in four.
MAX_HALVED = 1_000_000
#: Fraction of the time after a first search that finer cells leave for a search on the given ones that does not end early.
FINER_LEFT = 0.4
#: Time limit of the tour for the most information [s]: in effect none on one floor.
LEARN_S = 3600.0


def make_plan(
    problem: PlanningProblem, costs: PushCosts | None = None, limits: SearchLimits | None = None
) -> Plan:
    """The plan of minimum expected time.

    An unexplored object is explored first; the plan through it is
    chosen if its expected time (movable with a prior probability, the best
    detour otherwise) is below that of the best plan without exploration.

    Parameters
    ----------
    problem
        Map, objects, robot, start and goal.
    costs, limits
        Cost parameters that the dissertation leaves open; limits of the search, which may receive its first plan.

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
    limits = limits or SearchLimits()
    load_kernels()
    deadline = Deadline.after(limits.budget_s)
    plan, domain = _with_finer_cells(build_search_domain(problem, costs), _until(deadline, limits), _cheapest)
    return _with_proof(domain, plan, _until(deadline, limits))


def _with_finer_cells(
    domain: SearchDomain, limits: SearchLimits, plan_on: Callable[[SearchDomain, SearchLimits], Plan]
) -> tuple[Plan, SearchDomain]:
    """A plan, and the domain it was last searched in: one with divided cells, as often as the budget allows.

    The obstacles are the same, but a robot may drive where it does not fit on the centres of larger cells. Cells are
    divided while there is neither a plan within the allowed gap nor a proof.
    """
    deadline = Deadline.after(limits.budget_s)
    fine, plan = domain, plan_on(_impatient(domain), limits)
    soon = deadline.earlier(FINER_LEFT * deadline.left_s)
    while fine.occupied.size <= MAX_HALVED and not (plan.proved or soon.passed):
        if plan.reachable and not (plan.narrow and limits.gap < plan.gap):
            break
        # Smaller cells than the nodes of the lattice add little to the time: two divisions at once down to there.
        parts = 4 if fine.block == 1 and 16 * fine.occupied.size <= MAX_HALVED else 2
        cells = fine.occupied.repeat(parts, axis=0).repeat(parts, axis=1)
        finer = OccupancyMap(cells, fine.map.resolution_m / parts, fine.map.origin)
        fine = build_search_domain(replace(domain.problem, map=finer), domain.costs)
        receive = None if plan.reachable else limits.found
        again = plan_on(replace(_impatient(fine), divided=True), replace(_until(soon, limits), found=receive))
        plan = _better(plan, again, stated=domain.places is None)
    if not (plan.reachable or plan.proved or deadline.passed) and domain.occupied.size <= MAX_HALVED:
        plan = _better(plan, plan_on(domain, _until(deadline, limits)), stated=True)
    return plan, fine


def _impatient(domain: SearchDomain) -> SearchDomain:
    """A domain in which a search ends where finer cells decide, if there can be any."""
    return replace(domain, patient=domain.occupied.size > MAX_HALVED)


def _better(known: Plan, other: Plan, *, stated: bool) -> Plan:
    """The cheaper of two plans of a problem, with the tighter of their bounds; without a plan, a proof.

    Unless their costs are all ``stated``, the one that is nearer to its bound.
    """
    if not (known.reachable and other.reachable):
        return other if other.reachable or (other.proved and not known.reachable) else known
    if not stated:
        return min((known, other), key=lambda plan: plan.gap)
    best = min((known, other), key=lambda plan: plan.cost_s if plan.expected_s is None else plan.expected_s)
    bound_s = max(plan.cost_s / (1.0 + plan.gap) for plan in (known, other))
    return replace(best, gap=max(best.cost_s / bound_s - 1.0, 0.0) if bound_s > 0.0 else math.inf)


def _cheapest(domain: SearchDomain, limits: SearchLimits, done: frozenset[str] = frozenset()) -> Plan:
    """The cheapest plan; objects that are ``done`` are not pushed sideward again."""
    deadline = Deadline.after(limits.budget_s)
    unknown = any(body.allowed.unknown for body in domain.bodies)
    turned = {obj.id for obj in domain.problem.objects if obj.push is PushMode.OFF_CENTRE} - done
    first = replace(limits, budget_s=limits.budget_s * (KNOWN_FRACTION if unknown or turned else 1.0))
    limits = replace(limits, found=None)  # the others are searches for parts of plans

    def planned(after: PlanningProblem, done: frozenset[str]) -> Plan:
        return _cheapest(build_search_domain(after, domain.costs), _until(deadline, limits), done)

    safe_plan = _planned(domain, first, unknown=False)
    for index, body in enumerate(domain.bodies):
        id = body.obj.id
        if body.obj.push is not PushMode.SIDEWARD or body.allowed.unknown or id in done or deadline.passed:
            continue
        plan = via_sideward(domain, index, partial(planned, done=done | {id}), safe_plan.cost_s, deadline)
        safe_plan = min(safe_plan, plan, key=lambda one: one.cost_s)
    if turned and not (safe_plan.reachable or safe_plan.narrow or deadline.passed):

        def after_turn(after: PlanningProblem, id: str) -> Plan:
            # An object that was turned once is pushed straight from then on; until one is chosen, so are all.
            return planned(after, done | ({id} if id else turned))

        plan = via_off_centre(domain.problem, after_turn, turned, deadline)
        refused = replace(safe_plan, notes=(*safe_plan.notes, plan.reason))
        safe_plan = plan if plan.reachable else refused
    if not unknown:
        return safe_plan
    risky_plan = _planned(domain, _until(deadline, limits), unknown=True)
    explored = next((i for i, task in enumerate(risky_plan.tasks) if task.kind == "explore"), None)
    if not risky_plan.reachable or explored is None:
        return safe_plan if safe_plan.reachable else risky_plan
    expected_s = _expected(domain, risky_plan, explored, _until(deadline, limits))
    if safe_plan.reachable and safe_plan.cost_s <= expected_s:
        return safe_plan
    return replace(risky_plan, expected_s=expected_s)


def _with_proof(domain: SearchDomain, plan: Plan, limits: SearchLimits) -> Plan:
    """A plan, or none: proofs cover straight and oblique pushes, so that one holds only without the objects pushed otherwise."""
    straight = tuple(body for body in domain.bodies if body.obj.push is PushMode.DIRECT)
    if not plan.proved or len(straight) == len(domain.bodies):
        return plan
    return replace(plan, proved=_planned(replace(domain, bodies=straight), limits, unknown=True).proved)


def _until(deadline: Deadline, limits: SearchLimits) -> SearchLimits:
    """Limits for the remainder of a budget, however small."""
    return replace(limits, budget_s=min(max(deadline.left_s, 1e-9), limits.budget_s))


def without_pushing(problem: PlanningProblem, limits: SearchLimits | None = None) -> Plan:
    """The cheapest plan without pushing: the detour.

    Parameters
    ----------
    problem
        Map, objects, robot, start and goal.
    limits
        Limits of the search.
    """
    return _with_finer_cells(build_search_domain(problem), limits or SearchLimits(), _detour)[0]


_detour = partial(plan_in_domain, active=(), name="no pushing")


def alternatives(
    problem: PlanningProblem, costs: PushCosts | None = None, limits: SearchLimits | None = None
) -> dict[str, Plan]:
    """Plans under side conditions: cheapest, most reliable, no pushing, most information.

    The last one is the tour of exploration that ends at the goal, if any object is worth touching and can be.

    Parameters
    ----------
    problem
        Map, objects, robot, start and goal.
    costs
        Cost model of the pushes.
    limits
        Limits of the search.

    Returns
    -------
    Plans by name.
    """
    problem.robot.check_disc("alternatives are planned")
    limits, domain = replace(limits or SearchLimits(), found=None), build_search_domain(problem, costs)
    cautious = replace(domain.costs, risk_s=RELIABLE_RISK_S)
    reliable = _planned(domain, limits, unknown=True, weights=cautious)
    (plan, finer), (free, _) = (
        _with_finer_cells(domain, limits, plan_on) for plan_on in (_cheapest, _detour)
    )
    cheapest = _with_proof(finer, plan, limits)
    tour = exploration_tour(problem, LEARN_S, costs, to_goal=True)
    found = {
        "cheapest": cheapest,
        "most reliable": min(
            (plan for plan in (reliable, cheapest, free) if plan.reachable),
            key=lambda plan: (plan.failure_probability, plan.cost_s),
            default=reliable,
        ),
        "no pushing": free,
        "most information": tour.plan if tour.steps else cheapest,
    }
    return {name: replace(plan, name=name) for name, plan in found.items()}


def _pushed(domain: SearchDomain, *, unknown: bool) -> list[int]:
    """Bodies that are pushed straight: those with that mode, and unknown ones where they are explored."""
    return [
        k
        for k, body in enumerate(domain.bodies)
        if (unknown if body.allowed.unknown else body.obj.push is not PushMode.SIDEWARD)
    ]


def _planned(
    domain: SearchDomain, limits: SearchLimits, *, unknown: bool, weights: PushCosts | None = None
) -> Plan:
    deadline = Deadline.after(limits.budget_s)
    active = _pushed(domain, unknown=unknown)
    found = plan_in_domain(domain, limits, active=active, weights=weights)
    tilted = (push.oblique for k in active for push in domain.bodies[k].with_oblique)
    if found.reachable or found.narrow or not any(tilted):
        return found
    # Oblique pushes rely on friction: they are used only if no other push clears a path. Their proof covers both.
    if not deadline.passed:
        left, among = _until(deadline, limits), replace(domain, patient=True)
        oblique = plan_in_domain(among, left, active=active, oblique=True, weights=weights)
        if oblique.reachable or oblique.proved:
            return oblique
    return replace(
        found, proved=False, reason=found.reason + "; not proved for oblique pushes" * found.proved
    )


def _expected(domain: SearchDomain, risky_plan: Plan, first: int, limits: SearchLimits) -> float:
    """Expected time of a plan with an exploration, with the best path from there if the object does not move."""
    problem, explore = domain.problem, risky_plan.tasks[first]
    before_s = sum(task.cost_s for task in risky_plan.tasks[: first + 1])
    after_s = sum(task.cost_s for task in risky_plan.tasks[first + 1 :])
    retreat_m = next((task.path_m[-1] for task in reversed(risky_plan.tasks[:first]) if task.path_m), None)
    at = problem.start_m if retreat_m is None else np.array(retreat_m)
    refused = replace(
        problem,
        start_m=at,
        start_yaw_rad=None,
        objects=tuple(
            replace(obj, tag=HapticTag(fixed=True)) if obj.id == explore.object else obj
            for obj in problem.objects
        ),
    )
    other = _planned(build_search_domain(refused, domain.costs), limits, unknown=False)
    p = explore.failure_probability
    return before_s + (1.0 - p) * after_s + p * other.cost_s
