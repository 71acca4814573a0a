"""Simulated off-centre drives against a body, and their results; grid coordinates."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ...core.errors import InputError
from ..pushing._outline_kernels import disc_touches_at
from ..pushing.contact_candidates import push_contacts
from ..pushing.push_model import PushModel
from ..pushing.quasi_static import line_path, simulate_push
from .arrays import Clearance, Path, Point
from .object_cells import fill_cells
from .search import _travel_kernels
from .search._travel_kernels import FAR, UNITS, clearances_at, reach_costs
from .search.bodies import Body, lower_clearance
from .search.push_states import Deadline
from .search.search_domain import SearchDomain

#: Number of directions that are tried; lateral contact offsets are fractions of half the object's width.
DIRECTIONS = 24
#: Directions between one and the next that is tried, without a common divisor: all sides come before the time ends.
STRIDE = 7
PLACES = (-0.85, -0.5, -0.2, 0.2, 0.5, 0.85)
#: Maximum length of the drive in contact [m], and spacing of the retained end points.
MAX_LENGTH_M, SPACING_M = 0.5, 0.06
#: Distance of the platform's start from the outline [cells], and distance by which it backs off [m].
STAND_OFF, BACK_OFF_M = 0.6, 0.10
#: Minimum displacement and rotation that count as a change [m, rad].
MIN_M, MIN_RAD = 0.02, 0.08
#: Maximum number of retained rollouts per object.
MAX_ROLLOUTS = 240


@dataclass(frozen=True, slots=True, eq=False)
class OffCentreScene:
    """One body to be rotated among static obstacles; grid coordinates."""

    domain: SearchDomain
    body: Body
    model: PushModel  #: in metres along the grid's axes, about the centroid
    without: Clearance  #: clearance without the body [cells]
    blocked: Bool[np.ndarray, "rows columns"]  #: cells that are obstacles for the body
    radius_m: float  #: of the rim
    stand_off: float  #: distance of the start of a drive from the position of contact [cells]


@dataclass(frozen=True, slots=True, eq=False)
class Rollout:
    """A straight drive against the body, and the body's final pose."""

    scene: OffCentreScene
    direction: Point  #: of the drive, unit vector
    approach_at: Point  #: its start [cells]
    approach_s: float  #: cost of the drive to the start
    length_m: float  #: of the drive
    pose: Float[np.ndarray, "3"]  #: of the body relative to its initial pose [m, m, rad]


