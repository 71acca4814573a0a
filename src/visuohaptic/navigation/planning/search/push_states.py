"""States of the search over pushes, its limits and results, and the expanded configurations."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ....core.kernels import compiled_s
from ....core.ranges import NON_NEGATIVE, POSITIVE, check_ranges
from ..arrays import Field, Nodes, Point, Shifts

#: Limit of the wall time, as a multiple of the budget: a search may share its processor.
WALL_PER_CPU = 3.0


@dataclass(frozen=True, slots=True)
class Deadline:
    """The end of a budget, in CPU time and wall time: on a busy machine, results depend on the CPU time only.

    The compilation of kernels, in the first run on a machine, is not counted: the first run gives the same result as later ones.
    """

    cpu_s: float  #: CPU time of this thread without compilation
    wall_s: float  #: monotonic clock without compilation

    @classmethod
    def after(cls, budget_s: float) -> Deadline:
        """A budget from now on.

        Parameters
        ----------
        budget_s
            CPU time [s].
        """
        cpu_s, wall_s = _clocks_s()
        return cls(cpu_s + budget_s, wall_s + WALL_PER_CPU * budget_s)

    def earlier(self, seconds: float) -> Deadline:
        """The deadline for a part of the budget.

        Parameters
        ----------
        seconds
            Budget that remains after it [s].
        """
        return Deadline(self.cpu_s - seconds, self.wall_s - WALL_PER_CPU * seconds)

    @property
    def left_s(self) -> float:
        """Remaining budget [s]."""
        cpu_s, wall_s = _clocks_s()
        return min(self.cpu_s - cpu_s, (self.wall_s - wall_s) / WALL_PER_CPU)

    @property
    def passed(self) -> bool:
        """Whether the budget is spent."""
        return self.left_s < 0.0


def _clocks_s() -> tuple[float, float]:
    """CPU time of this thread and monotonic clock, both without the compilation of kernels [s]."""
    cpu_s, wall_s = compiled_s()
    return time.thread_time() - cpu_s, time.monotonic() - wall_s


@dataclass(frozen=True, slots=True)
class SearchLimits:
    """Limits of a search."""

    #: CPU time of one search; the wall time is limited to three times as much
    budget_s: float = field(default=2.0, metadata=POSITIVE)
    gap: float = field(default=0.05, metadata=NON_NEGATIVE)  #: end within this fraction of the bound
    memory_bytes: int = field(default=500_000_000, metadata=POSITIVE)  #: for expanded configurations
    expansions: int = field(default=100_000, metadata=POSITIVE)  #: maximum number of expanded configurations
    pushes: int = field(default=12, metadata=NON_NEGATIVE)  #: maximum number in one plan
    #: called with the first plan while better ones are searched; the search waits for it
    found: Callable[[Any], None] | None = None

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True, slots=True, eq=False)
class PushStep:
    """One push, in grid coordinates."""

    body: int
    contact: int  #: index into the body's contacts, the oblique ones last
    length: float  #: [cells]
    shifts_before: Shifts
    shifts_after: Shifts
    approach: Point  #: the robot's centre, clear of the body
    touch: Point  #: the robot's centre at the contact
    retreat: Point


@dataclass(frozen=True, slots=True)
class SearchResult:
    """Pushes in order, or the reason why there are none."""

    found: bool
    steps: tuple[PushStep, ...] = ()
    cost: float = float("inf")  #: lattice estimate [cells at full speed]
    bound: float = 0.0  #: lower bound of all plans of the model [cells at full speed]
    expanded: int = 0
    narrow: bool = False  #: whether the bound is that of what may exist beside the centres of cells
    exhausted: bool = False  #: whether it is proved that there is no plan
    reason: str = ""
    left_out: tuple[int, ...] = ()  #: bodies that touch no bottleneck between start and goal


@dataclass(slots=True, eq=False)
class SearchState:
    """A node of the search: positions of all bodies and of the robot, and the preceding pushes."""

    spent: float  #: cost from the start [units]
    robot: Point  #: centre [cells]
    shifts: Shifts  #: displacements of the bodies from their mapped positions [cells]
    parent: SearchState | None = None
    step: PushStep | None = None
    depth: int = 0


@dataclass(slots=True, eq=False)
class SeenFields:
    """Travel costs in expanded configurations, to prune states that are reached at a higher cost."""

    cells_left: int
    fields: dict[bytes, list[tuple[float, Field]]] = field(default_factory=dict)

    def dominated(self, state: SearchState, cells: Nodes) -> bool:
        """Whether another state of the same configuration reaches one of the cells at no higher cost.

        Parameters
        ----------
        state
            State to test.
        cells
            Flat indices of the cells next to its robot.
        """
        known = self.fields.get(_key(state.shifts), ())
        return any(spent + int(cost[cells].min()) <= state.spent + 1 for spent, cost in known)

    def add(self, state: SearchState, cost: Field) -> None:
        """Store the field of an expanded state until the memory limit is reached.

        Parameters
        ----------
        state
            The expanded state.
        cost
            Costs of driving from its robot to each cell [units].
        """
        if self.cells_left >= cost.size:
            self.cells_left -= cost.size
            self.fields.setdefault(_key(state.shifts), []).append((state.spent, cost))


def _key(shifts: Shifts) -> bytes:
    return np.rint(shifts * 4.0).astype(np.int32).tobytes()


def push_sequence(state: SearchState) -> tuple[PushStep, ...]:
    """Pushes from the start to a state, in order.

    Parameters
    ----------
    state
        Last state of the sequence.
    """
    steps: list[PushStep] = []
    at: SearchState | None = state
    while at is not None and at.step is not None:
        steps.append(at.step)
        at = at.parent
    return tuple(reversed(steps))


def needed_clearance(radius: float, spacing: float | None = None) -> float:
    """Clearance, interpolated at the samples of a segment, that guarantees the radius everywhere on the segment [cells].

    The curvature of the distance from an obstacle is at most 1 / distance: interpolated between cell centres it is too
    high by at most 1 / (8 distance), and between samples it may fall below both by spacing^2 / (8 distance). The
    last factor accounts for the next order.

    Parameters
    ----------
    radius
        Radius of the robot [cells].
    spacing
        Spacing of the samples [cells]; by default that of a drive.
    """
    spacing = max(0.5, radius / 7.0) if spacing is None else spacing
    return radius + (1.0 + spacing**2) / (8.0 * radius) * (1.0 + 1.0 / (8.0 * radius))


def full_speed_clearance(radius: float) -> float:
    """Clearance above which the robot drives at full speed, with a margin of one cell [cells].

    Parameters
    ----------
    radius
        Radius of the robot [cells].
    """
    return 3.0 * radius + 1.0
