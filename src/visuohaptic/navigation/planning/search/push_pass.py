"""One pass of weighted A* over pushes: expands states, with lazy evaluation of contacts and push lengths.

A contact enters the queue with a lower bound and is evaluated only when it is taken: its collision-free push distance,
and the lengths at which it connects components of free space. A push of some length enters with the bound of its
parent and is re-queued with that of the configuration it leads to. The risk of an oblique push is simulated, hence
expensive: the push enters without it, and is re-queued with it when it would be expanded next.
"""

from __future__ import annotations

import heapq
from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from ..arrays import Field, Nodes, Path
from ..place_costs import places_s
from . import _travel_kernels
from ._travel_kernels import clearances_at, reach_costs
from .drives import drive_cost, drives_cost, lattice_cost
from .push_heuristic import PushHeuristic
from .push_lengths import LENGTH_STEP_M, free_length, opening_at, push_step, stand_is_free
from .push_states import Deadline, SearchLimits, SearchResult, SearchState, SeenFields, push_sequence
from .search_domain import CLEAR_SLACK_M

#: Lengths tried for every push, and beyond one that connects components of free space [steps].
LADDER, EXTRA = (2, 4, 6, 9, 13, 19, 28, 40), (0, 1, 2, 4, 8, 16)
#: Costs up to this ratio are those of the same path: rounding errors of integer costs stay below it.
SAME = 1.002


@dataclass(frozen=True, slots=True, eq=False)
class _Contact:
    """A reachable push, before its length is chosen."""

    parent: SearchState
    body: int
    number: int
    spent: float  #: including the drive to the contact [units]
    reached: bool  #: whether the goal can be reached without it


@dataclass(frozen=True, slots=True, eq=False)
class _Push:
    """A queued push; its state is generated only when it is taken, because most pushes never are."""

    contact: _Contact
    length: float
    spent: float
    opens: bool
    priced: bool  #: whether ``spent`` includes the risk of the object rotating away
    refined: bool = False


@dataclass(slots=True)
class _Queue:
    """Open entries by estimated cost; entries that cannot improve on the best known plan are rejected."""

    best: float  #: cost of the best known plan [units]
    entries: list[tuple[float, int, SearchState | _Contact | _Push]] = field(default_factory=list)
    goal: SearchState | None = None  #: last state of this pass's best plan, before the drive to the goal
    pushed: int = 0  #: breaks ties: first in, first out

    def push(self, estimate: float, entry: SearchState | _Contact | _Push) -> None:
        if estimate < self.best:
            self.pushed += 1
            heapq.heappush(self.entries, (estimate, self.pushed, entry))


