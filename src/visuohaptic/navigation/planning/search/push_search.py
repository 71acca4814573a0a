"""Navigation among movable obstacles (NAMO) by anytime A* over pushes: which objects, contacts, lengths, in which order.

A state consists of the positions of all bodies and of the robot. A successor drives to a stable contact and pushes
straight; the last step drives to the goal. Travel costs are computed once per state on the lattice of the
domain, whose size does not depend on the resolution of the map. A contact enters the queue with a lower bound and is
evaluated only when it is taken: its collision-free push distance, and the lengths at which it connects components of
free space. The lengths tried are these, a few longer ones, and a fixed sequence in metres.

A pass of weighted A* finds a first plan, without the bodies that touch no bottleneck; a pass with the admissible
heuristic of :mod:`~visuohaptic.navigation.planning.search.push_heuristic` and all bodies improves it until it is
proved optimal or the budget ends, and provides the bound. That no plan exists is proved by
:mod:`~visuohaptic.navigation.planning.search.infeasibility`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from ....core.objects import HapticTag
from ....io.maps.occupancy_map import FREE, OCCUPIED, OccupancyMap
from ...problem.planning_problem import MovableObject, PlanningProblem, RobotModel
from ...problem.push_costs import PushCosts
from ..arrays import Nodes, Point
from ._travel_kernels import flood
from .domain_builder import build_search_domain
from .drives import drives_cost
from .infeasibility import Infeasibility
from .push_heuristic import PushHeuristic
from .push_lengths import LENGTH_STEP_M, opening_at, push_step, refine_lengths, replayed
from .push_pass import PushPass
from .push_states import Deadline, PushStep, SearchLimits, SearchResult, SearchState
from .search_domain import SearchDomain

#: Heuristic weights of the passes for a first plan, and of a last pass if nothing was found.
WEIGHTS, LAST_WEIGHT = (1.2, 3.0), 10.0
#: Fraction of the time for a first plan or a proof that is spent on perpendicular pushes only; the rest is for oblique ones.
STRAIGHT = 0.5
#: Maximum number of expanded configurations with the first weight, and for the bound of a single body.
FIRST_EXPANSIONS, ALONE_EXPANSIONS = 150, 60
#: Maximum number of expanded configurations in which a passage that is about as wide as the robot is looked for, and of a
#: first plan on divided cells before it: enough for a plan near its bound, and a part of the time of that look.
NARROW_EXPANSIONS, SOON_EXPANSIONS = 40, 20
#: Allowed gap between the bound of one body alone and its cheapest plan, as a fraction.
ALONE_GAP = 0.02
#: Fractions of the budget at which these phases end: bounds of single bodies; a first plan with the bodies on the cheapest
#: path of the bound; with those at bottlenecks, by weight; the infeasibility proof; a first plan with all bodies.
ALONE, CROSSED, SOON, PROOF, LATE = 0.3, 0.35, (0.4, 0.55), 0.75, (0.8, 0.9, 1.0)
#: End of the reason where a passage is as wide as the robot within a cell: nothing is proved, the robot may fit between centres.
NARROW = " on the centres of cells; a passage is about as wide as the robot"


def search_pushes(
    domain: SearchDomain,
    start: Point,
    limits: SearchLimits | None = None,
    *,
    costs: PushCosts | None = None,
    active: Collection[int] | None = None,
    oblique: bool = False,
) -> SearchResult:
    """The cheapest sequence of pushes that lets the robot drive from start to goal.

    Parameters
    ----------
    domain
        Static map and bodies.
    start
        Grid coordinates [cells].
    limits
        Limits of the search.
    costs
        Cost model of the pushes; by default that of the domain.
    active
        Indices of the bodies that may be pushed; all of them by default.
    oblique
        Whether pushes may be oblique to a face, which relies on contact friction.

    Returns
    -------
    The pushes, or the reason why there are none and whether this is proved (``exhausted``).
    """
    load_kernels()
    chosen = frozenset(range(len(domain.bodies)) if active is None else active)
    return _Search(domain, start, costs or domain.costs, limits or SearchLimits(), chosen, oblique).run()


@lru_cache(maxsize=1)
def load_kernels() -> None:
    """Solve a small problem once, so that no budget is spent on loading compiled code."""
    cells = np.zeros((12, 24), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = cells[:, 12] = OCCUPIED
    cells[4:8, 12] = FREE
    outline_m = 0.1 * np.array([[11.0, 4.5], [14.0, 4.5], [14.0, 7.5], [11.0, 7.5]])
    ends_m = np.array([0.45, 0.6]), np.array([2.0, 0.6])
    robot, box = RobotModel(0.15), MovableObject("box", outline_m, HapticTag())
    domain = build_search_domain(PlanningProblem(OccupancyMap(cells, 0.1), robot, *ends_m, (box,)), block=2)
    _Search(domain, domain.start, domain.costs, SearchLimits(budget_s=600.0), frozenset((0,)), False).run()


@dataclass(slots=True, eq=False)
class _Search:
    """One search with its budget: a first plan or an infeasibility proof, then better plans and bounds."""

    domain: SearchDomain
    start: Point
    costs: PushCosts
    limits: SearchLimits
    active: frozenset[int]
    oblique: bool
    expanded: int = 0
    deadline: Deadline = field(init=False)
    first: SearchState = field(init=False)
    #: for each body that separates start and goal, the push that passes it when the other bodies are absent
    lone: list[PushStep] = field(default_factory=list)
    cells: Nodes = field(init=False)  #: start nodes of the robot

    def __post_init__(self) -> None:
        self.deadline = Deadline.after(self.limits.budget_s)
        domain = self.domain
        self.first = SearchState(0.0, self.start, np.zeros((len(domain.bodies), 2)))
        layer = domain.relaxed.lattice_with(self.first.shifts)
        self.cells, _ = domain.seeds(layer, self.start, reach=1 if domain.block > 1 else 2)

    def run(self) -> SearchResult:
        """The cheapest plan, or the reason why there is none."""
        if self.deadline.passed:
            return self._late()
        free = self._heuristic(())
        reason, proved = self._impossible(free)
        if reason:
            return SearchResult(False, exhausted=proved, reason=reason)
        if self._until(1.0).passed:
            return self._late()
        # Often the cheapest path needs no push: any plan with pushes costs at least one push more.
        seconds, lowest = self.domain.block / free.units, float(free.free_field[self.cells].min())
        pushing = lowest + min((free.shortest_push(k) for k in self.active), default=float("inf"))
        enough = (1.0 + self.limits.gap) * (pushing if self.active else lowest)
        # A path that is hardly longer than without the objects crosses a small part of a large map; the limit leaves a
        # tolerance above an acceptable cost for any-angle paths.
        for most in ((1.0 + self.limits.gap) * enough, float("inf")):
            plan = PushPass(free, 1.0, self.limits, self._until(1.0), relaxed=True).run(self.first, 1, most)
            if plan.found and (not self.active or plan.cost <= enough * seconds):
                return replace(plan, bound=min(plan.bound, pushing * seconds))
            if plan.found or self._until(1.0).passed:
                break
        return self._with_pushes(free, plan)

    def _with_pushes(self, free: PushHeuristic, plan: SearchResult) -> SearchResult:
        """A plan with pushes, if a cheaper one than the plan without pushes is found within the budget."""
        # A known plan excludes more bodies by their costs, below.
        needed = self.active if plan.found else _bottlenecks(self.domain, self.active, self._until(ALONE))
        if self._until(SOON[-1]).passed:
            return plan if plan.found else self._late()
        heuristic = self._heuristic(needed, free)
        if plan.found:
            heuristic.limit = int(plan.cost * heuristic.units / self.domain.block) + 1
            lowest = (heuristic.from_start(self.cells)[heuristic.goal_cells] + heuristic.goal_costs).min()
            bound = float(lowest) * self.domain.block / heuristic.units
            plan = replace(plan, bound=min(bound, plan.cost))
            if plan.cost <= (1.0 + self.limits.gap) * plan.bound:
                return plan
        elif reason := self._bound_crossings(heuristic):
            return SearchResult(False, exhausted=True, reason=reason)
        elif self.lone:
            plan = self._joined(plan, heuristic)
        guide, joined = heuristic, plan.found and bool(self.lone)
        if not plan.found:
            plan, guide = self._soon(plan, heuristic)
            if plan.reason:
                return plan
            joined = plan.found and guide is not heuristic
        if not joined:
            plan = self._first_plan(plan, guide, ((WEIGHTS[0], CROSSED),), guide.crossed(self.cells))
        if not plan.found:
            plan = self._first_plan(plan, guide, zip(WEIGHTS, SOON, strict=True))
        alone = heuristic.alone
        through: dict[int, float] = {}
        worth = self.active
        if plan.found:
            # A plan that pushes one of the others cannot improve on this one.
            seconds = self.domain.block / heuristic.units
            rest = self.active - {step.body for step in plan.steps}
            through = {k: heuristic.through(self.cells, k) * seconds for k in rest}
            worth -= {k for k, cost in through.items() if cost * (1.0 + self.limits.gap) >= plan.cost}
        elif reason := self._proof(heuristic):
            return SearchResult(False, exhausted=True, reason=reason, expanded=self.expanded)
        if not worth <= needed and not self._until(1.0).passed:
            before, heuristic = heuristic, self._heuristic(worth, free)
            if plan.found:
                heuristic.begin, heuristic.limit = before.begin, int(plan.cost / seconds) + 1
            for k in worth & needed:
                heuristic.raise_bound(k, alone[k])
        if not plan.found:
            reason = self._proof(heuristic) if worth != needed else ""
            passes = zip((*WEIGHTS, LAST_WEIGHT), LATE, strict=True)
            plan = plan if reason else self._first_plan(plan, self._guide(heuristic), passes)
            if not plan.found:
                late = self._late()
                return replace(late, exhausted=bool(reason), reason=reason or late.reason)
        if self.limits.found is not None:
            self.limits.found(plan)
        plan = self._improved(heuristic, plan, worth)
        steps, cost = refine_lengths(heuristic, self.start, plan, self._until(1.0))
        plan = replace(plan, steps=steps, cost=cost)
        bound = min([plan.bound, cost, *(through[k] for k in through.keys() - worth)])
        left_out = tuple(sorted(self.active - needed - worth))
        return replace(plan, bound=bound, expanded=self.expanded, left_out=left_out)

    def _heuristic(
        self, bodies: Collection[int], free: PushHeuristic | None = None, *, relaxed: bool = True
    ) -> PushHeuristic:
        left, oblique = self.active - frozenset(bodies), self.oblique
        return PushHeuristic(
            self.domain, self.costs, bodies, left_out=left, oblique=oblique, free=free, relaxed=relaxed
        )

    def _soon(self, plan: SearchResult, heuristic: PushHeuristic) -> tuple[SearchResult, PushHeuristic]:
        """A plan that is found soon, or a reason to search on smaller cells; and the guide to a better plan."""
        if self.domain.divided and not self.domain.patient:
            guide, quick = self._guide(heuristic), (WEIGHTS[0], CROSSED)
            plan = self._first_plan(plan, guide, (quick,), guide.crossed(self.cells), SOON_EXPANSIONS)
            if plan.found:
                return plan, guide
        if not self.domain.patient:
            plan = self._looked(heuristic)
        return plan, heuristic if plan.found or plan.reason else self._guide(heuristic)

    def _looked(self, heuristic: PushHeuristic) -> SearchResult:
        """A plan that is found soon; a reason where one soon seems to exist that leads beside the centres of cells."""
        until = self._until_found(CROSSED)
        look = PushPass(heuristic, WEIGHTS[0], self.limits, until, relaxed=True)
        plan = look.run(self.first, NARROW_EXPANSIONS)
        self.expanded += plan.expanded
        narrow = bool(np.isfinite(look.doubtful)) and not plan.found
        reason = self._late().reason + NARROW if narrow else ""
        return replace(plan, narrow=narrow, exhausted=False, reason=reason)

    def _guide(self, heuristic: PushHeuristic) -> PushHeuristic:
        """The heuristic for a first plan, which has to exist on the centres of cells."""
        guide = self._heuristic(heuristic.active, relaxed=False)
        guide.alone = heuristic.alone
        return guide

    def _late(self) -> SearchResult:
        reason = f"no plan among {self.expanded} configurations, not proved"
        return SearchResult(False, reason=reason, expanded=self.expanded)

    def _until(self, fraction: float) -> Deadline:
        return self.deadline.earlier((1.0 - fraction) * self.limits.budget_s)

    def _until_found(self, fraction: float) -> Deadline:
        return self._until(fraction * (1.0 if self.oblique else STRAIGHT))

    def _proof(self, heuristic: PushHeuristic) -> str:
        return Infeasibility(heuristic, self.limits, self._until_found(PROOF)).prove(self.first, self.cells)

    def _first_plan(
        self,
        known: SearchResult,
        heuristic: PushHeuristic,
        passes: Iterable[tuple[float, float]],
        bodies: Collection[int] | None = None,
        first: int = FIRST_EXPANSIONS,
    ) -> SearchResult:
        """A plan by weighted A*, by weight and fraction of the budget, with pushes of some bodies only.

        Returns the known plan if none is better.
        """
        units = heuristic.units / self.domain.block
        for weight, fraction in passes:
            # The smallest weight serves only for plans that are found immediately.
            most = first if weight == WEIGHTS[0] else self.limits.expansions
            most = max(min(most, self.limits.expansions - self.expanded), 1)
            plan = PushPass(heuristic, weight, self.limits, self._until_found(fraction), bodies).run(
                self.first, most, known.cost * units, self.limits.gap
            )
            self.expanded += plan.expanded
            if plan.found or known.found:
                return plan if plan.found else known
            known = plan
            if plan.exhausted:
                break
        return known

    def _joined(self, known: SearchResult, heuristic: PushHeuristic) -> SearchResult:
        """The pushes past each single body, in the order of a drive without bodies, if such a plan is near the bound."""
        units, shifts = heuristic.units / self.domain.block, self.first.shifts
        left = heuristic.to_go(heuristic.free_field, np.array([step.approach for step in self.lone]))
        lone = [self.lone[k] for k in np.argsort(-left, kind="stable")]
        bound = float(heuristic.field(shifts)[self.cells].min()) / units
        most = (1.0 + ALONE_GAP) * bound
        # With one body, a passage was checked on the lattice only: on the map it may need a slightly longer push.
        for longer in (0.0, LENGTH_STEP_M / self.domain.map.resolution_m):
            alone = [push_step(heuristic, shifts, s.body, s.contact, s.length + longer) for s in lone]
            steps = replayed(heuristic, tuple(alone), 0, alone[0].length)
            if not steps:
                break
            cost = heuristic.pushes_units(steps) / units
            cost += drives_cost(self.domain, steps, self.start, most - cost)
            if cost < most:
                return SearchResult(True, steps, cost, bound)
        return known

    def _improved(
        self, heuristic: PushHeuristic, plan: SearchResult, bodies: Collection[int]
    ) -> SearchResult:
        """By pushes of these bodies, the plan or a better one, with the tightest bound found within the budget."""
        units = heuristic.units / self.domain.block
        if self.deadline.passed:
            return replace(plan, bound=min(plan.bound, plan.cost))
        plan = replace(plan, bound=float(heuristic.field(self.first.shifts)[self.cells].min()) / units)
        if plan.cost > (1.0 + self.limits.gap) * plan.bound:
            most = max(self.limits.expansions - self.expanded, 1)
            better = PushPass(heuristic, 1.0, self.limits, self._until(1.0), bodies, relaxed=True).run(
                self.first, most, plan.cost * units, self.limits.gap
            )
            self.expanded += better.expanded
            plan = replace(
                better if better.found else plan, bound=max(plan.bound, better.bound), narrow=better.narrow
            )
        return replace(plan, bound=min(plan.bound, plan.cost))

    def _bound_crossings(self, heuristic: PushHeuristic) -> str:
        """Raise the bounds of bodies that alone separate start and goal; the reason if one of them cannot be passed."""
        domain, limits, deadline = self.domain, self.limits, self._until(ALONE)
        # A path without pushes, or one that crosses few bodies, needs no other bounds.
        for index in heuristic.separating(self.cells, heuristic.crossed(self.cells)):
            if deadline.passed:
                break
            body, first = (domain.bodies[index],), SearchState(0.0, self.start, np.zeros((1, 2)))
            alone = replace(domain, bodies=body, lattice=heuristic.base)
            cells, _ = domain.seeds(heuristic.base, self.start)
            part = PushHeuristic(alone, self.costs, (0,), oblique=self.oblique, free=heuristic)
            most = min(ALONE_EXPANSIONS, limits.expansions)
            found = PushPass(part, 1.0, limits, deadline, on_map=False, relaxed=True).run(
                first, most, gap=ALONE_GAP
            )
            if not found.found:
                reason = Infeasibility(part, limits, deadline).prove(first, cells)
                if reason:
                    return reason
            self.lone += (replace(step, body=index) for step in found.steps)
            if np.isfinite(found.bound):
                free = float(heuristic.free_field[self.cells].min())
                more = found.bound * heuristic.units / domain.block - free
                heuristic.raise_bound(index, more)
        return ""

    def _impossible(self, heuristic: PushHeuristic) -> tuple[str, bool]:
        """The reason why no sequence of pushes solves the problem, empty if one may, and whether it is a proof."""
        domain, goal = self.domain, self.domain.goal
        still = np.array([k not in self.active for k in range(len(domain.bodies))], dtype=bool)
        fits = domain.clear_straight(self.first.shifts, goal, goal[None], still)[0]
        if not fits or not heuristic.goal_cells.size:
            return "the goal is too near to what cannot be moved", True
        if not self.cells.size:
            return "the robot does not fit at its start", True
        what = "walls and what is not pushed" if domain.immovable or still.any() else "walls"
        what += " separate start and goal"
        if heuristic.free_field[self.cells].min() >= heuristic.far:
            return what + (", with or without pushes" if self.active else ""), True
        base = domain.lowered(domain.lattice, self.first.shifts, np.flatnonzero(still).tolist(), domain.block)
        near, ends = (domain.seeds(base, point)[0] for point in (self.start, goal))
        if not flood(base, domain.radius, near, ends)[ends].any():
            return what + NARROW, False
        return "", False


def _bottlenecks(domain: SearchDomain, active: Collection[int], deadline: Deadline) -> frozenset[int]:
    """Bodies that divide the free space around them or cover the goal; also those not tested before the deadline."""
    everything = np.ones(len(domain.bodies), dtype=bool)
    still = np.array([k not in active for k in range(len(domain.bodies))], dtype=bool)
    shifts = np.zeros((len(domain.bodies), 2))
    found = set()
    for index in active:
        if deadline.passed:
            found.add(index)
            continue
        body = domain.bodies[index]
        # At this distance along an axis the body is clear of every block around it, so all components are visible.
        far = 2.0 * (float(np.ptp(body.outline, axis=0).max()) + 2.0 * domain.radius + 4.0 * domain.block)
        # Among the other bodies, with which it may close a passage, and alone, as they may fill the room behind it.
        for others in (everything, still):
            among = others.copy()
            among[index] = False
            if len(opening_at(domain, shifts, index, np.array([1.0, 0.0]), far, body.centre, among)):
                found.add(index)
                break
    return frozenset(found)
