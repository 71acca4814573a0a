"""Pushes beside the centre, for where no straight one through it opens a way (Alt 2016, Sec. 4.3.2).

A box that stands slantwise in a door has no face left that a straight push
could use. Brushed at its end it turns, and then either the way is open or a
straight push works again. The object's motion is foreseen by the quasi-static
model, and each push is judged by what it leaves: an open way at best, a
problem that the planner can solve otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32

from ...core.errors import InputError
from ..problem.path_plan import Plan
from ..problem.planning_problem import PlanningProblem
from ..problem.push_costs import PushCosts, failure_probability
from ..pushing.contact_candidates import push_contacts
from ..pushing.push_failure import PushUncertainty
from ..pushing.push_model import PushModel
from ..pushing.quasi_static import line_path, simulate_push
from .planner import pull_string
from .push_states import anchors
from .replanning import after_push
from .search_domain import Body, PushWorld, fill_cells, grid_from_world, push_world, world_from_grid

__all__ = ["TurningPush", "plan_turning_pushes"]

#: Directions that are tried, and places across the object as shares of half its width.
DIRECTIONS = 24
PLACES = (-0.85, -0.5, -0.2, 0.2, 0.5, 0.85)
#: The drive in contact is at most so long [m], and is looked at in steps of.
LONGEST_M, LOOK_M = 0.5, 0.06
#: The platform begins so far off the outline [cells], and backs off by so much [m].
STAND_OFF, BACK_OFF_M = 0.6, 0.10
#: What moves or turns less has not changed anything [m, rad].
MIN_M, MIN_RAD = 0.02, 0.08
#: Ends of one object that are looked at more closely.
MAX_ENDS = 240


@dataclass(frozen=True, slots=True, eq=False)
class TurningPush:
    """A straight drive against an object that turns it; map frame."""

    object: str
    approach_m: Float[np.ndarray, "k 2"]  #: way of the robot's centre to where the push begins
    direction_rad: float
    length_m: float  #: way of the robot from there
    free_m: float  #: ... of which so much before it touches
    displacement_m: Float[np.ndarray, "2"]  #: foreseen, of the object's centroid
    turn_rad: float  #: foreseen
    failure_probability: float
    cost_s: float  #: setup and drive
    opens: bool  #: whether nothing else has to be pushed after it

    @property
    def stand_m(self) -> Float[np.ndarray, "2"]:
        """Where the push begins."""
        return self.approach_m[-1]

    @property
    def retreat_m(self) -> Float[np.ndarray, "2"]:
        """Where the robot is after it has backed off."""
        ahead = np.array([math.cos(self.direction_rad), math.sin(self.direction_rad)])
        return self.stand_m + max(self.length_m - BACK_OFF_M, 0.0) * ahead


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """One body to be turned, everything else as it is; grid coordinates."""

    world: PushWorld
    body: Body
    model: PushModel  #: in metres along the grid's axes, about the centroid
    without: Float32[np.ndarray, "rows columns"]  #: clearance without the body [cells]
    blocked: Bool[np.ndarray, "rows columns"]  #: cells that the body must not enter
    goal: Float[np.ndarray, "2"]
    radius_m: float  #: of the rim
    off: float  #: drives begin so far from where the rim touches [cells]


@dataclass(frozen=True, slots=True, eq=False)
class _End:
    scene: _Scene
    direction: Float[np.ndarray, "2"]
    stand: Float[np.ndarray, "2"]  #: [cells]
    approach_s: float
    length_m: float
    pose: Float[np.ndarray, "3"]  #: of the body from where it was [m, m, rad]


def plan_turning_pushes(
    problem: PlanningProblem,
    planner: Callable[[PlanningProblem], Plan] | None = None,
    costs: PushCosts | None = None,
    *,
    margin_m: float = 0.0,
    samples: int = 12,
    most: int = 6,
    rng: np.random.Generator | None = None,
) -> tuple[TurningPush, ...]:
    """Pushes that turn an object and leave a way, the best first; empty where none was found.

    Parameters
    ----------
    problem
        Map, objects, robot, start and goal; objects that were never touched stay where they are.
    planner
        Asked whether the problem after a push can be solved, where no push opens a way by itself.
    costs
        What may be pushed.
    margin_m
        By which the problem's robot is larger than the rim that pushes.
    samples
        Simulated pushes per candidate with drawn friction, centre and place, for its probability of failure.
    most
        Candidates that are judged that closely.
    rng
        For the draws.

    Returns
    -------
    Sorted by expected cost, cost / (1 - probability of failure); those that open a way come first.
    """
    costs = costs or PushCosts()
    rng = rng if rng is not None else np.random.default_rng(0)
    if not 0 <= margin_m < problem.robot.radius_m:
        raise InputError(
            "plan_turning_pushes", f"found a margin of {margin_m} m, expected 0 to the robot's radius"
        )
    world = push_world(problem, costs, unknown=False)
    start = grid_from_world(problem.map, problem.start_m)
    goal = grid_from_world(problem.map, problem.goal_m)
    ends = _ends(world, start, goal, margin_m)
    opening = [end for end in ends if _opens(end, end.pose)]
    if opening:
        chosen = _diverse(sorted(opening, key=_seconds), most)
    elif planner is not None:
        ranked = sorted(ends, key=lambda end: (-_contacts_after(end), _seconds(end)))
        chosen = [end for end in _diverse(ranked, most) if _solved_after(problem, end, planner)]
    else:
        chosen = []
    judged = [_judged(problem, end, samples, rng, costs, opens=bool(opening)) for end in chosen]
    pushes = [push for push in judged if len(push.approach_m)]
    return tuple(sorted(pushes, key=lambda push: push.cost_s / max(1.0 - push.failure_probability, 1e-3)))


def _ends(
    world: PushWorld, start: Float[np.ndarray, "2"], goal: Float[np.ndarray, "2"], margin_m: float
) -> list[_End]:
    """Where candidate drives leave their objects, without a collision on the way."""
    from ._push_search_kernels import UNITS, travel_field

    still = np.zeros((len(world.bodies), 2))
    clearance = world.clearance_with(still)
    cells, price = anchors(clearance, start, world.radius, world.slow, UNITS, reach=2)
    if not cells.size:
        return []
    nothing = np.zeros((0, 0), np.int32)
    none = np.zeros(0, np.int32)
    cost, _, _ = travel_field(clearance, world.radius, world.slow, cells, price, nothing, none, none, 0)
    found: list[_End] = []
    for index, body in enumerate(world.bodies):
        blocked = world.occupied.copy()
        for other in world.bodies:
            if other is not body:
                fill_cells(blocked, other.outline)
        resolution_m = world.map.resolution_m
        aside = grid_from_world(world.map, body.item.centre_m + np.array(body.item.friction_offset_m))
        offset_m = (aside - body.centre) * resolution_m
        model = PushModel.patch((body.outline - body.centre) * resolution_m)
        model = model.with_centre_moved(float(offset_m[0]), float(offset_m[1]))
        scene = _Scene(
            world, body, model, world.clearance_with(still, index), blocked, goal,
            world.robot.radius_m - margin_m, STAND_OFF + margin_m / resolution_m,
        )  # fmt: skip
        ends = [
            end
            for direction, stand, approach in _stands(scene, clearance, cost)
            for end in _driven(scene, direction, stand, world.seconds(approach / UNITS))
        ]
        found += ends[:: max(1, -(-len(ends) // MAX_ENDS))]
    return found


def _stands(
    scene: _Scene, clearance: Float32[np.ndarray, "rows columns"], cost: np.ndarray
) -> Iterator[tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"], float]]:
    """Directions of drives, where they begin, and what it costs to go there [units]."""
    from ..pushing._outline_kernels import disc_touches_at
    from ._push_search_kernels import FAR, reach_cost

    world, body = scene.world, scene.body
    shape = np.ascontiguousarray(body.outline - body.centre)
    radius = scene.radius_m / world.map.resolution_m
    reach = 3.0 * float(np.abs(shape).max()) + 3.0 * world.radius
    for angle in np.arange(DIRECTIONS) * (2 * math.pi / DIRECTIONS):
        ahead = np.array([math.cos(angle), math.sin(angle)])
        left = np.array([-ahead[1], ahead[0]])
        across = shape @ left
        middle, half = 0.5 * (across.max() + across.min()), 0.5 * float(np.ptp(across))
        for place in (*PLACES, -1.0 - 0.5 * radius / half, 1.0 + 0.5 * radius / half):
            aside = (middle + place * half) * left
            away = disc_touches_at(shape - aside, ahead[0], ahead[1], radius, reach)
            if away == -1.0:
                continue  # it passes
            stand = body.centre + aside - (away + scene.off) * ahead
            approach = reach_cost(clearance, cost, stand[0], stand[1], world.radius, world.slow)
            if approach < FAR:
                yield ahead, stand, float(approach)


def _driven(
    scene: _Scene, ahead: Float[np.ndarray, "2"], stand: Float[np.ndarray, "2"], approach_s: float
) -> Iterator[_End]:
    """Ends of one drive at several lengths, as far as nothing is in the way."""
    from ._push_search_kernels import clearance_at

    world, resolution_m = scene.world, scene.world.map.resolution_m
    path = _path(scene, ahead, stand, LONGEST_M + scene.off * resolution_m)
    try:
        trace = simulate_push(scene.model, (0.0, 0.0, 0.0), path, scene.radius_m)
    except InputError:
        return  # a dent of the outline holds the platform where it would begin
    way = path[:, :2] / resolution_m + scene.body.centre
    room = [clearance_at(scene.without, x, y) >= world.radius - 0.05 for x, y in way]
    clear = np.logical_and.accumulate(np.array(room) & _fits(scene, trace.object_m))
    gone = np.hypot(*(path[:, :2] - path[0, :2]).T)
    next_m = 0.0
    for row in np.flatnonzero(clear):
        moved = float(np.hypot(*trace.object_m[row, :2]))
        if (moved < MIN_M and abs(trace.object_m[row, 2]) < MIN_RAD) or gone[row] < next_m:
            continue
        next_m = float(gone[row]) + LOOK_M
        yield _End(scene, ahead, stand, approach_s, float(gone[row]), trace.object_m[row])


def _path(
    scene: _Scene, ahead: Float[np.ndarray, "2"], stand: Float[np.ndarray, "2"], length_m: float
) -> Float[np.ndarray, "k 3"]:
    """The drive about the body's centre [m]."""
    begin_m = (stand - scene.body.centre) * scene.world.map.resolution_m
    return line_path(begin_m, begin_m + length_m * ahead)