class PushPass:
    """One pass over the queue with a given heuristic weight.

    Parameters
    ----------
    heuristic
        Costs of pushes and lower bounds of the cost-to-go.
    weight
        Weight of the heuristic; with 1 the result bounds all plans of the model.
    limits
        Memory limit and maximum number of pushes.
    deadline
        Time limit.
    bodies
        Indices of the bodies that are pushed; by default all bodies of the heuristic.
    on_map
        Whether every drive has to exist on the map. On the lattice alone the bound is lower and found faster.
    relaxed
        Whether pushes are found on the relaxed lattice, so that the bound holds for drives beside the centres of cells, too.
    """

    def __init__(
        self,
        heuristic: PushHeuristic,
        weight: float,
        limits: SearchLimits,
        deadline: Deadline,
        bodies: Collection[int] | None = None,
        *,
        on_map: bool = True,
        relaxed: bool = False,
    ) -> None:
        self.on_map = on_map
        chosen = heuristic.active if bodies is None else list(bodies)
        self.pairs, self.stands = heuristic.stands(chosen)
        self.heuristic, self.weight, self.limits = heuristic, weight, limits
        self.deadline, self.domain = deadline, heuristic.domain
        #: with whose lattice pushes are found
        self.lattice = self.domain.relaxed if relaxed else self.domain
        #: least cost on the relaxed lattice of the plans that were looked for on the map, and of what was not found there [units]
        self.least = self.doubtful = float("inf")
        self.step = LENGTH_STEP_M / self.domain.map.resolution_m
        self.radius = (self.domain.robot.radius_m - CLEAR_SLACK_M) / self.domain.map.resolution_m
        self.seen = SeenFields(limits.memory_bytes // 4)
        self.queue = _Queue(float("inf"))
        self.start = np.zeros(2)

    def run(
        self, first: SearchState, expansions: int, known: float = float("inf"), gap: float = 0.0
    ) -> SearchResult:
        """Search until the best plan is within the gap, the queue is empty, or the budget is spent.

        Parameters
        ----------
        first
            Initial state.
        expansions
            Maximum number of expanded configurations.
        known
            Cost of the best known plan [units]; only cheaper plans are searched.
        gap
            Allowed difference between plan and bound, as a fraction of the bound.
        """
        units = self.heuristic.units / self.domain.block
        self.start = first.robot
        self.queue = queue = _Queue(known, [(0.0, 0, first)])
        expanded, bound, exhausted = 0, 0.0, True
        while queue.entries:
            if expanded >= expansions or self.deadline.passed:
                exhausted = False
                break
            estimate, _, entry = heapq.heappop(queue.entries)
            bound = max(bound, min(estimate, queue.best))
            if estimate * (1.0 + gap) >= queue.best:
                break
            if self.doubtful <= estimate and not self.domain.patient:
                exhausted = False
                break
            if isinstance(entry, _Contact):
                self._lengths(entry)
            elif isinstance(entry, _Push) and not entry.refined:
                self._refine(entry)
            elif isinstance(entry, _Push) and not entry.priced:
                # An oblique push is queued again with its simulated risk.
                contact, units = entry.contact, self.heuristic.push_units
                risk = units(contact.body, entry.length, contact.number) - units(contact.body, entry.length)
                queue.push(estimate + risk, replace(entry, spent=entry.spent + risk, priced=True))
            else:
                state = entry if isinstance(entry, SearchState) else _state(self.heuristic, entry)
                expanded += 1
                if self._exists(state):
                    self._expand(state)
                elif self.lattice.slack > 0.0:
                    self.doubtful = min(self.doubtful, estimate)
                exhausted = exhausted and state.depth < self.limits.pushes
        else:
            bound = queue.best
        narrow = self.doubtful < bound
        bound = min(bound, self.doubtful, self.least)
        if queue.goal is not None:
            steps = push_sequence(queue.goal)
            return SearchResult(True, steps, queue.best / units, bound / units, expanded, narrow)
        return SearchResult(False, (), float("inf"), bound / units, expanded, narrow, exhausted)

    def _exists(self, state: SearchState) -> bool:
        """Whether the drive to the last push also exists on the map."""
        step, parent = state.step, state.parent
        if not self.on_map or step is None or parent is None:
            return True
        return bool(np.isfinite(drive_cost(self.domain, parent.shifts, parent.robot, step.approach)))

    def _expand(self, state: SearchState) -> None:
        """Generate the drive to the goal and the contacts that the robot can reach."""

        domain, heuristic, queue = self.lattice, self.heuristic, self.queue
        clearance = domain.lattice_with(state.shifts)
        cells, costs = domain.seeds(clearance, state.robot, reach=1 if state.depth or domain.block > 1 else 2)
        if not cells.size or self.seen.dominated(state, cells):
            return
        most = int(min(queue.best - state.spent, heuristic.far))
        none = np.zeros(0, np.int32)
        cost = _travel_kernels.travel_field(
            clearance, domain.radius, domain.slow, cells, costs, heuristic.labels, heuristic.passing,
            heuristic.free_field if most < heuristic.far else none, most, none,
        )  # fmt: skip
        self.seen.add(state, cost)
        goal_cells, goal_costs = domain.seeds(clearance, domain.goal)
        reached = False
        if goal_cells.size:
            cheapest = int((cost[goal_cells].astype(np.int64) + goal_costs).min())
            reached = cheapest < heuristic.far and self._arrive(
                float(state.spent + cheapest), state, (cells, cost)
            )
        if not len(self.pairs) or state.depth >= self.limits.pushes:
            return
        bodies, numbers = self.pairs.T
        points = heuristic.centres[bodies] + state.shifts[bodies] + self.stands
        approach = reach_costs(clearance, cost, points, domain.radius, domain.slow, domain.block)
        usable = approach < heuristic.far
        # Interpolated clearance is never too low: a point with less than the radius is certainly in collision.
        usable &= clearances_at(domain.clearance, points) >= self.radius
        if (last := state.step) is not None and last.length < heuristic.longest(last.body) - 0.5:
            usable &= (bodies != last.body) | (numbers != last.contact)  # same as a longer push
        usable = np.flatnonzero(usable)
        if not len(usable):
            return
        spent = state.spent + approach[usable]
        left = self._left(state, bodies[usable], points[usable])
        estimates = spent + heuristic.least[bodies[usable]] + left * self.weight
        for i in np.flatnonzero(estimates < queue.best).tolist():
            body, number = int(bodies[usable[i]]), int(numbers[usable[i]])
            queue.push(float(estimates[i]), _Contact(state, body, number, float(spent[i]), reached))

    def _arrive(self, cost: float, state: SearchState, field: tuple[Nodes, Field]) -> bool:
        """A plan that ends with the drive from a state to the goal; accepted if it is better and exists on the map.

        Returns whether the drive exists; on the lattice alone passages appear wider by up to a cell.
        """
        best = self.queue.best
        if cost >= best:
            return True
        heuristic, steps = self.heuristic, push_sequence(state)
        units, pushes = heuristic.units / self.domain.block, heuristic.pushes_units(steps)
        if self.on_map:
            most = (best - pushes) / units
            known = field if self.lattice.slack > 0.0 else None
            optimistic, cost = cost, pushes + units * drives_cost(self.domain, steps, self.start, most, known)
            if known is not None:
                self.least = min(self.least, optimistic)
                if pushes + units * lattice_cost(self.domain, steps, self.start) > SAME * optimistic:
                    self.doubtful = min(self.doubtful, optimistic)
        if cost < best:
            self.queue.best, self.queue.goal = cost, state
        return cost < best or np.isfinite(best)

    def _left(self, state: SearchState, bodies: Field, ends: Path) -> Float[np.ndarray, "n"]:
        """Lower bounds of the cost-to-go after pushes that leave the robot at given points [units]."""
        heuristic = self.heuristic
        # The field of the new configuration is computed only for successors that are taken.
        charges = np.zeros(len(state.shifts))
        for body in set(bodies.tolist()):
            charges[body] = heuristic.crossing(body, state.shifts[body])
        relief = charges[bodies]
        field = heuristic.to_go(heuristic.field(state.shifts), ends)
        free = heuristic.to_go(heuristic.free_field, ends)
        return np.where(free >= heuristic.far, np.inf, np.maximum(field - relief, free))

    def _lengths(self, contact: _Contact) -> None:
        """Pushes with one contact, of collision-free lengths."""
        domain, heuristic, state = self.domain, self.heuristic, contact.parent
        shift = state.shifts[contact.body]
        push = heuristic.contacts(contact.body)[contact.number]
        none = push_step(heuristic, state.shifts, contact.body, contact.number, 0.0)
        if not stand_is_free(heuristic, none):
            return
        free, stand = free_length(heuristic, none, heuristic.longest(contact.body)), none.approach
        if free < 0.5:
            return
        others = np.arange(len(domain.bodies)) != contact.body
        opening = opening_at(self.lattice, state.shifts, contact.body, push.direction, free, stand, others)
        opens_at = float(opening.min()) if len(opening) else float("inf")
        lengths = np.array([n for n in self._tried(free, opening) if not contact.reached or n >= opens_at])
        if not len(lengths):
            return
        ends = stand + lengths[:, None] * push.direction
        left = self._left(state, np.full(len(lengths), contact.body), ends)
        free_left = heuristic.to_go(heuristic.free_field, ends)
        for length, to_go, driven in zip(lengths.tolist(), left.tolist(), free_left.tolist(), strict=True):
            opens = length >= opens_at
            paid = length
            if self.lattice.slack > 0.0:  # lengths between these steps are possible, too
                paid = min((o for o in opening if length - self.step < o <= length), default=length)
            spent = contact.spent + heuristic.push_units(contact.body, paid)
            if not opens and self.weight > 1.0:  # most likely, another push is needed
                to_go = max(to_go, driven + heuristic.min_any_push)
                to_go += heuristic.crossing(contact.body, shift)
            if domain.places is not None and self.weight > 1.0:  # most likely, it stays there
                after = state.shifts.copy()
                after[contact.body] = shift + length * push.direction
                to_go += heuristic.units_per_s * places_s(domain, after)
            entry = _Push(contact, length, spent, opens, not push.oblique)
            if np.isfinite(to_go):
                self.queue.push(spent + to_go * self.weight, entry)

    def _tried(self, free: float, opening: Float[np.ndarray, "k"]) -> list[float]:
        """Lengths to try for a push [cells], ascending."""
        step = self.step
        lengths = {n * step for n in LADDER if n * step <= free}
        lengths.add(free if free < step else np.floor(free / step + 1e-6) * step)
        for length in opening:
            first = np.ceil(length / step - 1e-6)
            lengths |= {(first + n) * step for n in EXTRA if (first + n) * step <= free}
            if first * step > free:
                lengths.add(free)
        return sorted(lengths)

    def _refine(self, entry: _Push) -> None:
        """Re-queue a push with the estimate of the configuration it leads to."""
        heuristic = self.heuristic
        state = _state(heuristic, entry)
        to_go = float(heuristic.to_go(heuristic.field(state.shifts, state.robot), state.robot[None])[0])
        if to_go < heuristic.far:
            self.queue.push(entry.spent + to_go * self.weight, replace(entry, refined=True))


def _state(heuristic: PushHeuristic, entry: _Push) -> SearchState:
    """The state that a push leads to."""
    contact = entry.contact
    parent = contact.parent
    step = push_step(heuristic, parent.shifts, contact.body, contact.number, entry.length)
    return SearchState(entry.spent, step.retreat, step.shifts_after, parent, step, parent.depth + 1)
