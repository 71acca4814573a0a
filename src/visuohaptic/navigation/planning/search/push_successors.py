"""Successors of a state of the search: the pushes that the robot can reach, and how far each may go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32

from .push_heuristic import PushHeuristic
from .push_states import PushStep, SearchPass, SearchState, SeenFields, Successor, seed_cells

__all__ = ["SuccessorGenerator", "generate_state"]

#: The robot stands off by so many cells before and after a push.
STAND_OFF = 0.6
#: Where it stands off an object it may be nearer to an obstacle by so much [cells].
STAND_SLACK = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class _Expansion:
    """A state with what all its pushes have in common."""

    state: SearchState
    clearance: Float32[np.ndarray, "rows columns"]
    cost: Int32[np.ndarray, "n"]  #: of driving to each cell [units]
    beyond: Bool[np.ndarray, "n"] | None  #: cells worth connecting; none where the goal is reached already
    limit: float  #: cost of the best plan known [units]


@dataclass(frozen=True, slots=True, eq=False)
class _Obstacles:
    """Everything but the body that is pushed."""

    clearance: Float32[np.ndarray, "rows columns"]
    outlines: Float[np.ndarray, "v 2"]  #: of the other bodies, one after the other
    starts: Int32[np.ndarray, "o"]  #: where each begins
    samples: Float[np.ndarray, "k 2"]  #: points inside their edges


class SuccessorGenerator:
    """Expands states in one pass of the search.

    Parameters
    ----------
    heuristic
        Costs of pushes and lower bounds of the cost-to-go.
    settings
        What the pass prefers.
    """

    def __init__(self, heuristic: PushHeuristic, settings: SearchPass) -> None:
        self.heuristic, self.settings = heuristic, settings
        self._domain = heuristic.domain

    def expand(
        self, state: SearchState, best: float, seen: SeenFields
    ) -> tuple[float | None, list[tuple[float, Successor]]]:
        """Cost of driving to the goal now [units], and the successors with their estimates.

        Parameters
        ----------
        state
            The state to expand.
        best
            Cost of the best plan known [units]; what cannot be cheaper is left out.
        seen
            Fields of configurations expanded before; the state's is added.
        """
        from ._travel_kernels import flood, travel_field

        domain, heuristic = self._domain, self.heuristic
        clearance = domain.clearance_with(state.shifts)
        cells, costs = seed_cells(
            clearance, state.robot, domain.radius, domain.slow, heuristic.units, reach=1 if state.depth else 2
        )
        if not cells.size or any(seen.dominated(state, int(cell)) for cell in cells):
            return None, []
        bounded = np.isfinite(best)
        cost, _, _ = travel_field(
            clearance, domain.radius, domain.slow, cells, costs, np.zeros((0, 0), np.int32), np.zeros(0, np.int32),
            heuristic.field(state.pushed) if bounded else np.zeros(0, np.int32),
            int(best - state.spent) if bounded else 0,
        )  # fmt: skip
        seen.add(state, cost)
        goal_cells, goal_costs = heuristic.goal_seeds(clearance)
        finished = None
        if goal_cells.size:
            cheapest = int((cost[goal_cells].astype(np.int64) + goal_costs).min())
            if cheapest < heuristic.far:
                finished = state.spent + cheapest
        beyond = None
        if finished is None and self.settings.opening_first:
            # Anything that the robot cannot reach yet is worth opening: doors in series open one by one.
            beyond = (clearance.ravel() >= domain.radius) & (cost >= heuristic.far)
        elif finished is None:
            beyond = flood(clearance, domain.radius, goal_cells)
        limit = min(best, finished if finished is not None else np.inf)
        expansion = _Expansion(state, clearance, cost, beyond, limit)
        return finished, [
            one for index in range(len(domain.bodies)) for one in self._pushes(expansion, index)
        ]

    def _pushes(self, expansion: _Expansion, index: int) -> list[tuple[float, Successor]]:
        """Successors that push one body."""
        from ._travel_kernels import clearance_at, reach_cost

        domain, heuristic, state = self._domain, self.heuristic, expansion.state
        body, longest = domain.bodies[index], len(heuristic.push_costs[index]) - 1
        if longest < 1:
            return []
        obstacles: _Obstacles | None = None
        found: list[tuple[float, Successor]] = []
        for number, contact in enumerate(body.contacts):
            last = state.step
            if last is not None and (last.body, last.contact) == (index, number) and last.steps < longest:
                continue  # a longer push is the same
            approach_at = body.centre + state.shifts[index] + contact.robot - STAND_OFF * contact.direction
            # Its own body is where it has to be: what counts is everything else.
            if clearance_at(domain.clearance, approach_at[0], approach_at[1]) < domain.radius - STAND_SLACK:
                continue
            approach = reach_cost(
                expansion.clearance,
                expansion.cost,
                approach_at[0],
                approach_at[1],
                domain.radius,
                domain.slow,
            )
            table = heuristic.table(index, number)
            if approach >= heuristic.far or state.spent + approach + table[1] >= expansion.limit:
                continue
            if obstacles is None:
                obstacles = self._obstacles(state, index)
            if (
                clearance_at(obstacles.clearance, approach_at[0], approach_at[1])
                >= domain.radius - STAND_SLACK
            ):
                found += self._lengths(expansion, obstacles, index, number, state.spent + approach)
        return found

    def _lengths(
        self, expansion: _Expansion, obstacles: _Obstacles, index: int, number: int, spent_before: float
    ) -> list[tuple[float, Successor]]:
        """Successors by one contact, as far as the push is free of collisions."""
        from ._push_search_kernels import free_push_steps, opening_steps

        domain, heuristic, state = self._domain, self.heuristic, expansion.state
        body, shift = domain.bodies[index], state.shifts[index]
        contact, table = body.contacts[number], heuristic.table(index, number)
        touch = body.centre + shift + contact.robot
        approach_at = touch - STAND_OFF * contact.direction
        steps = free_push_steps(
            domain.occupied, obstacles.clearance, body.samples + shift, body.around + shift, body.outline + shift,
            obstacles.outlines, obstacles.starts, obstacles.samples, touch[0], touch[1],
            contact.direction[0], contact.direction[1], domain.radius, len(table) - 1,
        )  # fmt: skip
        if not steps:
            return []
        lengths = np.arange(1, steps + 1)
        opens = np.ones(steps + 1, dtype=bool)
        if expansion.beyond is not None:
            opens = opening_steps(
                obstacles.clearance, expansion.beyond, heuristic.goal_cells, body.outline + shift,
                contact.direction[0], contact.direction[1], domain.radius, steps,
            )  # fmt: skip
        left = self._cost_to_go(state, index, approach_at + lengths[:, None] * contact.direction, opens[1:])
        spent = spent_before + table[1 : steps + 1]
        estimate = spent + left * self.settings.heuristic_weight
        kept = (estimate < expansion.limit) & (left < heuristic.far) & self._tried(lengths, opens[1:])
        opening_first = self.settings.opening_first
        return [
            (
                float(estimate[i]),
                Successor(
                    state, index, number, int(lengths[i]), approach_at, touch, float(spent[i]), bool(opens[i + 1]),
                    opening_first and not opens[i + 1], float(left[i]), expansion.beyond if opening_first else None,
                ),
            )
            for i in np.flatnonzero(kept)
        ]  # fmt: skip

    def _cost_to_go(
        self, state: SearchState, index: int, ends: Float[np.ndarray, "n 2"], opens: Bool[np.ndarray, "n"]
    ) -> Float[np.ndarray, "n"]:
        """Lower bounds after pushes of one body that leave the robot at ``ends`` [units]."""
        heuristic, clearance = self.heuristic, self._domain.clearance
        # The field of the new set of pushed bodies is computed for those successors only that are taken.
        field, free = heuristic.field(state.pushed), heuristic.free_field
        relief = 0.0 if state.pushed >> index & 1 else heuristic.crossing[index]
        cells = np.floor(ends).astype(np.int64)
        at = cells[:, 1] * clearance.shape[1] + cells[:, 0]
        near_wall = clearance.ravel()[at] < self._domain.radius
        left = np.maximum(field[at] - relief, free[at])
        left[near_wall] = 0.0
        if self.settings.opening_first:
            return np.where(opens, left, left + max(relief, heuristic.min_push[index]))
        return np.where(opens, left, np.maximum(left, free[at] * ~near_wall + heuristic.min_any_push))

    def _tried(self, lengths: Int32[np.ndarray, "n"], opens: Bool[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
        """Which lengths this pass tries."""
        if self.settings.opening_first:
            first = int(opens.argmax()) if opens.any() else len(lengths)
            return (lengths - 1 == first) | (lengths - 1 == first + 2) | (lengths % 6 == 0)
        if not self.settings.all_lengths:
            return opens | (lengths <= 6) | (lengths % 4 == 0)
        return np.ones(len(lengths), dtype=bool)

    def _obstacles(self, state: SearchState, index: int) -> _Obstacles:
        clearance = self._domain.clearance_with(state.shifts, index)
        others = [(body, state.shifts[k]) for k, body in enumerate(self._domain.bodies) if k != index]
        if not others:
            return _Obstacles(clearance, np.zeros((0, 2)), np.zeros(1, np.int32), np.zeros((0, 2)))
        outlines = [body.outline + shift for body, shift in others]
        return _Obstacles(
            clearance,
            np.concatenate(outlines),
            np.cumsum([0, *(len(outline) for outline in outlines)]).astype(np.int32),
            np.concatenate([body.samples + shift for body, shift in others]),
        )


def generate_state(heuristic: PushHeuristic, successor: Successor) -> SearchState:
    """The state that a successor taken from the queue stands for.

    Parameters
    ----------
    heuristic
        Of the search, for its domain.
    successor
        The push.
    """
    parent = successor.parent
    direction = heuristic.domain.bodies[successor.body].contacts[successor.contact].direction
    after = parent.shifts.copy()
    after[successor.body] = parent.shifts[successor.body] + successor.steps * direction
    robot = successor.approach + successor.steps * direction
    step = PushStep(
        successor.body, successor.contact, successor.steps, parent.shifts, after,
        successor.approach, successor.touch, robot,
    )  # fmt: skip
    return SearchState(
        successor.spent, robot, after, parent.pushed | 1 << successor.body, parent, step,
        parent.depth + 1, successor.opens, successor.refined, successor.left, successor.beyond,
    )  # fmt: skip
