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
from collections.abc import Collection, Sequence
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

#: Heuristic weights of the passes for a first plan.
FIRST_WEIGHTS = (1.2, 3.0)
#: Configurations looked at with the first weight, and for the bound of one body alone.
FIRST_EXPANSIONS, ALONE_EXPANSIONS = 150, 60
#: Fractions of the budget after which ends: one body at a time; a first plan without the bodies that touch no
#: bottleneck, by weight; a proof that there is none; a first plan with all bodies.
ALONE_FRACTION, FIRST_FRACTIONS, PROOF_FRACTION, ALL_FRACTIONS = 0.2, (0.35, 0.55), 0.75, (0.85, 1.0)


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
    part = PushHeuristic(domain, goal, costs, needed, oblique=oblique)
    if _impossible(part, cells) and needed != active:
        needed, part = active, PushHeuristic(domain, goal, costs, active, oblique=oblique)
    if reason := _impossible(part, cells):
        return SearchResult(False, exhausted=True, reason=reason)
    still = [k for k in range(len(domain.bodies)) if k not in active]
    alone_s = begin_s + ALONE_FRACTION * limits.budget_s
    if reason := _bound_crossings(part, still, cells, start, limits, alone_s):
        return SearchResult(False, exhausted=True, reason=reason)
    lower = float(part.field(first.shifts)[cells].min()) * domain.block / part.units
    plan, expanded = _first_plan(part, first, limits, begin_s, FIRST_FRACTIONS)
    if plan.found and plan.cost <= (1.0 + limits.gap) * lower:
        return replace(plan, bound=lower, left_out=tuple(sorted(active - needed)))
    heuristic = part
    if needed != active:
        heuristic = PushHeuristic(domain, goal, costs, active, oblique=oblique)
        heuristic.alone |= part.alone
    deadline_s = begin_s + limits.budget_s
    if not plan.found:
        reason = Infeasibility(heuristic, limits, begin_s + PROOF_FRACTION * limits.budget_s).prove(
            first, cells
        )
        if not reason and needed != active:
            plan, more = _first_plan(heuristic, first, limits, begin_s, ALL_FRACTIONS)
            expanded += more
        if not plan.found:
            found = reason or f"no plan among {expanded} configurations, not proved"
            return replace(plan, exhausted=bool(reason), reason=found, expanded=expanded)
    left_out = tuple(sorted(active - needed - {step.body for step in plan.steps}))
    best, bound = plan, lower
    for weight in (FIRST_WEIGHTS[0], 1.0):
        better = PushPass(heuristic, weight, limits, deadline_s).run(
            first, max(limits.expansions - expanded, 1), best.cost * part.units / domain.block + 1.0
        )
        best = better if better.found else best
        expanded += better.expanded
        bound = max(bound, better.bound / weight)
        if best.cost <= (1.0 + limits.gap) * bound:
            break
    return replace(best, bound=min(bound, best.cost), expanded=expanded, left_out=left_out)


def _first_plan(
    heuristic: PushHeuristic,
    first: SearchState,
    limits: SearchLimits,
    begin_s: float,
    fractions: tuple[float, float],
) -> tuple[SearchResult, int]:
    """A plan by weighted A*, the weight small at first; and how many configurations were looked at."""
    plan, expanded = SearchResult(False), 0
    for weight, fraction in zip(FIRST_WEIGHTS, fractions, strict=True):
        deadline_s = begin_s + fraction * limits.budget_s
        # The small weight is for a plan that is found straight away.
        most = FIRST_EXPANSIONS if weight == FIRST_WEIGHTS[0] else limits.expansions
        most = max(min(most, limits.expansions - expanded), 1)
        plan = PushPass(heuristic, weight, limits, deadline_s).run(first, most)
        expanded += plan.expanded
        if plan.found or plan.exhausted:
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


def _impossible(heuristic: PushHeuristic, cells: Int32[np.ndarray, "k"]) -> str:
    """Why no sequence of pushes can solve the problem; empty where one may."""
    if not heuristic.goal_cells.size:
        return "the goal is too near to what cannot be moved"
    if not cells.size:
        return "the robot does not fit where it starts"
    if heuristic.free_field[cells].min() >= heuristic.far:
        return "walls separate start and goal" + (", whatever is pushed" if heuristic.active else "")
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
