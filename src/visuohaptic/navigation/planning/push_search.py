"""Best-first search over pushes: which object, from where, how far, in which order.

A state is where every body stands and where the robot is. A step drives to a
stable contact and pushes straight by a whole number of cells; the last step
drives to the goal. The estimate of the remaining cost is the cheapest way to
the goal through a map without the bodies, on which entering the place of a
body that was not pushed yet costs what its shortest push costs - the shortest
that opens a way, where the body alone closes it, or two short ones: never too
much, so the first solution taken from the queue is the cheapest of the model.
A push that frees no cell beside the goal's component needs another one after
it, and is charged for that at once.

A hasty pass comes first: it prefers pushes that open anything the robot could
not reach, so that passages in series cost one after the other and not all
combinations. What it finds bounds the passes after it.

The next pass takes pushes that open nothing in lengths of 1 to 6, 8, 12 ...
cells only; where it finds nothing in its budget, nor had the hasty one, others
take all lengths and trade cost for speed.

Completeness: of all sequences of straight pushes through the centre, from the
contacts of :func:`~visuohaptic.navigation.pushing.contact_candidates.push_contacts`, by
whole cells, with orientations kept, a solution is found if one exists and the
budget of expansions suffices. The states are finitely many; a queue that runs
empty proves that there is none.
"""

from __future__ import annotations

import heapq
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32

from ..problem.push_costs import PushCosts, push_cost
from .push_states import (
    Child,
    PushStep,
    SearchLimits,
    SearchResult,
    SearchState,
    SeenFields,
    anchors,
    steps_of,
)
from .search_domain import Body, PushWorld

__all__ = ["PushStep", "SearchLimits", "SearchResult", "anchors", "search_pushes"]

#: The robot stands off by so many cells before and after a push.
STAND_OFF = 0.6
#: On the goal the robot may be nearer to an obstacle by so much, the rounding of cells [cells].
GOAL_SLACK = 0.25
#: ... and where it stands off an object.
STAND_SLACK = 0.15
#: The hasty pass believes the rest to cost so many times its estimate.
HASTY_GREED = 5.0
#: More than this the lower bound does not charge for a body [s]: the queue of the field grows with it.
MAX_CHARGE_S = 60.0


