"""Navigation among movable obstacles (NAMO) by A* over pushes: which object, from where, how far, in which order.

A state is where every body stands and where the robot is. A successor drives to a
stable contact and pushes straight by a whole number of cells; the last step
drives to the goal. The heuristic is the admissible lower bound of
:mod:`~visuohaptic.navigation.planning.search.push_heuristic`, so that the first solution
taken from the queue is the cheapest of the model. A push that frees no cell
beside the goal's component needs another one after it, and is charged for that
at once.

A pass of weighted A* comes first: it prefers pushes that open anything the robot
could not reach, so that passages in series cost one after the other and not all
combinations. What it finds bounds the passes after it.

The next pass takes pushes that open nothing in lengths of 1 to 6, 8, 12 ...
cells only; where it finds nothing in its budget, nor had the first one, others
take all lengths and trade cost for speed with a heuristic weight above 1.

Completeness: of all sequences of straight pushes through the centre, from the
contacts of :func:`~visuohaptic.navigation.pushing.contact_candidates.push_contacts`, by
whole cells, with orientations kept, a solution is found if one exists and the
budget of expansions suffices. The states are finitely many; a queue that runs
empty proves that there is none.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int32

from ...problem.push_costs import PushCosts
from .push_heuristic import PushHeuristic
from .push_states import (
    SearchLimits,
    SearchPass,
    SearchResult,
    SearchState,
    SeenFields,
    Successor,
    push_sequence,
    seed_cells,
)
from .push_successors import SuccessorGenerator, generate_state
from .search_domain import SearchDomain

__all__ = ["search_pushes"]

#: Heuristic weight of the pass that opens one passage after the other.
OPENING_WEIGHT = 5.0


@dataclass(slots=True)
class _Queue:
    """Open states by their estimated cost; what cannot beat the best plan known is refused."""

    best: float  #: cost of the best plan known [units]
    entries: list[tuple[float, int, SearchState | Successor, bool]] = field(default_factory=list)
    pushed: int = 0  #: breaks ties: first in, first out

    def push(self, estimate: float, state: SearchState | Successor) -> None:
        if estimate < self.best:
            self._add(estimate, state, False)

    def finish(self, cost: float, state: SearchState) -> None:
        """Add a plan that ends by driving from a state to the goal."""
        self.best = cost
        self._add(cost, state, True)

    def _add(self, estimate: float, state: SearchState | Successor, arrived: bool) -> None:
        self.pushed += 1
        heapq.heappush(self.entries, (estimate, self.pushed, state, arrived))


class _Search:
    """What all passes from one start have in common."""

    def __init__(
        self,
        domain: SearchDomain,
        start: Float[np.ndarray, "2"],
        heuristic: PushHeuristic,
        limits: SearchLimits,
    ) -> None:
        self.domain, self.heuristic, self.limits = domain, heuristic, limits
        self.first = SearchState(0.0, start, np.zeros((len(domain.bodies), 2)), 0)
        self.cells: Int32[np.ndarray, "k"] = seed_cells(
            domain.clearance_with(self.first.shifts),
            start,
            domain.radius,
            domain.slow,
            heuristic.units,
            reach=2,
        )[0]
        if self.cells.size and heuristic.goal_cells.size:
            heuristic.bound_crossings(self.cells)

    def impossible(self) -> str:
        """Why no sequence of pushes can solve the problem; empty where one may."""
        heuristic = self.heuristic
        if not heuristic.goal_cells.size:
            return "the goal is too near to what cannot be moved"
        if not self.cells.size:
            return "the robot does not fit where it starts"
        if heuristic.field(0)[self.cells].min() >= heuristic.far:
            return "walls separate start and goal" + (", whatever is pushed" if self.domain.bodies else "")
        return ""

    def run(self, settings: SearchPass, expansions: int, known: float) -> SearchResult:
        """Search until the cheapest plan is taken from the queue, it runs empty, or the budget is spent."""
        units, size = self.heuristic.units, self.domain.clearance.size
        generator = SuccessorGenerator(self.heuristic, settings)
        seen = SeenFields(self.limits.memory_cells)
        queue = _Queue(known, [(0.0, 0, self.first, False)])
        expanded, cut = 0, False
        while queue.entries:
            bound, _, taken, arrived = heapq.heappop(queue.entries)
            state = generate_state(self.heuristic, taken) if isinstance(taken, Successor) else taken
            if arrived:
                return SearchResult(True, push_sequence(state), bound / units, expanded, exhausted=not cut)
            if (estimate := self._refined(state, settings)) is not None:
                queue.push(estimate, state)
                continue
            if expanded >= expansions or expanded * size > self.limits.work_cells:
                return SearchResult(
                    False, expanded=expanded, reason=f"no plan among {expanded} configurations, not proved"
                )
            expanded += 1
            finished, successors = generator.expand(state, queue.best, seen)
            if finished is not None and finished < queue.best:
                if settings.opening_first and state.depth == 0:
                    return SearchResult(True, (), finished / units, expanded)
                queue.finish(finished, state)
            if state.depth >= self.limits.pushes:
                cut = cut or bool(successors)
                continue
            for estimate, successor in successors:
                queue.push(estimate, successor)
        reason = "no plan with so few pushes" if cut else "no sequence of straight pushes clears a path"
        return SearchResult(False, expanded=expanded, exhausted=not cut, reason=reason)

    def _refined(self, state: SearchState, settings: SearchPass) -> float | None:
        """A closer estimate of a state's whole cost [units]; none where it can be expanded now."""
        if state.refined:
            return None
        state.refined = True
        if not settings.opening_first:
            return state.spent + self.heuristic.after_push(state) * settings.heuristic_weight
        if self._opened(state):
            return None
        assert state.step is not None
        again = max(self.heuristic.crossing[state.step.body], self.heuristic.min_push[state.step.body])
        return state.spent + (state.left + again) * settings.heuristic_weight

    def _opened(self, state: SearchState) -> bool:
        """Whether the last push lets the robot reach anything that it could not reach before."""
        from ._travel_kernels import flood

        domain = self.domain
        clearance = domain.clearance_with(state.shifts)
        near, _ = seed_cells(clearance, state.robot, domain.radius, domain.slow, self.heuristic.units)
        if not near.size or state.beyond is None:
            return False
        return bool((flood(clearance, domain.radius, near) & state.beyond).any())


