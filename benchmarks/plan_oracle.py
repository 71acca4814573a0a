"""Exact search of small problems: every place of the robot times every place of one or two objects.

It judges the planner, and has in common with the planner
what a push costs and where an object may be touched, and nothing of its
search: Dijkstra over the whole product of robot cells and object places, with
straight pushes along the grid's axes by whole cells. Where its queue runs
empty, there is no plan of that kind. Objects oblique to the grid have no such pushes.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32

from visuohaptic.core.errors import InputError
from visuohaptic.navigation.planning.search.bodies import Body, lower_clearance
from visuohaptic.navigation.planning.search.domain_builder import build_search_domain
from visuohaptic.navigation.planning.search.object_cells import fill_cells
from visuohaptic.navigation.planning.search.push_pass import STAND_SLACK
from visuohaptic.navigation.planning.search.push_states import seed_cells
from visuohaptic.navigation.planning.search.search_domain import (
    SearchDomain,
    grid_from_world,
)
from visuohaptic.navigation.problem.planning_problem import PlanningProblem
from visuohaptic.navigation.problem.push_costs import PushCosts, push_cost
from visuohaptic.navigation.pushing.contact_candidates import PushContact

__all__ = ["GridOptimum", "solve_exact"]

#: The robot stands off by so much before and after a push [m].
STAND_OFF_M = 0.03
#: States that fit: 4 bytes each.
MAX_STATES = 150_000_000


@dataclass(frozen=True, slots=True)
class GridOptimum:
    """The optimum on the grid."""

    reachable: bool
    cost_s: float  #: infinite without a plan
    states: int  #: settled


@dataclass(frozen=True, slots=True, eq=False)
class _Links:
    """How the robot gets to a push, and what the push does, by push (several) and place of the body."""

    cells: Int32[np.ndarray, "*pushes q 9"]  #: around the approach pose, -1 where there is none
    cost: Int32[np.ndarray, "*pushes q 9"]  #: from those to the approach pose [units]
    next: Int32[np.ndarray, "*pushes q"]  #: place one cell on, -1 where there is none
    free: Bool[np.ndarray, "*pushes q"]  #: whether the robot fits at the contact


@dataclass(frozen=True, slots=True, eq=False)
class _Places:
    """Where one body may be: whole-cell shifts at which it covers no occupied cell."""

    shifts: Int32[np.ndarray, "q 2"]
    index: Int32[np.ndarray, "rows columns"]  #: place by shift - lowest shift, -1 where there is none
    low: Int32[np.ndarray, "2"]


def _on_axes(contact: PushContact) -> bool:
    return float(np.abs(contact.direction).max()) > 1 - 1e-9


def solve_exact(problem: PlanningProblem, costs: PushCosts | None = None) -> GridOptimum:
    """The cheapest plan with pushes along the axes, by Dijkstra over every state.

    Parameters
    ----------
    problem
        Map, objects, robot, start and goal.
    costs
        What a push costs.

    Raises
    ------
    InputError
        More than two objects that can be pushed, or more states than fit.
    """
    from visuohaptic.navigation.planning.search._travel_kernels import UNITS

    from ._plan_oracle_kernels import NEVER, product_search

    costs = costs or PushCosts()
    domain = build_search_domain(problem, costs)
    if len(domain.bodies) > 2:
        raise InputError(
            "solve_exact", f"found {len(domain.bodies)} objects that can be pushed, expected at most 2"
        )
    for outline in domain.immovable_outlines:
        fill_cells(domain.occupied, outline)
    columns = domain.clearance.shape[1]
    start, goal = (grid_from_world(problem.map, p) for p in (problem.start_m, problem.goal_m))
    number = np.full(domain.clearance.size, -1, np.int32)
    fits = np.flatnonzero(domain.clearance.ravel() >= domain.radius)
    number[fits] = np.arange(len(fits), dtype=np.int32)
    places = [_places(domain, body) for body in domain.bodies]
    counts = np.array([len(place.shifts) for place in places], dtype=np.int64)
    pushes = [
        (b, contact) for b, body in enumerate(domain.bodies) for contact in body.contacts if _on_axes(contact)
    ]
    states = int(np.prod(counts)) * (len(fits) + len(pushes))
    if states > MAX_STATES:
        raise InputError("solve_exact", f"found {states} states, expected at most {MAX_STATES}")
    blocks, blocks_start = _blocks(domain, places, number)
    links = _push_links(domain, places, pushes, number)
    tables = _push_costs(domain, problem, costs, [b for b, _ in pushes])
    moves = _moves(domain, number, fits)
    cells, start_cost = _cells_at(domain, domain.clearance_with(np.zeros((len(places), 2))), start, 2)
    ends, end_cost = _cells_at(domain, domain.clearance, goal, 1)
    if not cells.size or not ends.size:
        return GridOptimum(False, float("inf"), 0)
    home = np.array([int(place.index[-place.low[1], -place.low[0]]) for place in places], dtype=np.int64)
    near, near_low, shifts = _near(domain, places)
    cost, settled = product_search(
        *moves, *np.divmod(fits, columns), domain.clearance.ravel()[fits], near, near_low, shifts,
        domain.radius, domain.slow, UNITS, blocks, blocks_start, _together(domain, places), counts,
        np.array([b for b, _ in pushes], dtype=np.int64), links.next, links.free, tables, links.cells, links.cost,
        len(fits), int(number[cells[start_cost.argmin()]]), home, number[ends], end_cost,
    )  # fmt: skip
    if cost >= NEVER:
        return GridOptimum(False, float("inf"), int(settled))
    return GridOptimum(True, domain.seconds(cost / UNITS), int(settled))


def _push_links(
    domain: SearchDomain,
    places: list[_Places],
    pushes: list[tuple[int, PushContact]],
    number: Int32[np.ndarray, "n"],
) -> _Links:
    """The links of all pushes, padded to equally many places."""
    most = max((len(place.shifts) for place in places), default=1)
    shape = (len(pushes), most)
    links = _Links(
        np.full((*shape, 9), -1, np.int32),
        np.zeros((*shape, 9), np.int32),
        np.full(shape, -1, np.int32),
        np.zeros(shape, np.bool_),
    )
    for p, (b, contact) in enumerate(pushes):
        one = _links(domain, places[b], b, contact, number)
        n = len(one.next)
        links.cells[p, :n], links.cost[p, :n] = one.cells, one.cost
        links.next[p, :n], links.free[p, :n] = one.next, one.free
    return links


def _push_costs(
    domain: SearchDomain, problem: PlanningProblem, costs: PushCosts, bodies: list[int]
) -> Int32[np.ndarray, "pushes steps"]:
    """Cost of each push by its length in whole cells [units]."""
    from visuohaptic.navigation.planning.search._travel_kernels import UNITS

    from ._plan_oracle_kernels import NEVER

    longest = int(costs.longest_push_m / problem.map.resolution_m) + 2
    tables = np.full((len(bodies), longest), NEVER, np.int32)
    units_per_s = UNITS * problem.robot.v_max_m_s / problem.map.resolution_m
    for p, b in enumerate(bodies):
        for steps in range(1, longest):
            length_m = steps * problem.map.resolution_m
            cost_s = push_cost(domain.bodies[b].obj.tag, length_m, problem.robot, costs).total_s
            if np.isfinite(cost_s):
                tables[p, steps] = int(cost_s * units_per_s + 0.5)
    return tables


def _cells_at(
    domain: SearchDomain,
    clearance: Float32[np.ndarray, "rows columns"],
    point: Float[np.ndarray, "2"],
    reach: int,
) -> tuple[Int32[np.ndarray, "k"], Int32[np.ndarray, "k"]]:
    """The free cell of a point, or those around it, with their costs to the point [units]."""
    from visuohaptic.navigation.planning.search._travel_kernels import UNITS

    own = seed_cells(clearance, point, domain.radius, domain.slow, UNITS, reach=0)
    return (
        own if own[0].size else seed_cells(clearance, point, domain.radius, domain.slow, UNITS, reach=reach)
    )


def _places(domain: SearchDomain, body: Body) -> _Places:
    """By brute force, a cell at a time: the truth that the planner's sweep is tested against."""
    low = -np.floor(body.samples.min(axis=0)).astype(np.int32)
    high = np.array(domain.occupied.shape[::-1], dtype=np.int32) - np.ceil(body.samples.max(axis=0)).astype(
        np.int32
    )
    inner = np.concatenate([body.samples, _inside(body)])
    leans = _hits(domain, inner)
    size = high - low + 1
    index = np.full((max(int(size[1]), 1), max(int(size[0]), 1)), -1, np.int32)
    shifts: list[tuple[int, int]] = []
    for dy in range(int(low[1]), int(high[1]) + 1):
        for dx in range(int(low[0]), int(high[0]) + 1):
            hit = _hits(domain, inner + np.array([dx, dy])) & ~leans
            if not hit.any() or (dx == 0 and dy == 0):
                index[dy - low[1], dx - low[0]] = len(shifts)
                shifts.append((dx, dy))
    return _Places(np.array(shifts, dtype=np.int32).reshape(-1, 2), index, low)


