"""Cost-to-go of the search over pushes: an admissible lower bound of the remaining cost.

The bound is the cheapest path to the goal on which crossing the region covered by a pushable body costs at least its
shortest push. Where a single body separates start and goal, crossing its region costs the difference between the
cheapest plan with this body alone and the cheapest path without bodies (a pattern database).
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from jaxtyping import Int, UInt32

from ...problem.push_costs import PushCosts, push_cost
from ...pushing.contact_candidates import PushContact
from ..arrays import Clearance, Field, Labels, Nodes, Path, Point, Shifts
from ..place_costs import places_s
from . import _travel_kernels
from ._travel_kernels import FAR, UNITS, mark_region, reach_costs
from .push_ends import turn_probability
from .push_states import PushStep
from .search_domain import SearchDomain

#: Minimum useful length of a push [m].
MIN_PUSH_M = 0.01
#: Maximum number of nodes of cached fields.
MAX_FIELD_NODES = 50_000_000
#: Upper limit of the charge for crossing a body in the lower bound [s]: the queue of the field grows with it.
MAX_CROSSING_S = 60.0


class PushHeuristic:
    """Costs of pushes and lower bounds of the cost-to-go, in integer units of travel cost.

    Parameters
    ----------
    domain
        Static map and bodies.
    costs
        Cost model of the pushes.
    active
        Indices of the bodies that may be pushed; the others stay in place.
    left_out
        Pushable bodies that are not pushed: ignored in every bound.
    oblique
        Whether pushes may be oblique to a face.
    free
        Another heuristic of the same domain and goal; parts that do not depend on the bodies are shared with it.
    relaxed
        Whether the bound holds for drives beside the centres of cells, too. Otherwise it is only a guide to a first plan.
    """

    def __init__(
        self,
        domain: SearchDomain,
        costs: PushCosts,
        active: Collection[int],
        *,
        left_out: Collection[int] = (),
        oblique: bool = False,
        free: PushHeuristic | None = None,
        relaxed: bool = True,
    ) -> None:

        self.domain, self.costs = domain, costs
        self.lattice = domain.relaxed if relaxed else domain  #: on which cost-to-go is computed
        self.active, self.oblique = sorted(active), oblique
        self.far, self.units = int(FAR), int(UNITS)
        self.units_per_s = UNITS * domain.robot.v_max_m_s / (domain.map.resolution_m * domain.block)
        still = [i for i in range(len(domain.bodies)) if i not in {*self.active, *left_out}]
        zeros = np.zeros((len(domain.bodies), 2))
        #: without the pushable bodies
        self.base: Clearance = (
            free.base
            if free and free.lattice is self.lattice
            else self.lattice.lowered(self.lattice.lattice, zeros, still, domain.block)
        )
        self.stand_off = domain.robot.stand_off_m / domain.map.resolution_m
        self.centres: Shifts = np.array([body.centre for body in domain.bodies]).reshape(-1, 2)
        self._costs: dict[tuple[int, float, int], float] = (
            free._costs if free and free.domain is domain else {}
        )
        self.min_push = {i: self.shortest_push(i) for i in self.active}
        self.least = np.array([self.min_push.get(i, np.inf) for i in range(len(domain.bodies))])
        self.min_any_push = min(self.min_push.values(), default=float("inf"))
        self.alone = dict(self.min_push)  #: lower bounds of crossing each body at its mapped position [units]
        self.labels, self.passing = domain.labels(domain.block), domain.charges(domain.block)
        self.goal_cells, self.goal_costs = domain.seeds(self.base, domain.goal)
        self._fields: dict[bytes, Field] = {}
        self._marked: dict[tuple[int, ...], Labels] = {}
        #: sum of costs from the start and to the goal, with charges for bodies
        self._both: UInt32[np.ndarray, "r c"] | None = None
        #: cost from the start, cached [units]
        self.begin: Field | None = None
        self._begin: Field | None = None  # with the present charges
        self.limit = self.far  #: cost of a known plan [units]: more expensive nodes are not expanded
        #: cost-to-go when no pushable body is an obstacle [units]
        self.free_field: Field = free.free_field if free else self._field(zeros, [])

    def contacts(self, body: int) -> tuple[PushContact, ...]:
        """Stable pushes of a body.

        Parameters
        ----------
        body
            Index of the body.
        """
        found = self.domain.bodies[body]
        return found.with_oblique if self.oblique else found.contacts

    def stands(self, bodies: Collection[int]) -> tuple[Int[np.ndarray, "m 2"], Path]:
        """Body and contact of every push, and the robot's approach position relative to the body's centre [cells].

        Parameters
        ----------
        bodies
            Indices of the bodies to push.
        """
        pairs = [(i, number) for i in sorted(bodies) for number in range(len(self.contacts(i)))]
        pushes = [self.contacts(i)[number] for i, number in pairs]
        stands = [push.robot - self.stand_off * push.direction for push in pushes]
        return np.array(pairs, dtype=np.int64).reshape(-1, 2), np.array(stands).reshape(-1, 2)

    def raise_bound(self, body: int, units: float) -> None:
        """Increase the charge for crossing a body at its mapped position.

        Parameters
        ----------
        body
            Index of the body.
        units
            A lower bound of the crossing [units].
        """
        self.alone[body] = max(self.alone[body], units)
        self._fields.clear()
        self._both = self._begin = None

    def push_units(self, body: int, length: float, contact: int = -1) -> float:
        """``t_mani`` of a push [units]; infinite beyond the allowed length.

        Parameters
        ----------
        body
            Index of the body.
        length
            Length of the push [cells].
        contact
            Index of its contact, for the simulated risk of an oblique push; omitted by default, for a lower bound.
        """
        domain = self.domain
        oblique = contact >= 0 and contact >= len(domain.bodies[body].contacts)
        key = (body, round(length, 6), contact if oblique else -1)
        if key not in self._costs:
            tag, length_m = domain.bodies[body].obj.tag, length * domain.map.resolution_m
            turned = turn_probability(domain, body, contact, length) if oblique else 0.0
            cost = push_cost(tag, length_m, domain.robot, self.costs, turn_probability=turned)
            self._costs[key] = cost.total_s * self.units_per_s
        return self._costs[key]

    def pushes_units(self, steps: tuple[PushStep, ...]) -> float:
        """Cost of the pushes of a plan, and of the places where objects end [units].

        Parameters
        ----------
        steps
            Pushes in order.
        """
        pushes = sum(self.push_units(step.body, step.length, step.contact) for step in steps)
        return pushes + (self.units_per_s * places_s(self.domain, steps[-1].shifts_after) if steps else 0.0)

    def shortest_push(self, body: int) -> float:
        """Cost of the shortest push of a body [units].

        Parameters
        ----------
        body
            Index of the body.
        """
        return self.push_units(body, MIN_PUSH_M / self.domain.map.resolution_m)

    def longest(self, body: int) -> float:
        """The maximum push length that a body's tag allows [cells].

        Parameters
        ----------
        body
            Index of the body.
        """
        return self.domain.bodies[body].allowed.max_length_m / self.domain.map.resolution_m

    def separating(self, start: Nodes, bodies: Collection[int]) -> list[int]:
        """Bodies that, by themselves and at their mapped positions, separate the robot from the goal.

        Parameters
        ----------
        start
            Start nodes of the robot.
        bodies
            Indices of the bodies to test.
        """

        domain = self.lattice
        found = []
        for index in bodies:
            alone = domain.lowered(self.base, np.zeros((len(domain.bodies), 2)), [index], domain.block)
            cells, _ = domain.seeds(alone, domain.goal)
            if not _travel_kernels.flood(alone, domain.radius, cells, start)[start].any():
                found.append(index)
        return found

    def crossing(self, body: int, shift: Point) -> float:
        """Lower bound of the cost of crossing the region covered by a body [units].

        Parameters
        ----------
        body
            Index of the body.
        shift
            Displacement from its mapped position [cells].
        """
        return self.min_push[body] if shift.any() else self.alone[body]

    def field(self, shifts: Shifts, robot: Point | None = None) -> Field:
        """Lower bound of the cost-to-go from every node [units].

        Parameters
        ----------
        shifts
            Displacements of the bodies from their mapped positions [cells].
        robot
            The search ends when the cost there is known [cells]; farther nodes get the largest known cost.
        """
        key = shifts.tobytes()
        if key not in self._fields:
            if len(self._fields) * self.base.size > MAX_FIELD_NODES:
                self._fields.clear()
            # Cells that cannot lead to a better plan keep an infinite cost.
            known = self.begin if self.limit < self.far and not shifts.any() else None
            self._fields[key] = self._field(shifts, self.active, robot, rest=known)
        return self._fields[key]

    def _field(
        self,
        shifts: Shifts,
        bodies: Collection[int],
        robot: Point | None = None,
        seeds: tuple[Nodes, Nodes] | None = None,
        rest: Field | None = None,
    ) -> Field:

        domain = self.lattice
        moved = [index for index in bodies if shifts[index].any()]
        clearance = self.base
        if moved:
            clearance = domain.lowered(self.base, shifts, moved, domain.block)
            clearance = np.where(clearance < domain.radius, self.base, clearance)
        charges = [0.0 if i not in bodies else self.crossing(i, shifts[i]) for i in range(len(domain.bodies))]
        still = self._regions(tuple(index for index in bodies if index not in moved), shifts)
        region = self._regions(tuple(moved), shifts) if moved else still
        if moved:  # where regions overlap the cheaper push counts, so that the bound stays admissible
            region = np.where(region > 0, region, still)
        for index in bodies:
            if not np.isfinite(charges[index]):
                clearance = np.where(region == index + 1, np.float32(0.0), clearance)
                charges[index] = 0.0
        if self.labels.size:  # passages, where there is no body
            region = np.where((region == 0) & (self.labels > 0), self.labels + len(charges), region)
            charges += self.passing[1:].tolist()
        charge = np.minimum([0.0, *charges], MAX_CROSSING_S * self.units_per_s).astype(np.int32)
        none = near = np.zeros(0, np.int32)
        if robot is not None:
            near, _ = domain.seeds(self.base, robot)
        cost = _travel_kernels.travel_field(
            clearance, domain.radius, domain.slow, *(seeds or (self.goal_cells, self.goal_costs)),
            region, charge, none if rest is None else rest, self.limit, near,
        )  # fmt: skip
        if near.size and cost[near].max() < self.far:
            np.minimum(cost, np.where(self.free_field < self.far, cost[near].max(), self.far), out=cost)
        return cost

    def through(self, start: Nodes, body: int) -> float:
        """Lower bound of a plan that pushes a body: drive to the body, push it, and drive to the goal [units].

        Parameters
        ----------
        start
            Start nodes of the robot.
        body
            Index of the body.
        """
        domain, both = self.domain, self._from_start_to_goal(start)
        outline = domain.bodies[body].kept_clear
        grow = domain.radius + self.stand_off + 2.0 * domain.block
        c0, r0 = np.maximum((outline.min(axis=0) - grow) // domain.block, 0).astype(int)
        c1, r1 = ((outline.max(axis=0) + grow) // domain.block).astype(int) + 1
        near = both[r0:r1, c0:c1]
        if not near.size:
            return float("inf")
        through = near + self.shortest_push(body)
        if body in self.active:  # a path that crosses its region already includes the charge
            place = self._regions(tuple(self.active), np.zeros((len(domain.bodies), 2)))
            through = np.where(place[r0:r1, c0:c1] > 0, near, through)
        return float(through.min())

    def crossed(self, start: Nodes) -> list[int]:
        """Bodies whose regions are crossed by the cheapest path of the bound.

        Parameters
        ----------
        start
            Start nodes of the robot.
        """
        if not self.active:
            return []
        both, shifts = self._from_start_to_goal(start), np.zeros((len(self.domain.bodies), 2))
        region = self._regions(tuple(self.active), shifts)
        cheapest = np.full(len(self.domain.bodies) + 1, np.inf)
        inside = region > 0
        np.minimum.at(cheapest, region[inside], both[inside])
        at_most = 1.001 * both.min() + self.units  # both costs are integers, and diagonal steps are rounded
        return [k for k in self.active if cheapest[k + 1] <= at_most]

    def from_start(self, start: Nodes) -> Field:
        """Lower bound of the cost from the start to each node [units]: each body on the way costs at least its shortest push.

        Parameters
        ----------
        start
            Start nodes of the robot.
        """
        if self._begin is None:
            shifts, seeds = np.zeros((len(self.domain.bodies), 2)), (start, np.zeros_like(start))
            known = self.free_field if self.limit < self.far else None
            self.begin = self._begin = self._field(shifts, self.active, seeds=seeds, rest=known)
        return self._begin

    def _from_start_to_goal(self, start: Nodes) -> UInt32[np.ndarray, "r c"]:
        """Lower bound of a plan through each node."""
        if self._both is None:
            shifts, begin = np.zeros((len(self.domain.bodies), 2)), self.from_start(start)
            # Both fields add the charge where they leave a region: inside it, neither includes it yet.
            charges = [self.crossing(k, shifts[k]) if k in self.active else 0.0 for k in range(len(shifts))]
            charge = np.minimum([0.0, *charges], MAX_CROSSING_S * self.units_per_s).astype(np.uint32)
            # Without a sign, twice the largest cost fits 32 bits.
            both = begin.view(np.uint32) + self.field(shifts).view(np.uint32)
            self._both = both.reshape(self.base.shape)
            self._both += charge[self._regions(tuple(self.active), shifts)]
        return self._both

    def _regions(self, bodies: tuple[int, ...], shifts: Shifts) -> Labels:
        """Regions of some bodies on the lattice: index + 1, that of the cheapest body where regions overlap."""

        known = not shifts[list(bodies)].any()
        if known and bodies in self._marked:
            return self._marked[bodies]
        domain = self.domain
        region = np.zeros(self.base.shape, np.int16)
        for index in sorted(bodies, key=lambda k: self.crossing(k, shifts[k])):
            outline = domain.bodies[index].kept_clear + shifts[index]
            mark_region(region, outline, self.lattice.closed_below, index + 1, domain.block)
        if known:
            self._marked[bodies] = region
        return region

    def to_go(self, field: Field, points: Path) -> Int[np.ndarray, "m"]:
        """Values of a field at points between the nodes [units].

        Parameters
        ----------
        field
            From :meth:`field`.
        points
            Grid coordinates [cells].
        """

        domain = self.domain
        found: Int[np.ndarray, "m"] = reach_costs(
            self.base, field, points, domain.radius, domain.slow, domain.block
        )
        return found
