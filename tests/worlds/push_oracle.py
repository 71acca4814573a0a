"""The optimal plan of a small scene: best-first search over (robot, positions of the bodies), then string pulling.

The costs are those of the public description: driving at the inverse speed of Eq. (4.1), a push costs the setup
and its length at ``v_push_m_s`` (bodies here need less than half of the robot's force, and their tags carry no risk),
and begins and ends ``STAND_OFF`` cells from the body. Pushes are straight, through the centroid, from a contact whose
normal is within 8 degrees of the push, by whole double steps, orientation kept. Drives between pushes are Dijkstra's on
nodes of ``step_m`` with 16 neighbours, which are up to 2.7 % too long; therefore all sequences within 4 % of the best
are kept, the lengths of their pushes refined, and their drives string-pulled on exact distances. Nothing else is
pruned: when the queue is empty, the sequence is the best of those. With ``weight`` > 1 it is a solver without a guarantee
of optimality, with ``limit_s`` one that may answer nothing.
"""

from __future__ import annotations

import heapq
import math
import time
from dataclasses import dataclass, field

import numpy as np
import shapely
from shapely.affinity import translate

from .drive_grid import DriveGrid, grid_path, pull_string
from .maps import Robot, World
from .plan_checks import Floor, drive_seconds

__all__ = ["Answer", "Push", "contacts", "push_seconds", "solve", "travel_m"]

#: Distance of the robot from the body before and after a push, in cells of the map.
STAND_OFF = 0.6
TILT_RAD = np.deg2rad(8.0)
MAX_PUSH_M = 2.0
#: Sequences whose grid cost is within this of the best one are string-pulled, too.
KEEP, POLISHED = 1.04, 6


@dataclass(frozen=True, slots=True)
class Push:
    """One push: which body, where the robot's centre is at first contact, how far."""

    body: str
    shift_m: tuple[float, float]
    touch_m: tuple[float, float]
    contact: int  #: of the body's contacts


@dataclass(frozen=True, slots=True)
class Answer:
    """Result of the search."""

    cost_s: float  #: with string-pulled drives; infinite where there is none
    pushes: tuple[Push, ...]
    finished: bool  #: whether the queue ended, and not the budget
    expanded: int
    drives: tuple[np.ndarray, ...] = ()  #: paths of the robot before, between and after the pushes


def push_seconds(length_m: float, robot: Robot) -> float:
    """Setup plus length by speed: cost of a light body that was pushed before and never failed."""
    return robot.setup_time_s + length_m / robot.v_push_m_s


