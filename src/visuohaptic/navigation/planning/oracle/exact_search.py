"""The exact oracle: every place of the robot times every place of one or two objects.

A test instrument, and ``visuohaptic plan --prove``. It shares with the planner
what a push costs and where an object may be touched, and nothing of its
search: Dijkstra over the whole product of robot cells and object places, with
straight pushes along the grid's axes by whole cells. Where its queue runs
empty there is no plan of that kind. Objects that stand across the grid have no
such pushes; for them the planner's own exhausted search is the proof.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32

from ....core.errors import InputError
from ...problem.planning_problem import PlanningProblem
from ...problem.push_costs import PushCosts, push_cost
from ..push_search import STAND_OFF, STAND_SLACK, search_pushes
from ..push_states import SearchLimits, anchors
from ..search_domain import Body, PushWorld, grid_from_world, push_world

__all__ = ["Oracle", "Proof", "prove", "solve_exact"]

#: States that fit: 4 bytes each.
MAX_STATES = 150_000_000


@dataclass(frozen=True, slots=True)
class Oracle:
    """The optimum on the grid."""

    reachable: bool
    cost_s: float
    states: int  #: settled


@dataclass(frozen=True, slots=True)
class Proof:
    """What is proved about a problem."""

    reachable: bool
    proved: bool
    cost_s: float  #: of the optimum on the grid, infinite without a plan
    text: str

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "reachable": self.reachable,
            "proved": self.proved,
            "cost_s": self.cost_s if np.isfinite(self.cost_s) else None,
            "text": self.text,
        }


@dataclass(frozen=True, slots=True, eq=False)
class _Places:
    """Where one body may stand: whole-cell shifts at which it covers no occupied cell."""

    shifts: Int32[np.ndarray, "q 2"]
    index: Int32[np.ndarray, "rows columns"]  #: place by shift - lowest shift, -1 where there is none
    low: Int32[np.ndarray, "2"]


def prove(problem: PlanningProblem, costs: PushCosts | None = None) -> Proof:
    """Ask the oracle, or where it does not apply exhaust the planner's own search."""
    costs = costs or PushCosts()
    world = push_world(problem, costs)
    start, goal = (grid_from_world(problem.map, p) for p in (problem.start_m, problem.goal_m))
    try:
        found = solve_exact(problem, costs)
    except InputError as error:
        limits = SearchLimits(expansions=100_000, pushes=30)
        result = search_pushes(world, start, goal, costs, limits)
        cost_s = world.seconds(result.cost)
        if result.found:
            return Proof(True, True, cost_s, f"{error.problem}; the search found a plan of {cost_s:.1f} s")
        said = "exhausted: there is no plan" if result.exhausted else "not exhausted: nothing is proved"
        return Proof(False, result.exhausted, float("inf"), f"{error.problem}; the search is {said}")
    if found.reachable:
        return Proof(True, True, found.cost_s, f"the optimum on the grid is {found.cost_s:.1f} s")
    axes = all(_on_axes(body) for body in world.bodies)
    if axes:
        return Proof(False, True, float("inf"), f"no plan, all {found.states} states were looked at")
    result = search_pushes(world, start, goal, costs, SearchLimits(expansions=100_000, pushes=30))
    return Proof(
        result.found,
        result.found or result.exhausted,
        world.seconds(result.cost),
        "no plan along the axes; the search over all contacts "
        + ("found one" if result.found else "found none, exhausted" if result.exhausted else "gave up"),
    )


def _on_axes(body: Body) -> bool:
    return all(float(np.abs(contact.direction).max()) > 1 - 1e-9 for contact in body.contacts)


