"""Navigation among movable obstacles (NAMO) by anytime A* over pushes: which object, from where, how far, in which order.

A state is where every body stands and where the robot is. A successor drives to a stable contact and pushes
straight; the last step drives to the goal. What it costs to drive is computed once per state on the lattice of the
domain, whose size does not depend on the cells of the map. A contact waits in the queue with a lower bound and is
worked out only when it is the best: how far the push is free of collisions, and at which lengths it joins pieces of
free space. The lengths tried are those, a few longer ones, and a ladder in metres.

A pass of weighted A* finds a first plan, without the bodies that touch no bottleneck; a pass with the admissible
heuristic of :mod:`~visuohaptic.navigation.planning.search.push_heuristic` and all bodies improves it until it is
proved cheapest or the budget ends, and gives the bound. That there is no plan is proved by
:mod:`~visuohaptic.navigation.planning.search.infeasibility`.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int32

from ....core.objects import HapticTag
from ....io.maps.occupancy_map import FREE, OCCUPIED, OccupancyMap
from ...problem.planning_problem import MovableObject, PlanningProblem, RobotModel
from ...problem.push_costs import PushCosts
from .infeasibility import Infeasibility
from .push_heuristic import PushHeuristic
from .push_pass import PushPass
from .push_states import (
    SearchLimits,
    SearchResult,
    SearchState,
    seed_cells,
)
from .search_domain import SearchDomain, build_search_domain, grid_from_world

__all__ = ["search_pushes"]

#: Heuristic weights of the passes for a first plan, and of a last one where nothing was found.
WEIGHTS, LAST_WEIGHT = (1.2, 3.0), 10.0
#: Configurations looked at with the first weight, and for the bound of one body alone.
FIRST_EXPANSIONS, ALONE_EXPANSIONS = 150, 60
#: Fractions of the budget after which ends: one body at a time; a first plan without the bodies that touch no
#: bottleneck, by weight; a proof that there is none; a first plan with all bodies.
ALONE, SOON, PROOF, LATE = 0.2, (0.35, 0.55), 0.75, (0.85, 0.95, 1.0)


def search_pushes(
    domain: SearchDomain,
    start: Float[np.ndarray, "2"],
    goal: Float[np.ndarray, "2"],
    costs: PushCosts | None = None,
    limits: SearchLimits | None = None,
    *,
    active: Collection[int] | None = None,
    oblique: bool = False,
) -> SearchResult:
    """The cheapest sequence of pushes that lets the robot drive from start to goal.

    Parameters
    ----------
    domain
        Static map and bodies.
    start, goal
        Grid coordinates [cells].
    costs
        What a push costs.
    limits
        How long to search.
    active
        Indices of the bodies that may be pushed; all of them by default.
    oblique
        Whether pushes may be oblique to a face, which friction has to hold.

    Returns
    -------
    The pushes, or the reason why there are none and whether that is proved (``exhausted``).
    """
    _load_kernels()
    chosen = frozenset(range(len(domain.bodies)) if active is None else active)
    return _search(
        domain, start, goal, costs or PushCosts(), limits or SearchLimits(), chosen, oblique=oblique
    )


@lru_cache(maxsize=1)
def _load_kernels() -> None:
    """Search a small floor once, so that no budget is spent on loading compiled code."""
    cells = np.zeros((12, 24), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = cells[:, 12] = OCCUPIED
    cells[4:8, 12] = FREE
    outline_m = 0.1 * np.array([[11.0, 4.5], [14.0, 4.5], [14.0, 7.5], [11.0, 7.5]])
    ends_m = np.array([0.45, 0.6]), np.array([2.0, 0.6])
    robot, box = RobotModel(0.15), MovableObject("box", outline_m, HapticTag())
    domain = build_search_domain(PlanningProblem(OccupancyMap(cells, 0.1), robot, *ends_m, (box,)), block=2)
    start, goal = (grid_from_world(domain.map, end_m) for end_m in ends_m)
    _search(domain, start, goal, PushCosts(), SearchLimits(budget_s=600.0), frozenset((0,)), oblique=False)


def _search(
    domain: SearchDomain,
    start: Float[np.ndarray, "2"],
    goal: Float[np.ndarray, "2"],
    costs: PushCosts,
    limits: SearchLimits,
    active: frozenset[int],
    *,
    oblique: bool,
) -> SearchResult:
    begin_s = time.monotonic()
    from ._travel_kernels import UNITS

    first = SearchState(0.0, start, np.zeros((len(domain.bodies), 2)))
    cells, _ = seed_cells(
        domain.lattice_with(first.shifts),
        start,
        domain.radius,
        domain.slow,
        UNITS,
        reach=2,
        block=domain.block,
    )
    needed = _bottlenecks(domain, goal, active)
    left_out = active - needed
    part = PushHeuristic(domain, goal, costs, needed, left_out=left_out, oblique=oblique)
    if reason := _impossible(part, cells, pushes=bool(active)):
        return SearchResult(False, exhausted=True, reason=reason)
    still = [k for k in range(len(domain.bodies)) if k not in active]
    if reason := _bound_crossings(part, still, cells, start, limits, begin_s + ALONE * limits.budget_s):
        return SearchResult(False, exhausted=True, reason=reason)
    through: dict[int, float] = {}
    crossed = part.crossed(cells)
    passes = [(WEIGHTS[0], SOON[0], crossed), *((w, f, None) for w, f in zip(WEIGHTS, SOON, strict=True))]
    plan, expanded = _first_plan(
        part, first, limits, begin_s, passes[1:] if crossed == part.active else passes
    )
    heuristic = part
    units = part.units / domain.block
    if not plan.found:
        reason = Infeasibility(part, limits, begin_s + PROOF * limits.budget_s).prove(first, cells)
        if reason:
            return SearchResult(False, exhausted=True, reason=reason, expanded=expanded)
        worth = active
    else:
        # A plan that pushes one of the others costs more than it could save.
        through = {k: part.through(cells, k) / units for k in active - {step.body for step in plan.steps}}
        worth = active - {k for k, cost in through.items() if cost * (1.0 + limits.gap) >= plan.cost}
    if worth != needed:
        heuristic = PushHeuristic(domain, goal, costs, worth, left_out=active - worth, oblique=oblique)
        heuristic.alone |= {k: bound for k, bound in part.alone.items() if k in worth}
    if not plan.found:
        weights = (*WEIGHTS, LAST_WEIGHT) if left_out else (LAST_WEIGHT,)
        passes = [(weight, fraction, None) for weight, fraction in zip(weights, LATE, strict=False)]
        plan, more = _first_plan(heuristic, first, limits, begin_s, passes)
        expanded += more
        if not plan.found:
            reason = f"no plan among {expanded} configurations, not proved"
            return replace(plan, exhausted=False, reason=reason, expanded=expanded)
    lower = float(heuristic.field(first.shifts)[cells].min()) / units
    weights = (1.0,) if expanded <= FIRST_EXPANSIONS else (WEIGHTS[0], 1.0)
    plan = replace(plan, bound=lower)
    best, expanded = _improved(heuristic, first, plan, limits, begin_s, expanded, weights)
    bound = min([best.bound, *(through[k] for k in active - worth)])
    return replace(best, bound=bound, expanded=expanded, left_out=tuple(sorted(left_out - worth)))


def _improved(
    heuristic: PushHeuristic,
    first: SearchState,
    plan: SearchResult,
    limits: SearchLimits,
    begin_s: float,
    expanded: int,
    weights: Iterable[float],
) -> tuple[SearchResult, int]:
    """The plan, or a better one, with a bound that is as near as the budget allows."""
    units = heuristic.units / heuristic.domain.block
    for weight in weights:
        if plan.cost <= (1.0 + limits.gap) * plan.bound:
            break
        better = PushPass(heuristic, weight, limits, begin_s + limits.budget_s).run(
            first,
            max(limits.expansions - expanded, 1),
            plan.cost * units,
            limits.gap if weight == 1.0 else 0.0,
        )
        expanded += better.expanded
        bound = max(plan.bound, better.bound / weight)
        plan = replace(better if better.found else plan, bound=bound)
    return replace(plan, bound=min(plan.bound, plan.cost)), expanded


def _first_plan(
    heuristic: PushHeuristic,
    first: SearchState,
    limits: SearchLimits,
    begin_s: float,
    passes: Iterable[tuple[float, float, Collection[int] | None]],
) -> tuple[SearchResult, int]:
    """A plan by weighted A*, by weight, fraction of the budget and bodies that are pushed; and how many configurations were looked at."""
    plan, expanded = SearchResult(False), 0
    for weight, fraction, bodies in passes:
        if bodies is None and plan.exhausted:
            break
        deadline_s = begin_s + fraction * limits.budget_s
        # The smallest weight is for a plan that is found straight away.
        most = FIRST_EXPANSIONS if weight == WEIGHTS[0] else limits.expansions
        most = max(min(most, limits.expansions - expanded), 1)
        plan = PushPass(heuristic, weight, limits, deadline_s, bodies).run(first, most)
        plan = replace(plan, exhausted=plan.exhausted and bodies is None)
        expanded += plan.expanded
        if plan.found:
            break
    return plan, expanded


def _bound_crossings(
    heuristic: PushHeuristic,
    still: Sequence[int],
    cells: Int32[np.ndarray, "k"],
    start: Float[np.ndarray, "2"],
    limits: SearchLimits,
    deadline_s: float,
) -> str:
    """Raise the bounds of bodies that alone separate start and goal; why one of them can't be passed, if so."""
    domain = heuristic.domain
    lattice = domain.lowered(domain.lattice, np.zeros((len(domain.bodies), 2)), still, domain.block)
    first = SearchState(0.0, start, np.zeros((1, 2)))
    for index in heuristic.separating(cells):
        alone = replace(domain, bodies=(domain.bodies[index],), lattice=lattice, patches={}, still={})
        part = PushHeuristic(alone, heuristic.goal, heuristic.costs, (0,), oblique=heuristic.oblique)
        found = PushPass(part, 1.0, limits, deadline_s).run(first, min(ALONE_EXPANSIONS, limits.expansions))
        if np.isfinite(found.bound):
            more = found.bound * heuristic.units / domain.block - float(part.free_field[cells].min())
            heuristic.alone[index] = max(heuristic.min_push[index], more)
        elif reason := Infeasibility(part, limits, deadline_s).prove(first, cells):
            return reason
    return ""