class _Search:
    """One run; the arrays that all its states share."""

    def __init__(
        self,
        world: PushWorld,
        start: Float[np.ndarray, "2"],
        goal: Float[np.ndarray, "2"],
        costs: PushCosts,
        limits: SearchLimits,
    ) -> None:
        self.fine, self.heuristic_weight, self.weighted = True, 1.0, False
        self.known = float("inf")  # cost of a plan that there is already [units]
        from ._push_search_kernels import FAR, UNITS

        self.world, self.start, self.goal, self.costs, self.limits = world, start, goal, costs, limits
        self.far, self.units = int(FAR), int(UNITS)
        self.units_per_s = UNITS * world.robot.v_max_m_s / world.map.resolution_m
        self.tables = [self._table(body, False) for body in world.bodies]
        self.oblique_tables = [self._table(body, True) for body in world.bodies]
        self.rests: dict[int, Int32[np.ndarray, "n"]] = {}
        self.nothing = np.zeros((0, 0), np.int32)
        self.no_charge = np.zeros(0, np.int32)
        self.leasts = [float(table.min()) for table in self.tables]
        self.least = min(self.leasts, default=float("inf"))
        self.charges = [0.0] * len(world.bodies)
        self.goal_cells, self.goal_costs = self._goal(world.clearance)

    def _table(self, body: Body, oblique: bool) -> Float[np.ndarray, "steps"]:
        """``t_mani`` [units] by whole cells, from 0; infinite beyond what is allowed."""
        resolution_m = self.world.map.resolution_m
        most = int(body.allowed.longest_m / resolution_m + 1e-9) if body.contacts else 0
        table = [np.inf]
        for steps in range(1, most + 1):
            cost = push_cost(
                body.item.tag, steps * resolution_m, self.world.robot, self.costs, oblique=oblique
            )
            table.append(cost.total_s * self.units_per_s)
        return np.array(table)

    def _charges(self, start: Int32[np.ndarray, "k"]) -> list[float]:
        """What crossing the place of a body costs at least [units], while it was not pushed."""
        from ._push_search_kernels import flood, opening_steps

        world = self.world
        charges = list(self.leasts)
        home = np.zeros((len(world.bodies), 2))
        for index, body in enumerate(world.bodies):
            if not np.isfinite(self.leasts[index]):
                continue
            alone = world.clearance_of(index, home[index])
            beyond = flood(alone, world.radius, self.goal_cells)
            if beyond[start].any():
                continue
            least = 2.0 * self.leasts[index]
            for contact in body.contacts:
                table = self.oblique_tables[index] if contact.oblique else self.tables[index]
                opens = opening_steps(
                    world.clearance, beyond, self.goal_cells, body.outline,
                    contact.direction[0], contact.direction[1], world.radius, len(table) - 1,
                )  # fmt: skip
                if opens.any():
                    least = min(least, float(table[int(opens.argmax())]))
            charges[index] = max(least, self.leasts[index])
        return charges

    def _goal(
        self, clearance: Float32[np.ndarray, "rows columns"]
    ) -> tuple[Int32[np.ndarray, "k"], Int32[np.ndarray, "k"]]:
        """Cells to reach the goal from; none when the robot does not fit on the goal itself."""
        from ._push_search_kernels import clearance_at

        if clearance_at(clearance, self.goal[0], self.goal[1]) < self.world.radius - GOAL_SLACK:
            return np.zeros(0, np.int32), np.zeros(0, np.int32)
        return anchors(clearance, self.goal, self.world.radius, self.world.slow, self.units)

    def rest(self, pushed: int) -> Int32[np.ndarray, "n"]:
        """Lower bound of what is left, from every cell [units]."""
        from ._push_search_kernels import mark_region, travel_field

        if pushed not in self.rests:
            world = self.world
            region = np.zeros(world.clearance.shape, np.int16)
            charge = np.zeros(len(world.bodies) + 1, np.int32)
            # Where places overlap the cheapest push counts: a bound must not be too high.
            order = sorted(range(len(world.bodies)), key=lambda k: self.charges[k])
            for index in order:
                if not pushed >> index & 1:
                    mark_region(region, world.bodies[index].outline, world.radius, index + 1)
                    charge[index + 1] = int(min(self.charges[index], MAX_CHARGE_S * self.units_per_s))
            blocked = [
                i + 1 for i, t in enumerate(self.tables) if not np.isfinite(t.min()) and not pushed >> i & 1
            ]
            clearance = world.clearance
            if blocked:
                clearance = np.where(np.isin(region, blocked), np.float32(0.0), clearance)
                charge[blocked] = 0
            self.rests[pushed] = travel_field(
                clearance, world.radius, world.slow, self.goal_cells, self.goal_costs,
                region, charge, self.nothing, 0,
            )[0]  # fmt: skip
        return self.rests[pushed]

    def run(self, expansions: int) -> SearchResult:
        """Search until the cheapest plan is taken from the queue, it runs empty, or the budget is spent."""
        world = self.world
        first = SearchState(0.0, self.start, np.zeros((len(world.bodies), 2)), 0)
        if not self.goal_cells.size:
            return SearchResult(False, exhausted=True, reason="the goal is too near to what cannot be moved")
        cells, _ = anchors(
            world.clearance_with(first.shifts), self.start, world.radius, world.slow, self.units, reach=2
        )
        if not cells.size:
            return SearchResult(False, exhausted=True, reason="the robot does not fit where it starts")
        self.charges = self._charges(cells)
        if self.rest(0)[cells].min() >= self.far:
            pushed = ", whatever is pushed" if world.bodies else ""
            return SearchResult(False, exhausted=True, reason=f"walls separate start and goal{pushed}")
        seen = SeenFields(self.limits.memory_cells)
        queue: list[tuple[float, int, SearchState | Child, bool]] = [(0.0, 0, first, False)]
        ticket = expanded = 0
        best = self.known
        cut = False
        while queue:
            bound, _, taken, arrived = heapq.heappop(queue)
            state = self._born(taken) if isinstance(taken, Child) else taken
            if arrived:
                return SearchResult(True, steps_of(state), bound / self.units, expanded, exhausted=not cut)
            if not state.refined and self.weighted:
                state.refined = True
                if not self._opened(state):
                    assert state.step is not None
                    again = max(self.charges[state.step.body], self.leasts[state.step.body])
                    estimate = state.spent + (state.left + again) * self.heuristic_weight
                    if estimate < best:
                        ticket += 1
                        heapq.heappush(queue, (estimate, ticket, state, False))
                    continue
            if not state.refined:
                state.refined = True
                estimate = state.spent + self._left(state) * self.heuristic_weight
                if estimate < best:
                    ticket += 1
                    heapq.heappush(queue, (estimate, ticket, state, False))
                continue
            if expanded >= expansions or expanded * world.clearance.size > self.limits.work_cells:
                return SearchResult(
                    False, expanded=expanded, reason=f"no plan among {expanded} configurations, not proved"
                )
            expanded += 1
            finished, children = self._expand(state, best, seen)
            if finished is not None and finished < best:
                if self.weighted and state.depth == 0:
                    return SearchResult(True, (), finished / self.units, expanded)
                best = finished
                ticket += 1
                heapq.heappush(queue, (finished, ticket, state, True))
            if state.depth >= self.limits.pushes:
                cut = cut or bool(children)
                continue
            for estimate, child in children:
                if estimate < best:
                    ticket += 1
                    heapq.heappush(queue, (estimate, ticket, child, False))
        return SearchResult(
            False,
            expanded=expanded,
            exhausted=not cut,
            reason="no sequence of straight pushes opens a way" if not cut else "no plan with so few pushes",
        )

    def _opened(self, state: SearchState) -> bool:
        """Whether the last push lets the robot reach anything that it could not reach before."""
        from ._push_search_kernels import flood

        clearance = self.world.clearance_with(state.shifts)
        near, _ = anchors(clearance, state.robot, self.world.radius, self.world.slow, self.units)
        if not near.size or state.beyond is None:
            return False
        return bool((flood(clearance, self.world.radius, near) & state.beyond).any())

    def _left(self, state: SearchState) -> float:
        """Lower bound of what is left after a push [units]."""
        near, extra = anchors(
            self.world.clearance, state.robot, self.world.radius, self.world.slow, self.units
        )
        if not near.size:
            return float("inf")
        left = float((self.rest(state.pushed)[near].astype(np.int64) + extra).min())
        if left >= self.far:
            return float("inf")
        if not state.opens:
            free = self.rest((1 << len(self.world.bodies)) - 1)
            left = max(left, float((free[near].astype(np.int64) + extra).min()) + self.least)
        return left

    def _expand(
        self, state: SearchState, best: float, seen: SeenFields
    ) -> tuple[float | None, list[tuple[float, Child]]]:
        """Cost of driving to the goal now [units], and the states after one push."""
        from ._push_search_kernels import flood, travel_field

        world = self.world
        clearance = world.clearance_with(state.shifts)
        cells, costs = anchors(
            clearance, state.robot, world.radius, world.slow, self.units, reach=1 if state.depth else 2
        )
        if not cells.size or any(seen.dominated(state, int(cell)) for cell in cells):
            return None, []
        bounded = np.isfinite(best)
        bound = int(best - state.spent) if bounded else 0
        rest = self.rest(state.pushed)
        cost, _, _ = travel_field(
            clearance, world.radius, world.slow, cells, costs,
            self.nothing, self.no_charge, rest if bounded else self.nothing.ravel(), bound,
        )  # fmt: skip
        seen.add(state, cost)
        goal_cells, goal_costs = self._goal(clearance)
        finished = None
        if goal_cells.size:
            least = int((cost[goal_cells].astype(np.int64) + goal_costs).min())
            if least < self.far:
                finished = state.spent + least
        beyond = None
        if finished is None and self.weighted:
            # Anything that the robot can't reach yet is worth opening: doors in series open one by one.
            beyond = (clearance.ravel() >= world.radius) & (cost >= self.far)
        elif finished is None:
            beyond = flood(clearance, world.radius, goal_cells)
        children: list[tuple[float, Child]] = []
        limit = min(best, finished if finished is not None else np.inf)
        for index in range(len(world.bodies)):
            children += self._pushes(state, index, clearance, cost, beyond, limit)
        return finished, children

    def _pushes(
        self,
        state: SearchState,
        index: int,
        clearance: Float32[np.ndarray, "rows columns"],
        cost: Int32[np.ndarray, "n"],
        beyond: Bool[np.ndarray, "n"] | None,
        limit: float,
    ) -> list[tuple[float, Child]]:
        from ._push_search_kernels import clearance_at, free_push_steps, opening_steps, reach_cost

        world, body = self.world, self.world.bodies[index]
        if len(self.tables[index]) < 2:
            return []
        shift = state.shifts[index]
        without: Float32[np.ndarray, "rows columns"] | None = None
        found: list[tuple[float, Child]] = []
        others: tuple[np.ndarray, ...] | None = None
        # The field of the new set of pushed bodies is computed for those children only that are taken.
        rest = self.rest(state.pushed)
        free = self.rest((1 << len(world.bodies)) - 1)
        relief = 0.0 if state.pushed >> index & 1 else self.charges[index]
        columns = world.clearance.shape[1]
        for number, contact in enumerate(body.contacts):
            last = state.step
            if (
                last is not None
                and last.body == index
                and last.contact == number
                and (last.steps < len(self.tables[index]) - 1)
            ):
                continue  # a longer push says the same
            table = self.oblique_tables[index] if contact.oblique else self.tables[index]
            touch = body.centre + shift + contact.robot
            stand = touch - STAND_OFF * contact.direction
            # Its own body is where it has to be: what counts is everything else.
            if clearance_at(world.clearance, stand[0], stand[1]) < world.radius - STAND_SLACK:
                continue
            approach = reach_cost(clearance, cost, stand[0], stand[1], world.radius, world.slow)
            if approach >= self.far or state.spent + approach + table[1] >= limit:
                continue
            if without is None or others is None:
                without = world.clearance_with(state.shifts, index)
                others = self._others(state, index)
            if clearance_at(without, stand[0], stand[1]) < world.radius - STAND_SLACK:
                continue
            steps = free_push_steps(
                world.occupied, without, body.samples + shift, body.around + shift, body.outline + shift, *others,
                touch[0], touch[1], contact.direction[0], contact.direction[1], world.radius, len(table) - 1,
            )  # fmt: skip
            if not steps:
                continue
            lengths = np.arange(1, steps + 1)
            ends = stand + lengths[:, None] * contact.direction
            end_cells = np.floor(ends).astype(np.int64)
            at = end_cells[:, 1] * columns + end_cells[:, 0]
            near_wall = world.clearance.ravel()[at] < world.radius
            left = np.maximum(rest[at] - relief, free[at])
            left[near_wall] = 0.0
            opens = np.ones(steps + 1, dtype=bool)
            if beyond is not None:
                opens = opening_steps(
                    without, beyond, self.goal_cells, body.outline + shift,
                    contact.direction[0], contact.direction[1], world.radius, steps,
                )  # fmt: skip
                if self.weighted:
                    left = np.where(opens[1:], left, left + max(relief, self.leasts[index]))
                else:
                    left = np.where(opens[1:], left, np.maximum(left, free[at] * ~near_wall + self.least))
            spent = state.spent + approach + table[1 : steps + 1]
            estimate = spent + left * self.heuristic_weight
            wanted = (estimate < limit) & (left < self.far)
            if self.weighted:
                first = int(opens[1:].argmax()) if opens[1:].any() else steps
                wanted &= (lengths - 1 == first) | (lengths - 1 == first + 2) | (lengths % 6 == 0)
            elif not self.fine:
                wanted &= opens[1:] | (lengths <= 6) | (lengths % 4 == 0)
            for i in np.flatnonzero(wanted):
                child = Child(
                    state, index, number, int(lengths[i]), stand, touch, float(spent[i]), bool(opens[i + 1]),
                    self.weighted and not opens[i + 1], float(left[i]), beyond if self.weighted else None,
                )  # fmt: skip
                found.append((float(estimate[i]), child))
        return found

    def _born(self, child: Child) -> SearchState:
        """The state of a push that was taken from the queue."""
        parent, direction = child.parent, self.world.bodies[child.body].contacts[child.contact].direction
        after = parent.shifts.copy()
        after[child.body] = parent.shifts[child.body] + child.steps * direction
        robot = child.stand + child.steps * direction
        step = PushStep(
            child.body, child.contact, child.steps, parent.shifts, after, child.stand, child.touch, robot
        )
        return SearchState(
            child.spent, robot, after, parent.pushed | 1 << child.body, parent, step,
            parent.depth + 1, child.opens, child.refined, child.left, child.beyond,
        )  # fmt: skip

    def _others(
        self, state: SearchState, index: int
    ) -> tuple[Float[np.ndarray, "v 2"], Int32[np.ndarray, "o"], Float[np.ndarray, "k 2"]]:
        """Outlines of the other bodies, one after the other, where each begins, and points inside their edges."""
        others = [(body, state.shifts[k]) for k, body in enumerate(self.world.bodies) if k != index]
        if not others:
            return np.zeros((0, 2)), np.zeros(1, np.int32), np.zeros((0, 2))
        outlines = [body.outline + shift for body, shift in others]
        starts = np.cumsum([0, *(len(outline) for outline in outlines)]).astype(np.int32)
        return (
            np.concatenate(outlines),
            starts,
            np.concatenate([body.samples + shift for body, shift in others]),
        )


