"""Proofs that no sequence of pushes clears a path, by search over (component of the robot, places of a few bodies).

Leaving bodies out only helps: a plan among all of them, without the pushes of those left out, is a plan among the
rest. So where one body alone, or two, cannot be brought out of the way from any component that the robot gets to,
there is no plan. Costs do not matter, only what is connected; pushes go by short steps, one after the other.
"""

from __future__ import annotations

import time
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int32

from .push_heuristic import PushHeuristic
from .push_states import SearchLimits, SearchState, seed_cells

__all__ = ["Infeasibility"]

#: Bodies looked at together, at most.
MAX_TOGETHER = 3
#: Pushes go by steps of this [m].
STEP_M = 0.05


class Infeasibility:
    """Searches for a proof that there is no plan.

    Parameters
    ----------
    heuristic
        Of the search, for its domain, contacts and goal.
    limits
        Memory.
    deadline_s
        When to stop, on the monotonic clock.
    """

    def __init__(self, heuristic: PushHeuristic, limits: SearchLimits, deadline_s: float) -> None:
        self.heuristic, self.domain, self.deadline_s = heuristic, heuristic.domain, deadline_s
        # A push is followed in half cells.
        self.step = max(STEP_M / self.domain.map.resolution_m, 0.5)
        self.max_states = limits.memory_bytes // 1000

    def prove(self, first: SearchState, cells: Int32[np.ndarray, "k"]) -> str:
        """Why there is no plan; empty where that is not proved.

        Parameters
        ----------
        first
            Where everything is at the start.
        cells
            Nodes of the lattice that the robot can be on at the start.
        """
        for count in range(1, MAX_TOGETHER + 1):
            for chosen in combinations(self.heuristic.active, count):
                if time.monotonic() > self.deadline_s:
                    return ""
                if self._blocked(chosen, first, cells):
                    names = " and ".join(self.domain.bodies[i].obj.id for i in chosen)
                    return f"no sequence of straight pushes brings {names} out of the way"
        return ""

    def _blocked(self, chosen: tuple[int, ...], first: SearchState, cells: Int32[np.ndarray, "k"]) -> bool:
        """Whether some bodies keep the robot from the goal, whatever is done to them, all others away."""
        open_states: list[tuple[Float[np.ndarray, "bodies 2"], Int32[np.ndarray, "k"]]] = [
            (first.shifts, cells)
        ]
        seen: set[tuple[bytes, int]] = set()
        while open_states:
            if time.monotonic() > self.deadline_s or len(seen) > self.max_states:
                return False
            shifts, near = open_states.pop()
            reached = self._component(chosen, shifts, near)
            if reached is None:
                continue
            key = (np.rint(shifts[list(chosen)] * 8).astype(np.int32).tobytes(), int(reached.argmax()))
            if key in seen:
                continue
            seen.add(key)
            goal_cells, _ = self.heuristic.goal_seeds(self._clearance(chosen, shifts))
            if goal_cells.size and reached[goal_cells].any():
                return False
            open_states += self._after_pushes(chosen, shifts, reached)
        return True

    def _clearance(self, chosen: tuple[int, ...], shifts: Float[np.ndarray, "bodies 2"]) -> np.ndarray:
        domain = self.domain
        return domain.lowered(self.heuristic.base, shifts, chosen, domain.block)

    def _component(
        self, chosen: tuple[int, ...], shifts: Float[np.ndarray, "bodies 2"], near: Int32[np.ndarray, "k"]
    ) -> Bool[np.ndarray, "n"] | None:
        """Nodes that the robot gets to."""
        from ._travel_kernels import flood

        domain = self.domain
        clearance = self._clearance(chosen, shifts)
        near = near[clearance.ravel()[near] >= domain.radius]
        return flood(clearance, domain.radius, near) if near.size else None

    def _after_pushes(
        self, chosen: tuple[int, ...], shifts: Float[np.ndarray, "bodies 2"], reached: Bool[np.ndarray, "n"]
    ) -> list[tuple[Float[np.ndarray, "bodies 2"], Int32[np.ndarray, "k"]]]:
        """Configurations one step on, with nodes beside the robot."""
        from ._push_search_kernels import free_push_length
        from ._travel_kernels import UNITS

        domain, heuristic = self.domain, self.heuristic
        clearance = self._clearance(chosen, shifts)
        found = []
        for index in chosen:
            body, shift = domain.bodies[index], shifts[index]
            others = [domain.bodies[k].outline + shifts[k] for k in chosen if k != index]
            outlines = [*others, *domain.immovable_outlines]
            starts = np.cumsum([0, *(len(outline) for outline in outlines)]).astype(np.int32)
            joined = np.concatenate(outlines) if outlines else np.zeros((0, 2))
            for push in heuristic.contacts[index]:
                touch = body.centre + shift + push.robot
                stand = touch - heuristic.stand_off * push.direction
                near, _ = seed_cells(
                    clearance, stand, domain.radius, domain.slow, UNITS, reach=1, block=domain.block
                )
                if not near.size or not reached[near].any():
                    continue
                free = free_push_length(
                    domain.occupied, domain.clearance, body.samples + shift, body.around + shift,
                    body.outline + shift, joined, starts, touch[0], touch[1],
                    push.direction[0], push.direction[1], domain.radius, self.step,
                )  # fmt: skip
                if free <= 0.0:
                    continue
                after = shifts.copy()
                after[index] = shift + free * push.direction
                ends, _ = seed_cells(
                    self._clearance(chosen, after), stand + free * push.direction, domain.radius, domain.slow,
                    UNITS, reach=1, block=domain.block,
                )  # fmt: skip
                found.append((after, ends))
        return found