def _impossible(heuristic: PushHeuristic, cells: Int32[np.ndarray, "k"], *, pushes: bool) -> str:
    """Why no sequence of pushes can solve the problem; empty where one may."""
    if not heuristic.goal_cells.size:
        return "the goal is too near to what cannot be moved"
    if not cells.size:
        return "the robot does not fit where it starts"
    if heuristic.free_field[cells].min() >= heuristic.far:
        return "walls separate start and goal" + (", whatever is pushed" if pushes else "")
    return ""


def _bottlenecks(
    domain: SearchDomain, goal: Float[np.ndarray, "2"], active: Collection[int]
) -> frozenset[int]:
    """Bodies beside which the free space falls into pieces, or that cover the goal."""
    from ._push_search_kernels import opening_lengths

    shifts = np.zeros((len(domain.bodies), 2))
    found = set()
    for index in active:
        body = domain.bodies[index]
        without = domain.lattice_with(shifts, index)
        # Far enough along an axis, every block around the body is free of it: how many pieces there are is seen.
        far = float(np.ptp(body.outline, axis=0).max()) + 2.0 * domain.radius + 4.0 * domain.block
        pieces = opening_lengths(
            without, body.outline, 1.0, 0.0, domain.radius, domain.block, 2.0 * far, *body.centre, *goal
        )
        if len(pieces):
            found.add(index)
    return frozenset(found)