def search_pushes(
    world: PushWorld,
    start: Float[np.ndarray, "2"],
    goal: Float[np.ndarray, "2"],
    costs: PushCosts | None = None,
    limits: SearchLimits | None = None,
) -> SearchResult:
    """The cheapest sequence of pushes that lets the robot drive from start to goal.

    Parameters
    ----------
    world
        Static map and bodies.
    start, goal
        Grid coordinates [cells].
    costs, limits
        What a push costs; how long to search.
    """
    limits = limits or SearchLimits()
    search = _Search(world, start, goal, costs or PushCosts(), limits)
    search.fine = False
    weighted = SearchResult(False)
    if world.bodies and limits.weighted_expansions:
        search.weighted, search.heuristic_weight = True, HASTY_GREED
        weighted = search.run(min(limits.weighted_expansions, limits.expansions))
        search.weighted, search.heuristic_weight = False, 1.0
        if weighted.found:
            search.known = weighted.cost * search.units + 1.0
    first = search.run(min(limits.first_expansions, limits.expansions))
    if first.found or not world.bodies:
        return replace(first, expanded=first.expanded + weighted.expanded)
    if weighted.found:
        # Nothing cheaper in the budget, or nothing cheaper at all.
        return replace(weighted, expanded=first.expanded + weighted.expanded, exhausted=first.exhausted)
    search.fine = True
    expanded = first.expanded + weighted.expanded
    for heuristic_weight in limits.heuristic_weight:
        search.heuristic_weight = heuristic_weight
        found = search.run(max(1, limits.expansions // len(limits.heuristic_weight)))
        expanded += found.expanded
        if found.found or found.exhausted:
            break
    return replace(found, expanded=expanded)