def _inside(body: Body) -> Float[np.ndarray, "k 2"]:
    """Points of a half-cell grid inside the outline."""
    from shapely import Polygon, contains_xy

    (x0, y0), (x1, y1) = body.outline.min(axis=0), body.outline.max(axis=0)
    xs, ys = np.meshgrid(np.arange(x0, x1, 0.5), np.arange(y0, y1, 0.5))
    inside = contains_xy(Polygon(body.outline).buffer(-0.15), xs, ys)
    return np.column_stack([xs[inside], ys[inside]])


def _hits(domain: SearchDomain, points: Float[np.ndarray, "k 2"]) -> Bool[np.ndarray, "k"]:
    rows, columns = domain.occupied.shape
    cells = np.floor(points).astype(np.int64)
    outside = (cells < 0).any(axis=1) | (cells[:, 0] >= columns) | (cells[:, 1] >= rows)
    cells = np.where(outside[:, None], 0, cells)
    return outside | domain.occupied[cells[:, 1], cells[:, 0]]


def _blocks(
    domain: SearchDomain, places: list[_Places], number: Int32[np.ndarray, "n"]
) -> tuple[Int32[np.ndarray, "k"], Int32[np.ndarray, "q"]]:
    """Robot cells denied by each body at each place, one body after the other, padded to equally many places."""
    from visuohaptic.navigation.pushing._outline_kernels import distance_patch

    most = max((len(place.shifts) for place in places), default=1)
    rows, columns = domain.clearance.shape
    found: list[Int32[np.ndarray, "k"]] = []
    starts = [0]
    for body, place in zip(domain.bodies, places, strict=True):
        for k in range(most):
            cells = np.zeros(0, np.int32)
            if k < len(place.shifts):
                patch, row, column = distance_patch(
                    rows, columns, body.outline + place.shifts[k], domain.radius
                )
                rr, cc = np.nonzero(patch < domain.radius)
                cells = number[(rr + row) * columns + cc + column]
                cells = cells[cells >= 0]
            found.append(cells)
            starts.append(starts[-1] + len(cells))
    flat = np.concatenate(found) if found else np.zeros(0, np.int32)
    return flat.astype(np.int32), np.array(starts, dtype=np.int32)