def _placed(points: Float[np.ndarray, "k 2"], scene: _Scene, pose: np.ndarray) -> Float[np.ndarray, "k 2"]:
    """Points of the body [cells] after it has moved by a pose [m, m, rad]."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    own = (points - scene.body.centre) @ np.array([[c, s], [-s, c]])
    return own + scene.body.centre + pose[:2] / scene.world.map.resolution_m


def _fits(scene: _Scene, poses: Float[np.ndarray, "k 3"]) -> Bool[np.ndarray, "k"]:
    """Whether the body is free of everything at each pose; points that begin in something are not looked at."""
    rows, columns = scene.blocked.shape

    def hit(points: np.ndarray) -> np.ndarray:
        c, r = np.floor(points).astype(np.int64).T
        off = (c < 0) | (r < 0) | (c >= columns) | (r >= rows)
        return off | scene.blocked[np.where(off, 0, r), np.where(off, 0, c)]

    points = np.concatenate([scene.body.samples, scene.body.around])
    points = points[~hit(points)]
    return np.array([not hit(_placed(points, scene, pose)).any() for pose in poses])


def _clearance_after(end: _End, pose: np.ndarray) -> Float32[np.ndarray, "rows columns"]:
    from ..pushing._outline_kernels import distance_patch

    world = end.scene.world
    layer = end.scene.without.copy()
    outline = np.ascontiguousarray(_placed(end.scene.body.outline, end.scene, pose))
    patch, row, column = distance_patch(*layer.shape, outline, world.reach)
    part = layer[row : row + patch.shape[0], column : column + patch.shape[1]]
    np.minimum(part, patch, out=part)
    return layer


def _retreat(end: _End) -> Float[np.ndarray, "2"]:
    back = max(end.length_m - BACK_OFF_M, 0.0) / end.scene.world.map.resolution_m
    return end.stand + back * end.direction


def _reached(
    end: _End, pose: np.ndarray
) -> tuple[Float32[np.ndarray, "rows columns"], Bool[np.ndarray, "n"]]:
    """Clearance, and the cells that the robot reaches after a push."""
    from ._push_search_kernels import UNITS, flood

    world = end.scene.world
    clearance = _clearance_after(end, pose)
    near, _ = anchors(clearance, _retreat(end), world.radius, world.slow, UNITS, reach=2)
    return clearance, flood(clearance, world.radius, near)


def _opens(end: _End, pose: np.ndarray) -> bool:
    """Whether the goal can be reached when the body has moved by a pose."""
    from ._push_search_kernels import UNITS

    world = end.scene.world
    clearance, reached = _reached(end, pose)
    goal, _ = anchors(clearance, end.scene.goal, world.radius, world.slow, UNITS)
    return bool(goal.size) and bool(reached[goal].any())


def _contacts_after(end: _End) -> int:
    """How many straight pushes the body has afterwards from where the robot can stand."""
    world = end.scene.world
    _, reached = _reached(end, end.pose)
    shape = end.scene.world.clearance.shape
    outline = _placed(end.scene.body.outline, end.scene, end.pose)
    centre = _placed(end.scene.body.centre[None], end.scene, end.pose)[0]
    found = 0
    for contact in push_contacts(outline, centre, world.radius):
        column, row = np.floor(centre + contact.robot - STAND_OFF * contact.direction).astype(int)
        near = reached.reshape(shape)[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
        found += bool(near.any())
    return found


def _solved_after(problem: PlanningProblem, end: _End, planner: Callable[[PlanningProblem], Plan]) -> bool:
    moved_m, _ = _foreseen(end)
    after = after_push(
        problem,
        end.scene.body.item.id,
        moved_m,
        world_from_grid(problem.map, _retreat(end)),
        turn_rad=float(end.pose[2]),
    )
    return planner(after).reachable


def _foreseen(end: _End) -> tuple[Float[np.ndarray, "2"], float]:
    """Way of the body's centroid in the map frame [m], and the direction of the drive there [rad]."""
    yaw = end.scene.world.map.origin[2]
    c, s = math.cos(yaw), math.sin(yaw)
    turned = np.array([[c, s], [-s, c]])
    ahead = end.direction @ turned
    return end.pose[:2] @ turned, math.atan2(ahead[1], ahead[0])