def rollouts(
    domain: SearchDomain, margin_m: float, among: Collection[str], deadline: Deadline
) -> list[Rollout]:
    """Collision-free drives against every body from all sides.

    Parameters
    ----------
    domain
        Map, robot, start, goal and bodies.
    margin_m
        Safety margin [m].
    among
        Ids of the bodies.
    deadline
        Time limit, of which each body has an equal part.
    """

    clearance = domain.clearance_with(np.zeros((len(domain.bodies), 2)))
    cells, costs = domain.seeds(clearance, domain.start, reach=2, block=1)
    if not cells.size:
        return []
    nothing, none = np.zeros((0, 0), np.int16), np.zeros(0, np.int32)
    cost = _travel_kernels.travel_field(
        clearance, domain.radius, domain.slow, cells, costs, nothing, none, none, 0, none
    )
    found: list[Rollout] = []
    chosen = [k for k, b in enumerate(domain.bodies) if not b.allowed.unknown and b.obj.id in among]
    for left, index in zip(range(len(chosen), 0, -1), chosen, strict=True):
        scene = scene_of(domain, index, margin_m)
        ends: list[Rollout] = []
        until = deadline.earlier(deadline.left_s * (left - 1) / left)
        for direction, approach_at, approach in _approaches(scene, clearance, cost):
            if until.passed:
                break
            ends += _rollouts_of(scene, direction, approach_at, domain.seconds(approach / UNITS))
        found += ends[:: max(1, -(-len(ends) // MAX_ROLLOUTS))]
    return found


def scene_of(domain: SearchDomain, index: int, margin_m: float = 0.0) -> OffCentreScene:
    """One body to be rotated or displaced sideward, among all other obstacles.

    Parameters
    ----------
    domain
        Map, robot and bodies.
    index
        Index of the body.
    margin_m
        Difference between the radius of the domain's robot and that of the pushing rim [m].
    """
    body, resolution_m = domain.bodies[index], domain.map.resolution_m
    blocked, others = domain.occupied.copy(), [other for other in domain.bodies if other is not body]
    fill_cells(blocked, *(other.outline for other in others), *domain.immovable_outlines)
    model = PushModel.of_footprint((body.outline - body.centre) * resolution_m)
    model = model.with_centre_moved(*(body.friction * resolution_m))
    without = domain.clearance_with(np.zeros((len(domain.bodies), 2)), index)
    radius_m, stand_off = domain.robot.radius_m - margin_m, STAND_OFF + margin_m / resolution_m
    return OffCentreScene(domain, body, model, without, blocked, radius_m, stand_off)


def has_room(scene: OffCentreScene, points_m: Path) -> Bool[np.ndarray, "k"]:
    """Whether the robot is free of collisions at points about the body's centre, the body itself ignored [m].

    Parameters
    ----------
    scene
        The body and its surroundings.
    points_m
        x, y about the body's centre, along the grid's axes.
    """

    cells = points_m / scene.domain.map.resolution_m + scene.body.centre
    return np.asarray(clearances_at(scene.without, cells) >= scene.domain.radius - 0.05)


def _approaches(
    scene: OffCentreScene, clearance: Clearance, cost: np.ndarray
) -> Iterator[tuple[Point, Point, float]]:
    """Directions of drives, their start positions, and the costs of reaching these [units]."""

    domain, body = scene.domain, scene.body
    shape = np.ascontiguousarray(body.outline - body.centre)
    radius = scene.radius_m / domain.map.resolution_m
    reach = 3.0 * float(np.abs(shape).max()) + 3.0 * domain.radius
    for angle in np.arange(DIRECTIONS) * (STRIDE * 2 * math.pi / DIRECTIONS):
        ahead = np.array([math.cos(angle), math.sin(angle)])
        left = np.array([-ahead[1], ahead[0]])
        across = shape @ left
        middle, half = 0.5 * (across.max() + across.min()), 0.5 * float(np.ptp(across))
        for place in (*PLACES, -1.0 - 0.5 * radius / half, 1.0 + 0.5 * radius / half):
            aside = (middle + place * half) * left
            away = disc_touches_at(shape - aside, ahead[0], ahead[1], radius, reach)
            if away == -1.0:
                continue  # it passes
            approach_at = body.centre + aside - (away + scene.stand_off) * ahead
            approach = reach_costs(clearance, cost, approach_at[None], domain.radius, domain.slow, 1)[0]
            if approach < FAR:
                yield ahead, approach_at, float(approach)


def _rollouts_of(
    scene: OffCentreScene, ahead: Point, approach_at: Point, approach_s: float
) -> Iterator[Rollout]:
    """One drive with several lengths, as far as it is collision-free."""
    resolution_m = scene.domain.map.resolution_m
    path = drive_of(scene, ahead, approach_at, MAX_LENGTH_M + scene.stand_off * resolution_m)
    try:
        trace = simulate_push(scene.model, (0.0, 0.0, 0.0), path, scene.radius_m)
    except InputError:
        return  # the platform would start inside a concavity of the outline
    clear = np.logical_and.accumulate(has_room(scene, path[:, :2]) & fits(scene, trace.object_m))
    gone = np.hypot(*(path[:, :2] - path[0, :2]).T)
    next_m = 0.0
    for row in np.flatnonzero(clear):
        moved = float(np.hypot(*trace.object_m[row, :2]))
        if (moved < MIN_M and abs(trace.object_m[row, 2]) < MIN_RAD) or gone[row] < next_m:
            continue
        next_m = float(gone[row]) + SPACING_M
        yield Rollout(scene, ahead, approach_at, approach_s, float(gone[row]), trace.object_m[row])


def drive_of(
    scene: OffCentreScene, ahead: Point, approach_at: Point, length_m: float
) -> Float[np.ndarray, "k 3"]:
    """Poses of the drive relative to the body's centre [m].

    Parameters
    ----------
    scene
        Body and its surroundings.
    ahead
        Unit vector of the drive, (2,).
    approach_at
        Start of the platform [cells], (2,).
    length_m
        Length of the drive [m].
    """
    begin_m = (approach_at - scene.body.centre) * scene.domain.map.resolution_m
    return line_path(begin_m, begin_m + length_m * ahead)


def fits(scene: OffCentreScene, poses: Float[np.ndarray, "k 3"]) -> Bool[np.ndarray, "k"]:
    """Whether the body is collision-free at each pose; points that start in an obstacle are ignored.

    Parameters
    ----------
    scene
        Body and its surroundings.
    poses
        x [m], y [m] and rotation [rad] of the body, relative to its present pose, (k, 3).
    """
    rows, columns = scene.blocked.shape

    def hit(points: Float[np.ndarray, "*k 2"]) -> Bool[np.ndarray, "*k"]:
        cells = np.floor(points).astype(np.int64)
        c, r = cells[..., 0], cells[..., 1]
        off = (c < 0) | (r < 0) | (c >= columns) | (r >= rows)
        return np.asarray(off | scene.blocked[np.where(off, 0, r), np.where(off, 0, c)])

    points = np.concatenate([scene.body.samples, scene.body.around])
    return np.asarray(
        ~hit(scene.body.placed(points[~hit(points)], poses, scene.domain.map.resolution_m)).any(axis=-1)
    )


def retreat(rollout: Rollout) -> Point:
    """Position to which the platform backs off after a drive [cells].

    Parameters
    ----------
    rollout
        Simulated drive.
    """
    back = max(rollout.length_m - BACK_OFF_M, 0.0) / rollout.scene.domain.map.resolution_m
    return rollout.approach_at + back * rollout.direction


def _reached(rollout: Rollout, pose: np.ndarray) -> tuple[Clearance, Bool[np.ndarray, "n"]]:
    """Clearance, and the cells that the robot can reach after a push."""

    domain, body, clearance = rollout.scene.domain, rollout.scene.body, rollout.scene.without.copy()
    outline = body.placed(body.outline, pose, domain.map.resolution_m)
    lower_clearance(clearance, np.ascontiguousarray(outline), domain.reach)
    near, _ = domain.seeds(clearance, retreat(rollout), reach=2, block=1)
    return clearance, _travel_kernels.flood(clearance, domain.radius, near, near[:0])


def opens_passage(rollout: Rollout, pose: np.ndarray) -> bool:
    """Whether the goal can be reached after the body has moved by a pose.

    Parameters
    ----------
    rollout
        Simulated drive.
    pose
        x [m], y [m] and rotation [rad] of the body, relative to its present pose, (3,).
    """

    domain = rollout.scene.domain
    clearance, reached = _reached(rollout, pose)
    goal, _ = domain.seeds(clearance, domain.goal, block=1)
    return bool(goal.size) and bool(reached[goal].any())


def contacts_after(rollout: Rollout) -> int:
    """Number of straight pushes of the body afterwards whose approach the robot can reach.

    Parameters
    ----------
    rollout
        Simulated drive.
    """
    domain = rollout.scene.domain
    _, reached = _reached(rollout, rollout.pose)
    shape, body, resolution_m = domain.clearance.shape, rollout.scene.body, domain.map.resolution_m
    outline = body.placed(body.outline, rollout.pose, resolution_m)
    centre = body.placed(body.centre[None], rollout.pose, resolution_m)[0]
    found = 0
    for contact in push_contacts(outline, centre, domain.radius):
        column, row = np.floor(centre + contact.robot - STAND_OFF * contact.direction).astype(int)
        near = reached.reshape(shape)[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
        found += bool(near.any())
    return found