def _links(
    domain: SearchDomain, place: _Places, index: int, contact: PushContact, number: Int32[np.ndarray, "n"]
) -> _Links:
    """The links of one push."""
    from visuohaptic.navigation.planning.search._travel_kernels import UNITS, clearance_at

    body = domain.bodies[index]
    step = np.rint(contact.direction).astype(np.int32)
    count = len(place.shifts)
    cells = np.full((count, 9), -1, np.int32)
    cost = np.zeros((count, 9), np.int32)
    after = np.full(count, -1, np.int32)
    clear = np.zeros(count, np.bool_)
    for k, shift in enumerate(place.shifts):
        touch = body.centre + shift + contact.robot
        approach = touch - STAND_OFF_M / domain.map.resolution_m * contact.direction
        x, y = shift + step - place.low
        if 0 <= y < place.index.shape[0] and 0 <= x < place.index.shape[1]:
            after[k] = place.index[y, x]
        clear[k] = clearance_at(domain.clearance, touch[0], touch[1]) >= domain.radius - 0.05
        if clearance_at(domain.clearance, approach[0], approach[1]) < domain.radius - STAND_SLACK:
            continue  # the robot cannot be there
        # With the body where it is: beside it the robot is slow. The other body is left out.
        layer = domain.clearance.copy()
        lower_clearance(layer, body.outline + shift, domain.reach)
        near, extra = seed_cells(layer, approach, domain.radius, domain.slow, UNITS)
        order = extra.argsort()  # the nearest first: it stands for the robot against the other body
        cells[k, : near.size] = number[near[order]]
        cost[k, : near.size] = extra[order]
    return _Links(cells, cost, after, clear)