def solve_exact(problem: PlanningProblem, costs: PushCosts | None = None) -> Oracle:
    """The cheapest plan with pushes along the axes, by looking at every state.

    Raises
    ------
    InputError
        More than two objects that can be pushed, or more states than fit.
    """
    from .._push_search_kernels import UNITS
    from ._oracle_kernels import NEVER, product_search

    costs = costs or PushCosts()
    world = push_world(problem, costs)
    if len(world.bodies) > 2:
        raise InputError(
            "oracle", f"found {len(world.bodies)} objects that can be pushed, expected at most 2"
        )
    rows, columns = world.clearance.shape
    start, goal = (grid_from_world(problem.map, p) for p in (problem.start_m, problem.goal_m))
    number = np.full(rows * columns, -1, np.int32)
    fits = np.flatnonzero(world.clearance.ravel() >= world.radius)
    number[fits] = np.arange(len(fits), dtype=np.int32)
    places = [_places(world, body) for body in world.bodies]
    counts = np.array([len(place.shifts) for place in places], dtype=np.int64)
    pushes = [
        (b, contact)
        for b, body in enumerate(world.bodies)
        for contact in body.contacts
        if float(np.abs(contact.direction).max()) > 1 - 1e-9
    ]
    states = int(np.prod(counts)) * (len(fits) + len(pushes))
    if states > MAX_STATES:
        raise InputError("oracle", f"found {states} states, expected at most {MAX_STATES}")
    blocks, blocks_start = _blocks(world, places, number)
    links = [_links(world, places[b], b, contact, number) for b, contact in pushes]
    most = int(counts.max()) if len(counts) else 1
    link_cells = np.full((len(pushes), most, 9), -1, np.int32)
    link_cost = np.zeros((len(pushes), most, 9), np.int32)
    push_next = np.full((len(pushes), most), -1, np.int32)
    push_free = np.zeros((len(pushes), most), np.bool_)
    for p, (cells_at, cost_at, after, clear) in enumerate(links):
        n = len(after)
        link_cells[p, :n], link_cost[p, :n], push_next[p, :n], push_free[p, :n] = (
            cells_at, cost_at, after, clear,
        )  # fmt: skip
    longest = int(costs.longest_push_m / problem.map.resolution_m) + 2
    tables = np.full((len(pushes), longest), NEVER, np.int32)
    units_per_s = UNITS * problem.robot.v_max_m_s / problem.map.resolution_m
    for p, (b, _) in enumerate(pushes):
        for steps in range(1, longest):
            length_m = steps * problem.map.resolution_m
            price = push_cost(world.bodies[b].item.tag, length_m, problem.robot, costs).total_s
            if np.isfinite(price):
                tables[p, steps] = int(price * units_per_s + 0.5)
    moves = _moves(world, number, fits)
    home = np.zeros((len(world.bodies), 2))
    at, _ = anchors(world.clearance_with(home), start, world.radius, world.slow, UNITS, reach=0)
    if not at.size:
        at, extra = anchors(world.clearance_with(home), start, world.radius, world.slow, UNITS, reach=2)
        at = at[extra.argsort()][:1]
    ends, end_cost = anchors(world.clearance, goal, world.radius, world.slow, UNITS, reach=0)
    if not ends.size:
        ends, end_cost = anchors(world.clearance, goal, world.radius, world.slow, UNITS)
    if not at.size or not ends.size:
        return Oracle(False, float("inf"), 0)
    begin = np.array([int(place.index[-place.low[1], -place.low[0]]) for place in places], dtype=np.int64)
    near, near_low, shifts = _near(world, places)
    cost, settled = product_search(
        *moves, *np.divmod(fits, columns), world.clearance.ravel()[fits], near, near_low, shifts,
        world.radius, world.slow, UNITS, blocks, blocks_start, _together(world, places), counts,
        np.array([b for b, _ in pushes], dtype=np.int64), push_next, push_free, tables, link_cells, link_cost,
        len(fits), int(number[at[0]]), begin, number[ends], end_cost,
    )  # fmt: skip
    if cost >= NEVER:
        return Oracle(False, float("inf"), int(settled))
    return Oracle(True, world.seconds(cost / UNITS), int(settled))


def _places(world: PushWorld, body: Body) -> _Places:
    """By brute force, a cell at a time: the truth that the planner's sweep is tested against."""
    rows, columns = world.occupied.shape
    low = -np.floor(body.samples.min(axis=0)).astype(np.int32)
    high = np.array([columns, rows], dtype=np.int32) - np.ceil(body.samples.max(axis=0)).astype(np.int32)
    inner = np.concatenate([body.samples, _inside(body)])
    leans = _hits(world, inner)
    size = high - low + 1
    index = np.full((max(int(size[1]), 1), max(int(size[0]), 1)), -1, np.int32)
    shifts: list[tuple[int, int]] = []
    for dy in range(int(low[1]), int(high[1]) + 1):
        for dx in range(int(low[0]), int(high[0]) + 1):
            hit = _hits(world, inner + np.array([dx, dy])) & ~leans
            if not hit.any() or (dx == 0 and dy == 0):
                index[dy - low[1], dx - low[0]] = len(shifts)
                shifts.append((dx, dy))
    return _Places(np.array(shifts, dtype=np.int32).reshape(-1, 2), index, low)


def _inside(body: Body) -> Float[np.ndarray, "k 2"]:
    """Points of a half-cell grid inside the outline."""
    from shapely import Polygon, contains_xy

    x0, y0 = body.outline.min(axis=0)
    x1, y1 = body.outline.max(axis=0)
    xs, ys = np.meshgrid(np.arange(x0, x1, 0.5), np.arange(y0, y1, 0.5))
    inside = contains_xy(Polygon(body.outline).buffer(-0.15), xs, ys)
    return np.column_stack([xs[inside], ys[inside]])


def _hits(world: PushWorld, points: Float[np.ndarray, "k 2"]) -> Bool[np.ndarray, "k"]:
    rows, columns = world.occupied.shape
    cells = np.floor(points).astype(np.int64)
    outside = (cells < 0).any(axis=1) | (cells[:, 0] >= columns) | (cells[:, 1] >= rows)
    cells = np.where(outside[:, None], 0, cells)
    return outside | world.occupied[cells[:, 1], cells[:, 0]]