def contacts(outline_m: np.ndarray, radius_m: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Directions of stable straight pushes and the robot's centre at contact, from the body's centroid.

    Candidates are the inward normals of the hull's sides and, of round outlines, every 7.5 degrees.
    """
    shape = shapely.Polygon(outline_m)
    centre = np.array([shape.centroid.x, shape.centroid.y])
    shape = translate(shape, *-centre)
    hull = np.array(shapely.geometry.polygon.orient(shape.convex_hull).exterior.coords)
    sides = np.diff(hull, axis=0)
    angles = list(np.arctan2(sides[:, 0], -sides[:, 1]))
    round_outline = len(sides) >= 12
    if round_outline:
        angles = list(np.arange(48) * np.pi / 24)
    found: list[tuple[np.ndarray, np.ndarray]] = []
    for angle in angles:
        direction = np.array([np.cos(angle), np.sin(angle)])
        if any(float(direction @ other) > np.cos(np.deg2rad(1.0)) for other, _ in found):
            continue
        far = 3.0 * float(np.hypot(*hull.T).max()) + 3.0 * radius_m
        while (gap := shape.distance(shapely.Point(*(-far * direction))) - radius_m) > 1e-7 and far > 0:
            far -= gap
        if far <= 0:
            continue
        robot = -far * direction
        line = shapely.shortest_line(shape, shapely.Point(*robot))
        contact = np.array(line.coords[0])
        normal = (contact - robot) / np.hypot(*(contact - robot))
        if float(normal @ direction) < np.cos(TILT_RAD):
            continue
        corner = float(np.hypot(*(hull - contact).T).min())
        if not round_outline and corner < 0.1 * float(np.hypot(*sides.T).min()):
            continue  # at its tip, a body turns away
        found.append((direction, robot))
    return found


@dataclass(order=True)
class _State:
    bound_s: float
    spent_s: float
    number: int
    at_m: np.ndarray = field(compare=False)
    shifts: dict[str, tuple[float, float]] = field(compare=False)
    pushes: tuple[Push, ...] = field(compare=False)


class _Search:
    def __init__(self, world: World, cell_m: float, step_m: float, walls: Floor, limit_s: float) -> None:
        self.end_s = time.process_time() + limit_s
        self.world, self.stand_off_m, self.push_m = world, STAND_OFF * cell_m, 2 * step_m
        self.movable = {body.id: body for body in world.bodies if not body.fixed}
        fixed = {body.id: body.polygon for body in world.bodies if body.fixed}
        self.static = Floor([*walls.solid, *fixed.values()], {})
        self.grid = DriveGrid(world, step_m, self.static)
        self.contacts = {
            name: contacts(body.outline_m, world.robot.radius_m) for name, body in self.movable.items()
        }
        self.goal = np.asarray(world.goal_m, dtype=float)
        self.rest, _ = self.grid.field(self.grid.clearance, self.goal)

    @property
    def late(self) -> bool:
        """Whether the CPU time is used up."""
        return time.process_time() > self.end_s

    def body_at(self, name: str, shifts: dict[str, tuple[float, float]]) -> shapely.Polygon:
        return translate(self.movable[name].polygon, *shifts.get(name, (0.0, 0.0)))

    def bound(self, at_m: np.ndarray) -> float:
        """Seconds to the goal without any body: no plan is cheaper."""
        near, seconds = self.grid.near(self.grid.clearance, at_m)
        if not len(near):
            return float("inf")
        # The nodes are not the floor: a node may be up to its own distance nearer to the goal.
        return float(np.max(self.rest[near] - seconds, initial=0.0))

    def pushes_from(self, state: _State, field_s: np.ndarray, layer: np.ndarray) -> list[_State]:
        """All reachable pushes, by one step, two, ... until an obstacle is met."""
        found: list[_State] = []
        for name in self.movable:
            here = self.body_at(name, state.shifts)
            others = {o: self.body_at(o, state.shifts) for o in self.movable if o != name}
            centre = np.array([here.centroid.x, here.centroid.y])
            for contact, (direction, offset) in enumerate(self.contacts[name]):
                if self.late:
                    return found
                touch = centre + offset
                near, seconds = self.grid.near(layer, touch - self.stand_off_m * direction)
                reach_s = float((field_s[near] + seconds).min(initial=np.inf))
                if not np.isfinite(reach_s):
                    continue
                length = self.free_m(name, here, others, direction, touch)
                lengths = self.push_m * np.arange(1, int(length / self.push_m + 1e-9) + 1)
                found += [self.after(state, name, contact, touch, x * direction, reach_s) for x in lengths]
        return found

    def reach_s(self, state: _State, at_m: np.ndarray) -> float:
        """Seconds of the drive from a state to a point."""
        layer = self.grid.clearance_with([self.body_at(name, state.shifts) for name in self.movable])
        near, seconds = self.grid.near(layer, at_m)
        return float((self.grid.field(layer, state.at_m)[0][near] + seconds).min(initial=np.inf))

    def free_m(
        self,
        name: str,
        here: shapely.Polygon,
        others: dict[str, shapely.Polygon],
        direction: np.ndarray,
        touch: np.ndarray,
    ) -> float:
        """Collision-free push distance of a body and the robot behind it."""
        start = touch - self.stand_off_m * direction
        along = np.arange(0.0, MAX_PUSH_M + self.stand_off_m, 0.01)
        clear = Floor(self.static.solid, others, self.static.tree).distance_m(
            start + along[:, None] * direction
        )
        blocked = np.flatnonzero(clear < self.world.robot.radius_m - 1e-6)
        robot_m = MAX_PUSH_M
        if len(blocked):  # at its first pose: it cannot stand there
            robot_m = along[blocked[0] - 1] - self.stand_off_m if blocked[0] else 0.0
        moving = np.array(here.buffer(-1e-4, join_style="mitre").exterior.coords)[:-1]
        ahead = shapely.box(
            *np.minimum(here.bounds[:2], np.array(here.bounds[:2]) + MAX_PUSH_M * direction),
            *np.maximum(here.bounds[2:], np.array(here.bounds[2:]) + MAX_PUSH_M * direction),
        )
        shapes = [self.static.solid[i] for i in self.static.tree.query(ahead)] + list(others.values())
        return min(
            [
                robot_m,
                MAX_PUSH_M,
                *(travel_m(moving, np.array(p.exterior.coords)[:-1], direction) for p in shapes),
            ]
        )

    def after(
        self, state: _State, name: str, contact: int, touch: np.ndarray, shift: np.ndarray, reach_s: float
    ) -> _State:
        """The state after a push whose first contact is reached in ``reach_s``."""
        done = state.shifts.get(name, (0.0, 0.0))
        spent_s = state.spent_s + reach_s + push_seconds(float(np.hypot(*shift)), self.world.robot)
        at = touch + shift - self.stand_off_m * shift / np.hypot(*shift)
        total = (round(done[0] + shift[0], 6), round(done[1] + shift[1], 6))
        push = Push(name, (float(shift[0]), float(shift[1])), (float(touch[0]), float(touch[1])), contact)
        return _State(0.0, spent_s, 0, at, {**state.shifts, name: total}, (*state.pushes, push))


def travel_m(moving: np.ndarray, fixed: np.ndarray, direction: np.ndarray) -> float:
    """How far a polygon can be shifted until it meets another one: rays from the corners of each to the sides of the other."""

    def rays(corners: np.ndarray, ring: np.ndarray, along: np.ndarray) -> float:
        sides = np.roll(ring, -1, axis=0) - ring
        off = ring[None] - corners[:, None]
        cross = along[0] * sides[:, 1] - along[1] * sides[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (off[..., 0] * sides[:, 1] - off[..., 1] * sides[:, 0]) / cross
            u = (off[..., 0] * along[1] - off[..., 1] * along[0]) / cross
        hit = (np.abs(cross) > 1e-12) & (u >= 0) & (u <= 1) & (t >= 0)
        return float(t[hit].min(initial=np.inf))

    return min(rays(moving, fixed, direction), rays(fixed, moving, -direction))


def solve(
    world: World,
    cell_m: float,
    *,
    step_m: float = 0.05,
    max_expansions: int = 2000,
    weight: float = 1.0,
    walls: Floor | None = None,
    limit_s: float = math.inf,
) -> Answer:
    """The cheapest plan of a world, as defined above.

    Parameters
    ----------
    cell_m
        Cell size of the map that the planner has: pushes begin and end 0.6 of it off the body.
    step_m
        Distance of the nodes, and unit of the push lengths.
    weight
        Of the bound; above 1 the first plan is taken.
    walls
        What is solid where that is not the world's walls, e.g. the squares of a real map.
    limit_s
        CPU time; what was found by then is answered as not finished, with drives over the nodes.
    """
    search = _Search(world, cell_m, step_m, walls or Floor(world.walls, {}), limit_s)
    start = np.asarray(world.start_m, dtype=float)
    queue = [_State(weight * search.bound(start), 0.0, 0, start, {}, ())]
    best = float("inf")
    complete: list[tuple[float, tuple[Push, ...]]] = []
    fields: dict[tuple[tuple[str, tuple[float, float]], ...], list[tuple[float, np.ndarray]]] = {}
    number = expanded = 0
    while queue and expanded < max_expansions and not search.late:
        state = heapq.heappop(queue)
        if state.bound_s > KEEP * best or (weight > 1 and complete):
            break
        bodies = [search.body_at(name, state.shifts) for name in search.movable]
        layer = search.grid.clearance_with(bodies)
        key = tuple(sorted(state.shifts.items()))
        near, seconds = search.grid.near(layer, state.at_m)
        if any(
            len(near) and spent + float((f[near] + seconds).min()) <= state.spent_s + 1e-9
            for spent, f in fields.get(key, ())
        ):
            continue  # the same state was reached before at a lower cost
        expanded += 1
        field_s, _ = search.grid.field(layer, state.at_m)
        fields.setdefault(key, []).append((state.spent_s, field_s))
        ends, end_s = search.grid.near(layer, search.goal)
        if len(ends) and np.isfinite(total := state.spent_s + float((field_s[ends] + end_s).min())):
            best = min(best, total)
            complete.append((total, state.pushes))
        for child in search.pushes_from(state, field_s, layer):
            bound = search.bound(child.at_m)
            if child.spent_s + bound > KEEP * best:
                continue
            number += 1
            child.bound_s, child.number = child.spent_s + weight * bound, number
            heapq.heappush(queue, child)
    finished = (not queue or queue[0].bound_s > KEEP * best) and not search.late
    if not complete:
        return Answer(float("inf"), (), finished and expanded < max_expansions, expanded)
    kept = sorted(complete, key=lambda item: item[0])[:POLISHED]
    if search.late:
        return Answer(*kept[0], False, expanded)
    near_best = [pushes for cost, pushes in kept if cost <= KEEP * best]
    pulled = [_pulled(search, _refined(search, pushes)) for pushes in near_best]
    cost_s, pushes, drives = min(pulled, key=lambda item: item[0])
    return Answer(cost_s, pushes, finished, expanded, drives)


def _replayed(search: _Search, chain: list[tuple[str, int, float]]) -> tuple[float, tuple[Push, ...]]:
    """Cost of pushes by body, contact and length with drives over the nodes; infinite where one cannot be done."""
    state = _State(0.0, 0.0, 0, np.asarray(search.world.start_m, dtype=float), {}, ())
    for name, contact, length in chain:
        here = search.body_at(name, state.shifts)
        others = {other: search.body_at(other, state.shifts) for other in search.movable if other != name}
        direction, offset = search.contacts[name][contact]
        touch = np.array([here.centroid.x, here.centroid.y]) + offset
        if length <= 0 or search.free_m(name, here, others, direction, touch) < length:
            return float("inf"), ()
        reach_s = search.reach_s(state, touch - search.stand_off_m * direction)
        state = search.after(state, name, contact, touch, length * direction, reach_s)
    return state.spent_s + search.reach_s(state, search.goal), state.pushes


def _refined(search: _Search, pushes: tuple[Push, ...]) -> tuple[Push, ...]:
    """The same pushes with lengths between whole steps, where cheaper: coordinate descent."""
    chain = [(push.body, push.contact, float(np.hypot(*push.shift_m))) for push in pushes]
    best, kept = _replayed(search, chain)
    for step in (0.5 * search.push_m, 0.25 * search.push_m, 0.125 * search.push_m):
        for index, (name, contact, length) in enumerate(chain):
            for longer in (-step, step):
                tried = [*chain[:index], (name, contact, length + longer), *chain[index + 1 :]]
                cost, done = _replayed(search, tried)
                if cost < best:
                    best, kept, chain = cost, done, tried
    return kept if np.isfinite(best) else pushes


def _pulled(
    search: _Search, pushes: tuple[Push, ...]
) -> tuple[float, tuple[Push, ...], tuple[np.ndarray, ...]]:
    """Cost of a sequence with its drives string-pulled on exact distances."""
    at, shifts = np.asarray(search.world.start_m, dtype=float), {}
    total, drives, robot = 0.0, [], search.world.robot
    for push in (*pushes, None):
        end = search.goal
        if push is not None:
            direction = np.array(push.shift_m) / np.hypot(*push.shift_m)
            end = np.array(push.touch_m) - search.stand_off_m * direction
        bodies = {name: search.body_at(name, shifts) for name in search.movable}
        floor = Floor(search.static.solid, bodies)
        path = grid_path(search.grid, search.grid.clearance_with(list(bodies.values())), at, end)
        path = pull_string(floor, path, robot)
        drives.append(path)
        total += drive_seconds(floor, path, robot)
        if push is not None:
            total += push_seconds(float(np.hypot(*push.shift_m)), robot)
            old = shifts.get(push.body, (0.0, 0.0))
            shifts = {
                **shifts,
                push.body: (round(old[0] + push.shift_m[0], 6), round(old[1] + push.shift_m[1], 6)),
            }
            at = end + np.array(push.shift_m)
    return total, pushes, tuple(drives)