def search_pushes(
    domain: SearchDomain,
    start: Float[np.ndarray, "2"],
    goal: Float[np.ndarray, "2"],
    costs: PushCosts | None = None,
    limits: SearchLimits | None = None,
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

    Returns
    -------
    The pushes, or the reason why there are none and whether that is certain (``exhausted``).
    """
    costs, limits = costs or PushCosts(), limits or SearchLimits()
    search = _Search(domain, start, PushHeuristic(domain, goal, costs), limits)
    if reason := search.impossible():
        return SearchResult(False, exhausted=True, reason=reason)
    opening, known = SearchResult(False), float("inf")
    if domain.bodies and limits.opening_expansions:
        opening = search.run(
            SearchPass(OPENING_WEIGHT, opening_first=True),
            min(limits.opening_expansions, limits.expansions),
            known,
        )
        if opening.found:
            known = opening.cost * search.heuristic.units + 1.0
    found = search.run(SearchPass(all_lengths=False), min(limits.first_expansions, limits.expansions), known)
    expanded = found.expanded + opening.expanded
    if found.found or not domain.bodies:
        return replace(found, expanded=expanded)
    if opening.found:
        # Nothing cheaper in the budget, or nothing cheaper at all.
        return replace(opening, expanded=expanded, exhausted=found.exhausted)
    for weight in limits.heuristic_weights:
        found = search.run(
            SearchPass(weight), max(1, limits.expansions // len(limits.heuristic_weights)), known
        )
        expanded += found.expanded
        if found.found or found.exhausted:
            break
    return replace(found, expanded=expanded)