def _judged(
    problem: PlanningProblem,
    end: _End,
    samples: int,
    rng: np.random.Generator,
    costs: PushCosts,
    *,
    opens: bool,
) -> TurningPush:
    robot, world = problem.robot, end.scene.world
    moved_m, direction_rad = _foreseen(end)
    clearance = world.clearance_with(np.zeros((len(world.bodies), 2)))
    way, _ = pull_string(world, clearance, grid_from_world(problem.map, problem.start_m), end.stand)
    tag = end.scene.body.item.tag
    # Drift and turn of straight pushes say nothing here: the counters and the force do.
    holds = 1.0 - failure_probability(tag, 0.0, robot, costs)
    holds *= 1.0 - _missed(end, samples, rng, opens=opens)
    return TurningPush(
        end.scene.body.item.id,
        world_from_grid(problem.map, way),
        direction_rad,
        end.length_m,
        end.scene.off * problem.map.resolution_m,
        moved_m,
        float(end.pose[2]),
        1.0 - holds,
        robot.setup_time_s + _seconds(end),
        opens,
    )


def _missed(end: _End, samples: int, rng: np.random.Generator, *, opens: bool) -> float:
    """Share of drawn worlds in which the push hits something or does not leave what it should."""
    path = _path(end.scene, end.direction, end.stand, end.length_m)
    failed = 0
    for _ in range(samples):
        drawn, place = PushUncertainty().draw(end.scene.model, (0.0, 0.0, 0.0), rng)
        try:
            trace = simulate_push(drawn, place, path, end.scene.radius_m)
        except InputError:
            continue  # drawn into the platform: says nothing
        pose = trace.object_m[-1]
        off = float(np.hypot(*(pose[:2] - end.pose[:2])))
        ok = bool(_fits(end.scene, trace.object_m).all())
        ok = ok and (_opens(end, pose) if opens else off < 0.05 and abs(pose[2] - end.pose[2]) < 0.3)
        failed += not ok
    return failed / max(samples, 1)


def _seconds(end: _End) -> float:
    return end.approach_s + end.length_m / end.scene.world.robot.v_push_m_s


def _diverse(ends: list[_End], most: int) -> list[_End]:
    """The first ones that differ in object, place or turn."""
    kept: list[_End] = []
    for end in ends:
        if len(kept) == most:
            break
        if all(
            end.scene is not other.scene
            or np.hypot(*(end.pose[:2] - other.pose[:2])) > 0.08
            or abs(end.pose[2] - other.pose[2]) > 0.25
            for other in kept
        ):
            kept.append(end)
    return kept
