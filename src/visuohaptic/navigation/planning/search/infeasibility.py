"""Proofs that no sequence of pushes clears a path, by search over (component of the robot, places of a few bodies).

Leaving bodies out only helps: a plan among all of them, without the pushes of those left out, is a plan among the
rest. So where one body alone, or two, cannot be brought out of the way from any component that the robot gets to,
there is no plan. Costs do not matter, only what is connected; pushes go by short steps, one after the other.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Int32

from . import _travel_kernels
from ._travel_kernels import FAR, reach_costs
from .push_heuristic import PushHeuristic
from .push_lengths import free_length, push_step
from .push_states import Deadline, SearchLimits, SearchState

__all__ = ["Infeasibility"]

#: Maximum number of bodies that are considered together.
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
    deadline
        When to stop.
    """

    def __init__(self, heuristic: PushHeuristic, limits: SearchLimits, deadline: Deadline) -> None:
        self.heuristic, self.domain, self.deadline = heuristic, heuristic.domain, deadline
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
                if self.deadline.passed:
                    return ""
                if self._blocked(chosen, first, cells):
                    names = " and ".join(self.domain.bodies[i].obj.id for i in chosen)
                    return f"no sequence of straight pushes brings {names} out of the way"
        return ""

    def _blocked(self, chosen: tuple[int, ...], first: SearchState, cells: Int32[np.ndarray, "k"]) -> bool:
        """Whether some bodies keep the robot from the goal, whatever is done to them, all others away."""
        open_states: list[Any] = [(first.shifts, cells, None)]  # places, nodes or place of the robot
        domain, heuristic = self.domain, self.heuristic
        queued: set[bytes] = set()
        seen: set[tuple[bytes, int]] = set()
        pushes = heuristic.stands(chosen)
        while open_states:
            if self.deadline.passed or len(seen) > self.max_states:
                return False
            shifts, near, robot = open_states.pop()
            clearance = domain.lowered(heuristic.base, shifts, chosen, domain.block)
            if near is None:
                near, _ = domain.seeds(clearance, robot)
            near = near[clearance.ravel()[near] >= domain.radius]
            if not near.size:
                continue
            reached = _travel_kernels.flood(clearance, domain.radius, near)
            key = (self._places(chosen, shifts), int(reached.argmax()))
            if key in seen:
                continue
            seen.add(key)
            goal_cells, _ = heuristic.goal_seeds(clearance)
            if goal_cells.size and reached[goal_cells].any():
                return False
            for after, robot in self._after_pushes(chosen, shifts, clearance, reached, pushes):
                node = np.floor(robot / domain.block).astype(np.int32)
                place = self._places(chosen, after) + node.tobytes()
                if place not in queued:
                    queued.add(place)
                    open_states.append((after, None, robot))
        return True

    def _places(self, chosen: tuple[int, ...], shifts: Float[np.ndarray, "bodies 2"]) -> bytes:
        """Places of the bodies; closer than half a step they are one."""
        return np.rint(shifts[list(chosen)] * (2.0 / self.step)).astype(np.int32).tobytes()

    def _after_pushes(
        self,
        chosen: tuple[int, ...],
        shifts: Float[np.ndarray, "bodies 2"],
        clearance: Float32[np.ndarray, "r c"],
        reached: Bool[np.ndarray, "n"],
        pushes: tuple[Int[np.ndarray, "m 2"], Float[np.ndarray, "m 2"]],
    ) -> Iterator[tuple[Float[np.ndarray, "bodies 2"], Float[np.ndarray, "2"]]]:
        """Configurations one step on, and where the robot is."""

        domain, heuristic = self.domain, self.heuristic
        bodies, numbers = pushes[0].T
        stands = heuristic.centres[bodies] + shifts[bodies] + pushes[1]
        field = np.where(reached, 0, FAR).astype(np.int32)
        near = reach_costs(clearance, field, stands, domain.radius, domain.slow, domain.block) < FAR
        among = np.zeros(len(shifts), dtype=bool)
        among[list(chosen)] = True
        for k in np.flatnonzero(near).tolist():
            index, number = int(bodies[k]), int(numbers[k])
            none = push_step(heuristic, shifts, index, number, 0.0)
            free = free_length(heuristic, none, self.step, among)
            if free > 0.0:
                pushed = push_step(heuristic, shifts, index, number, free)
                yield pushed.shifts_after, pushed.retreat
