"""Cost-to-go of the search over pushes: an admissible lower bound of what is left to the goal.

The bound is the cheapest path to the goal through a map without the bodies, on which entering the place of a body
that was not pushed yet costs at least its shortest push: the shortest that clears a passage where the body alone
closes it, or two short ones. It never exceeds the true cost, so that the first solution that A* takes from its queue
is the cheapest of the model.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32, Int32

from ...problem.push_costs import PushCosts, push_cost
from .push_states import SearchState, seed_cells
from .search_domain import Body, SearchDomain

__all__ = ["PushHeuristic"]

#: On the goal the robot may be nearer to an obstacle by so much, the rounding of cells [cells].
GOAL_SLACK = 0.25
#: More than this the lower bound does not charge for crossing a body [s]: the queue of the field grows with it.
MAX_CROSSING_S = 60.0


class PushHeuristic:
    """Costs of pushes and lower bounds of the cost-to-go, in whole units of travel cost.

    Parameters
    ----------
    domain
        Static map and bodies.
    goal
        Grid coordinates of the goal [cells].
    costs
        What a push costs.
    """

    def __init__(self, domain: SearchDomain, goal: Float[np.ndarray, "2"], costs: PushCosts) -> None:
        from ._travel_kernels import FAR, UNITS

        self.domain, self.goal, self.costs = domain, goal, costs
        self.far, self.units = int(FAR), int(UNITS)
        self.units_per_s = UNITS * domain.robot.v_max_m_s / domain.map.resolution_m
        self.push_costs = [self._table(body, oblique=False) for body in domain.bodies]
        self.oblique_costs = [self._table(body, oblique=True) for body in domain.bodies]
        self.min_push = [float(table.min()) for table in self.push_costs]
        self.min_any_push = min(self.min_push, default=float("inf"))
        self.crossing = [0.0] * len(domain.bodies)  # lower bounds of crossing the place of each body
        self.goal_cells, self.goal_costs = self.goal_seeds(domain.clearance)
        self._fields: dict[int, Int32[np.ndarray, "n"]] = {}

    def _table(self, body: Body, *, oblique: bool) -> Float[np.ndarray, "steps"]:
        """``t_mani`` [units] by whole cells, from 0; infinite beyond what is allowed."""
        resolution_m = self.domain.map.resolution_m
        longest = int(body.allowed.longest_m / resolution_m + 1e-9) if body.contacts else 0
        table = [np.inf]
        for steps in range(1, longest + 1):
            cost = push_cost(
                body.obj.tag, steps * resolution_m, self.domain.robot, self.costs, oblique=oblique
            )
            table.append(cost.total_s * self.units_per_s)
        return np.array(table)

    def table(self, body: int, contact: int) -> Float[np.ndarray, "steps"]:
        """Cost of a push by its length in whole cells, from 0 [units].

        Parameters
        ----------
        body, contact
            Index of the body, and of the contact on it.
        """
        oblique = self.domain.bodies[body].contacts[contact].oblique
        return (self.oblique_costs if oblique else self.push_costs)[body]

    def goal_seeds(
        self, clearance: Float32[np.ndarray, "rows columns"]
    ) -> tuple[Int32[np.ndarray, "k"], Int32[np.ndarray, "k"]]:
        """Free cells around the goal and their cost to it [units]; none when the robot does not fit on the goal.

        Parameters
        ----------
        clearance
            Distance to the nearest obstacle [cells].
        """
        from ._travel_kernels import clearance_at

        if clearance_at(clearance, self.goal[0], self.goal[1]) < self.domain.radius - GOAL_SLACK:
            return np.zeros(0, np.int32), np.zeros(0, np.int32)
        return seed_cells(clearance, self.goal, self.domain.radius, self.domain.slow, self.units)

    def bound_crossings(self, start: Int32[np.ndarray, "k"]) -> None:
        """Bound from below what crossing the place of each body costs while it was not pushed.

        Parameters
        ----------
        start
            Flat indices of the cells that the robot starts from.
        """
        from ._push_search_kernels import opening_steps
        from ._travel_kernels import flood

        domain = self.domain
        self.crossing = list(self.min_push)
        for index, body in enumerate(domain.bodies):
            if not np.isfinite(self.min_push[index]):
                continue
            alone = domain.clearance_of(index, np.zeros(2))
            beyond = flood(alone, domain.radius, self.goal_cells)
            if beyond[start].any():
                continue
            bound = 2.0 * self.min_push[index]
            for number, contact in enumerate(body.contacts):
                table = self.table(index, number)
                opens = opening_steps(
                    domain.clearance, beyond, self.goal_cells, body.outline,
                    contact.direction[0], contact.direction[1], domain.radius, len(table) - 1,
                )  # fmt: skip
                if opens.any():
                    bound = min(bound, float(table[int(opens.argmax())]))
            self.crossing[index] = max(bound, self.min_push[index])

    @property
    def free_field(self) -> Int32[np.ndarray, "n"]:
        """Cost-to-go from every cell when every body has been pushed [units]."""
        return self.field((1 << len(self.domain.bodies)) - 1)

    def field(self, pushed: int) -> Int32[np.ndarray, "n"]:
        """Lower bound of the cost-to-go from every cell [units].

        Parameters
        ----------
        pushed
            Bit mask of the bodies that were pushed before; their places may be crossed for nothing.
        """
        from ._travel_kernels import mark_region, travel_field

        if pushed not in self._fields:
            domain = self.domain
            region = np.zeros(domain.clearance.shape, np.int16)
            charge = np.zeros(len(domain.bodies) + 1, np.int32)
            # Where places overlap the cheapest push counts: a bound must not be too high.
            order = sorted(range(len(domain.bodies)), key=lambda k: self.crossing[k])
            for index in order:
                if not pushed >> index & 1:
                    mark_region(region, domain.bodies[index].outline, domain.radius, index + 1)
                    charge[index + 1] = int(min(self.crossing[index], MAX_CROSSING_S * self.units_per_s))
            blocked = [
                i + 1 for i, cost in enumerate(self.min_push) if not np.isfinite(cost) and not pushed >> i & 1
            ]
            clearance = domain.clearance
            if blocked:
                clearance = np.where(np.isin(region, blocked), np.float32(0.0), clearance)
                charge[blocked] = 0
            self._fields[pushed] = travel_field(
                clearance, domain.radius, domain.slow, self.goal_cells, self.goal_costs,
                region, charge, np.zeros((0, 0), np.int32), 0,
            )[0]  # fmt: skip
        return self._fields[pushed]

    def after_push(self, state: SearchState) -> float:
        """Lower bound of the cost-to-go after the last push of a state [units]; infinite where the goal is cut off.

        Parameters
        ----------
        state
            A state that a push led to.
        """
        domain = self.domain
        near, extra = seed_cells(domain.clearance, state.robot, domain.radius, domain.slow, self.units)
        if not near.size:
            return float("inf")
        left = float((self.field(state.pushed)[near].astype(np.int64) + extra).min())
        if left >= self.far:
            return float("inf")
        if not state.opens:  # another push has to follow
            left = max(
                left, float((self.free_field[near].astype(np.int64) + extra).min()) + self.min_any_push
            )
        return left
