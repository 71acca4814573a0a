"""States of the search over pushes, its limits and results, and what it has expanded already."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32

__all__ = [
    "PushStep",
    "SearchLimits",
    "SearchPass",
    "SearchResult",
    "SearchState",
    "SeenFields",
    "Successor",
    "push_sequence",
    "seed_cells",
]


@dataclass(frozen=True, slots=True)
class SearchLimits:
    """How long to search, and for what."""

    expansions: int = 6000  #: configurations looked at before giving up
    pushes: int = 12  #: in one plan, at most
    opening_expansions: int = 120  #: of the pass that opens one passage after the other, for any plan at all
    first_expansions: int = 400  #: of the pass that looks for the cheapest plan
    #: weights (weighted A*) of the passes after it, which share the budget: cost at most so many times the optimum
    heuristic_weights: tuple[float, ...] = (2.0, 8.0)
    work_cells: int = 400_000_000  #: cells of travel fields computed before giving up: half a minute
    memory_cells: int = 40_000_000  #: cells of travel fields kept to recognise detours


@dataclass(frozen=True, slots=True)
class SearchPass:
    """What one pass over the queue prefers; by default all pushes, the cheapest plan first."""

    heuristic_weight: float = 1.0  #: of weighted A*; 1 keeps the heuristic admissible
    opening_first: bool = False  #: prefer pushes that connect anything the robot could not reach
    all_lengths: bool = True  #: also long pushes that open nothing


@dataclass(frozen=True, slots=True, eq=False)
class PushStep:
    """One push, in grid coordinates."""

    body: int
    contact: int  #: index into the body's contacts
    steps: int  #: whole cells
    shifts_before: Float[np.ndarray, "bodies 2"]
    shifts_after: Float[np.ndarray, "bodies 2"]
    approach: Float[np.ndarray, "2"]  #: the robot's centre, clear of the body
    touch: Float[np.ndarray, "2"]  #: the robot's centre at the contact
    retreat: Float[np.ndarray, "2"]


@dataclass(frozen=True, slots=True)
class SearchResult:
    """Pushes in order, or why there are none."""

    found: bool
    steps: tuple[PushStep, ...] = ()
    cost: float = float("inf")  #: estimate by the grid [cells at full speed]
    expanded: int = 0
    exhausted: bool = False  #: nothing was left to look at
    reason: str = ""


@dataclass(slots=True, eq=False)
class SearchState:
    """A node of the search: where every body and the robot are, and how they got there."""

    spent: float  #: cost from the start [units]
    robot: Float[np.ndarray, "2"]  #: centre [cells]
    shifts: Float[np.ndarray, "bodies 2"]  #: of the bodies from where the map has them [cells]
    pushed: int  #: bit mask of bodies
    parent: SearchState | None = None
    step: PushStep | None = None
    depth: int = 0
    opens: bool = True  #: whether the last push may have connected robot and goal
    refined: bool = True  #: whether its estimate is the best that we have
    left: float = 0.0  #: estimated cost-to-go [units]
    beyond: Bool[np.ndarray, "n"] | None = (
        None  #: of the opening pass: cells that the robot could not reach before
    )


@dataclass(frozen=True, slots=True, eq=False)
class Successor:
    """A push that waits in the queue; its state is generated only when it is taken, as most never are."""

    parent: SearchState
    body: int
    contact: int
    steps: int
    approach: Float[np.ndarray, "2"]
    touch: Float[np.ndarray, "2"]
    spent: float
    opens: bool
    refined: bool
    left: float
    beyond: Bool[np.ndarray, "n"] | None


@dataclass(slots=True, eq=False)
class SeenFields:
    """Travel costs in configurations that were expanded: what costs more than a drive there is not expanded again."""

    cells_left: int
    fields: dict[bytes, list[tuple[float, Int32[np.ndarray, "n"]]]] = field(default_factory=dict)

    def dominated(self, state: SearchState, cell: int) -> bool:
        """Whether another state of the same configuration reaches a cell at no higher cost.

        Parameters
        ----------
        state
            The state in question.
        cell
            Flat index of a cell beside its robot.
        """
        known = self.fields.get(_key(state.shifts), ())
        return any(spent + int(cost[cell]) <= state.spent + 1 for spent, cost in known)

    def add(self, state: SearchState, cost: Int32[np.ndarray, "n"]) -> None:
        """Keep the field of an expanded state while memory lasts.

        Parameters
        ----------
        state
            The state.
        cost
            Of driving from its robot to each cell [units].
        """
        if self.cells_left >= cost.size:
            self.cells_left -= cost.size
            self.fields.setdefault(_key(state.shifts), []).append((state.spent, cost))


def _key(shifts: Float[np.ndarray, "bodies 2"]) -> bytes:
    return np.rint(shifts * 4.0).astype(np.int16).tobytes()


def seed_cells(
    clearance: Float32[np.ndarray, "rows columns"],
    point: Float[np.ndarray, "2"],
    radius: float,
    slow: float,
    units: int,
    reach: int = 1,
) -> tuple[Int32[np.ndarray, "k"], Int32[np.ndarray, "k"]]:
    """Free cells around a point, and what it costs to move between them and the point [units].

    Parameters
    ----------
    clearance
        Distance to the nearest obstacle [cells].
    point
        Grid coordinates [cells].
    radius
        Of the robot [cells].
    slow
        Ratio of the maximum to the minimum speed.
    units
        Whole units of cost per cell at full speed.
    reach
        Half width of the window around the point's cell [cells].

    Returns
    -------
    Flat indices of the cells, and their costs.
    """
    rows, columns = clearance.shape
    c, r = int(np.floor(point[0])), int(np.floor(point[1]))
    r0, r1, c0, c1 = (
        max(r - reach, 0),
        min(r + reach + 1, rows),
        max(c - reach, 0),
        min(c + reach + 1, columns),
    )
    part = clearance[r0:r1, c0:c1]
    rr, cc = np.nonzero(part >= radius)
    d = part[rr, cc]
    rr, cc = rr + r0, cc + c0
    length = np.hypot(cc + 0.5 - point[0], rr + 0.5 - point[1])
    fraction = np.minimum((d / radius - 1.0) * 0.5, 1.0)
    cost = np.rint(length * (slow + fraction * (1.0 - slow)) * units)
    return (rr * columns + cc).astype(np.int32), cost.astype(np.int32)


def push_sequence(state: SearchState) -> tuple[PushStep, ...]:
    """Pushes from the start to a state, in order.

    Parameters
    ----------
    state
        Where the sequence ends.
    """
    steps: list[PushStep] = []
    at: SearchState | None = state
    while at is not None and at.step is not None:
        steps.append(at.step)
        at = at.parent
    return tuple(reversed(steps))