def _together(domain: SearchDomain, places: list[_Places]) -> Bool[np.ndarray, "q0 q1"]:
    """Whether two bodies at their places stay apart; only their difference in place matters."""
    if len(places) < 2:
        return np.ones((1, 1), dtype=np.bool_)
    from shapely import Polygon
    from shapely.affinity import translate

    one, two = (Polygon(body.outline).buffer(-0.1, join_style="mitre") for body in domain.bodies)
    apart: dict[tuple[int, int], bool] = {}
    result = np.ones((len(places[0].shifts), len(places[1].shifts)), dtype=np.bool_)
    for i, a in enumerate(places[0].shifts):
        offsets = places[1].shifts - a
        for j, (dx, dy) in enumerate(offsets):
            key = (int(dx), int(dy))
            if key not in apart:
                apart[key] = not one.intersects(translate(two, *key))
            result[i, j] = apart[key]
    return result


def _near(
    domain: SearchDomain, places: list[_Places]
) -> tuple[Float32[np.ndarray, "b r c"], Int32[np.ndarray, "b 2"], Int32[np.ndarray, "b q 2"]]:
    """Distance to each body around it, where the patch begins, and the shifts of the body's places."""
    from visuohaptic.navigation.pushing._outline_kernels import distance_patch

    patches, lows = [], []
    for body in domain.bodies:
        low = np.floor(body.outline.min(axis=0) - domain.reach).astype(np.int32)
        size = np.ceil(body.outline.max(axis=0) + domain.reach).astype(np.int32) - low + 1
        patches.append(distance_patch(int(size[1]), int(size[0]), body.outline - low, domain.reach + 1)[0])
        lows.append(low)
    shape = np.max([patch.shape for patch in patches], axis=0) if patches else (1, 1)
    near = np.full((len(patches), *shape), np.float32(np.inf))
    most = max((len(place.shifts) for place in places), default=1)
    shifts = np.zeros((len(patches), most, 2), np.int32)
    for b, (patch, place) in enumerate(zip(patches, places, strict=True)):
        near[b, : patch.shape[0], : patch.shape[1]] = patch
        shifts[b, : len(place.shifts)] = place.shifts
    return near, np.array(lows, dtype=np.int32).reshape(-1, 2), shifts


def _moves(
    domain: SearchDomain, number: Int32[np.ndarray, "n"], fits: Int32[np.ndarray, "f"]
) -> tuple[Int32[np.ndarray, "m"], Int32[np.ndarray, "f+1"], Float[np.ndarray, "m"]]:
    """Neighbours of every cell and how far they are [cells]."""
    rows, columns = domain.clearance.shape
    r, c = np.divmod(fits, columns)
    sources, targets, lengths = [], [], []
    for dr, dc in product((-1, 0, 1), repeat=2):
        if dr == 0 and dc == 0:
            continue
        inside = (r + dr >= 0) & (r + dr < rows) & (c + dc >= 0) & (c + dc < columns)
        source = np.flatnonzero(inside)
        target = number[(r[source] + dr) * columns + c[source] + dc]
        source, target = source[target >= 0], target[target >= 0]
        sources.append(source)
        targets.append(target)
        lengths.append(np.full(len(source), np.hypot(dr, dc)))
    source = np.concatenate(sources)
    order = source.argsort(kind="stable")
    starts = np.searchsorted(source[order], np.arange(len(fits) + 1))
    return (
        np.concatenate(targets)[order].astype(np.int32),
        starts.astype(np.int32),
        np.concatenate(lengths)[order],
    )
