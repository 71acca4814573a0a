"""Infeasibility proofs, by search over (connected component of the robot, positions of a few bodies).

Leaving bodies out is a relaxation: a plan among all bodies, without the pushes of those left out, is also a plan among
the remaining ones. If one body alone, or two or three, cannot be pushed clear from any component that the robot can
reach, there is no plan. Only connectivity matters, not costs; pushes are sequences of short steps.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from ..arrays import Clearance, Nodes, Path, Point, Shifts
from . import _travel_kernels
from ._travel_kernels import FAR, reach_costs
from .push_heuristic import PushHeuristic
from .push_lengths import LENGTH_STEP_M, free_length, push_step
from .push_states import Deadline, SearchLimits, SearchState

#: Maximum number of bodies that are considered jointly.
MAX_TOGETHER = 3


class Infeasibility:
    """Search for a proof that no plan exists.

    Parameters
    ----------
    heuristic
        Heuristic of the search, with its domain, contacts and goal.
    limits
        Memory limit.
    deadline
        Time limit.
    """

    def __init__(self, heuristic: PushHeuristic, limits: SearchLimits, deadline: Deadline) -> None:
        self.heuristic, self.domain, self.deadline = heuristic, heuristic.lattice, deadline
        # Pushes are checked in steps of half a cell.
        self.step = max(LENGTH_STEP_M / self.domain.map.resolution_m, 0.5)
        self.max_states = limits.memory_bytes // 1000

    def prove(self, first: SearchState, cells: Nodes) -> str:
        """The reason why no plan exists; empty if this is not proved.

        Parameters
        ----------
        first
            Initial state.
        cells
            Lattice nodes that the robot can occupy at the start.
        """
        kind = "straight or oblique" if self.heuristic.oblique else "straight"
        for count in range(1, MAX_TOGETHER + 1):
            for chosen in combinations(self.heuristic.active, count):
                if self.deadline.passed:
                    return ""
                if self._blocked(chosen, first, cells):
                    names = " and ".join(self.domain.bodies[i].obj.id for i in chosen)
                    return f"no sequence of {kind} pushes moves {names} out of the way"
        return ""

    def _blocked(self, chosen: tuple[int, ...], first: SearchState, cells: Nodes) -> bool:
        """Whether some bodies keep the robot from the goal wherever they are pushed, with all others removed."""
        open_states: list[Any] = [(first.shifts, cells, None)]  # positions, nodes or position of the robot
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
            reached = _travel_kernels.flood(clearance, domain.radius, near, near[:0])
            key = (self._places(chosen, shifts), int(reached.argmax()))
            if key in seen:
                continue
            seen.add(key)
            goal_cells, _ = domain.seeds(clearance, domain.goal)
            if goal_cells.size and reached[goal_cells].any():
                return False
            for after, robot in self._after_pushes(chosen, shifts, clearance, reached, pushes):
                node = np.floor(robot / domain.block).astype(np.int32)
                place = self._places(chosen, after) + node.tobytes()
                if place not in queued:
                    queued.add(place)
                    open_states.append((after, None, robot))
        return True

    def _places(self, chosen: tuple[int, ...], shifts: Shifts) -> bytes:
        """Positions of the bodies, quantized to half a step."""
        return np.rint(shifts[list(chosen)] * (2.0 / self.step)).astype(np.int32).tobytes()

    def _after_pushes(
        self,
        chosen: tuple[int, ...],
        shifts: Shifts,
        clearance: Clearance,
        reached: Bool[np.ndarray, "n"],
        pushes: tuple[Int[np.ndarray, "m 2"], Path],
    ) -> Iterator[tuple[Shifts, Point]]:
        """Configurations after one push step, and the positions of the robot."""

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