def _blocks(
    world: PushWorld, places: list[_Places], number: Int32[np.ndarray, "n"]
) -> tuple[Int32[np.ndarray, "k"], Int32[np.ndarray, "q"]]:
    """Robot cells denied by each body at each place, one body after the other, padded to equally many places."""
    from ...pushing._outline_kernels import distance_patch

    most = max((len(place.shifts) for place in places), default=1)
    rows, columns = world.clearance.shape
    found: list[Int32[np.ndarray, "k"]] = []
    starts = [0]
    for body, place in zip(world.bodies, places, strict=True):
        for k in range(most):
            cells = np.zeros(0, np.int32)
            if k < len(place.shifts):
                patch, row, column = distance_patch(
                    rows, columns, body.outline + place.shifts[k], world.radius
                )
                rr, cc = np.nonzero(patch < world.radius)
                cells = number[(rr + row) * columns + cc + column]
                cells = cells[cells >= 0]
            found.append(cells)
            starts.append(starts[-1] + len(cells))
    flat = np.concatenate(found) if found else np.zeros(0, np.int32)
    return flat.astype(np.int32), np.array(starts, dtype=np.int32)


def _links(
    world: PushWorld, place: _Places, index: int, contact: Any, number: Int32[np.ndarray, "n"]
) -> tuple[Any, Any, Any, Any]:
    """By place: cells around the stand with costs, the next place, and whether the robot fits."""
    from ...pushing._outline_kernels import distance_patch
    from .._push_search_kernels import UNITS, clearance_at

    body = world.bodies[index]
    step = np.rint(contact.direction).astype(np.int32)
    count = len(place.shifts)
    cells = np.full((count, 9), -1, np.int32)
    cost = np.zeros((count, 9), np.int32)
    after = np.full(count, -1, np.int32)
    clear = np.zeros(count, np.bool_)
    for k, shift in enumerate(place.shifts):
        touch = body.centre + shift + contact.robot
        stand = touch - STAND_OFF * contact.direction
        x, y = shift + step - place.low
        if 0 <= y < place.index.shape[0] and 0 <= x < place.index.shape[1]:
            after[k] = place.index[y, x]
        clear[k] = clearance_at(world.clearance, touch[0], touch[1]) >= world.radius - 0.05
        if clearance_at(world.clearance, stand[0], stand[1]) < world.radius - STAND_SLACK:
            continue  # nobody can stand there
        # With the body where it is: beside it the robot is slow. The other body's share is left out.
        patch, row, column = distance_patch(*world.clearance.shape, body.outline + shift, world.reach)
        layer = world.clearance.copy()
        part = layer[row : row + patch.shape[0], column : column + patch.shape[1]]
        np.minimum(part, patch, out=part)
        near, extra = anchors(layer, stand, world.radius, world.slow, UNITS)
        order = extra.argsort()  # the nearest first: it stands for the robot against the other body
        cells[k, : near.size] = number[near[order]]
        cost[k, : near.size] = extra[order]
    return cells, cost, after, clear


def _together(world: PushWorld, places: list[_Places]) -> Bool[np.ndarray, "q0 q1"]:
    """Whether two bodies at their places stay apart; only their difference in place matters."""
    if len(places) < 2:
        return np.ones((1, 1), dtype=np.bool_)
    from shapely import Polygon
    from shapely.affinity import translate

    one, two = (Polygon(body.outline).buffer(-0.1, join_style="mitre") for body in world.bodies)
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
    world: PushWorld, places: list[_Places]
) -> tuple[Float32[np.ndarray, "b r c"], Int32[np.ndarray, "b 2"], Int32[np.ndarray, "b q 2"]]:
    """Distance to each body around it, where the patch begins, and the shifts of the body's places."""
    from ...pushing._outline_kernels import distance_patch

    patches, lows = [], []
    for body in world.bodies:
        low = np.floor(body.outline.min(axis=0) - world.reach).astype(np.int32)
        size = np.ceil(body.outline.max(axis=0) + world.reach).astype(np.int32) - low + 1
        patches.append(distance_patch(int(size[1]), int(size[0]), body.outline - low, world.reach + 1)[0])
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
    world: PushWorld, number: Int32[np.ndarray, "n"], fits: Int32[np.ndarray, "f"]
) -> tuple[Int32[np.ndarray, "m"], Int32[np.ndarray, "f+1"], Float[np.ndarray, "m"]]:
    """Neighbours of every cell and how far they are [cells]."""
    rows, columns = world.clearance.shape
    r, c = np.divmod(fits, columns)
    sources, targets, lengths = [], [], []
    for dr in (-1, 0, 1):
        for dc in (-1, 0, 1):
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
