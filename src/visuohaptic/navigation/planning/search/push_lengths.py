"""Continuous refinement of push lengths, and the risk of inaccurate push ends (Alt 2016, Sec. 4.3.1).

The search tries discrete lengths. They are refined by coordinate descent on the cost of the whole plan on the map;
bodies, contacts and order of the pushes are not changed. Every candidate is checked: pushes must be collision-free,
and all drives must exist on the map. The quasi-static model, with sampled contact friction, centre of friction and pose
of the object, predicts where a pushed object ends, and the probability that it then blocks a later drive. An object that
blocks the whole approach is assumed to have stayed in place.
"""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Bool, Float

from ....core.geometry import rotation_2d
from ...pushing.push_failure import covariance_of_ends
from ..arrays import Among, Path, Point, Shifts
from ..footprint._footprint_kernels import free_drive
from . import _travel_kernels
from ._push_search_kernels import free_push_length, opening_lengths
from .bodies import lower_clearance
from .drives import changed_drives_cost, drives_cells
from .push_ends import PRICED, end_errors
from .push_heuristic import PushHeuristic
from .push_states import Deadline, PushStep, SearchResult, needed_clearance
from .search_domain import SearchDomain

#: Step in which a push is checked for collisions [cells].
SWEEP_STEP = 0.5
#: Number of final poses near a drive for which a detour is searched; the standard error of their fraction is 0.18.
LOOKED_AT = 8
#: Push lengths of the search are multiples of this [m], where the free space allows it.
LENGTH_STEP_M = 0.05
#: Steps of the descent [m]: that of the search, doubled after each success, and the smallest that a robot can execute.
STEPS_M = (LENGTH_STEP_M, LENGTH_STEP_M / 4.0)


def refine_lengths(
    heuristic: PushHeuristic, start: Point, plan: SearchResult, deadline: Deadline
) -> tuple[tuple[PushStep, ...], float]:
    """Pushes of a plan with the lengths of minimum expected cost, and the cost with drives [cells at full speed].

    The expected cost includes pushes that are repeated because an object blocks a later drive.

    Parameters
    ----------
    heuristic
        Heuristic of the search, with its domain, goal and push costs.
    start
        Start position of the robot [cells].
    plan
        Plan of the search.
    deadline
        Time limit.
    """
    domain, scale = heuristic.domain, heuristic.domain.block / heuristic.units
    steps, cost = plan.steps, plan.cost
    risk = replanning_units(heuristic, steps, start) * scale
    refused: set[tuple[float, ...]] = set()  # lengths that were too expensive
    # Shorter pushes first: a longer push rarely saves more driving than it costs.
    for step_m, index, sign in itertools.product(STEPS_M, range(len(steps)), (-1.0, 1.0)):
        first = longer = sign * step_m / domain.map.resolution_m
        while not deadline.passed:
            lengths = tuple(round(step.length + longer * (k == index), 6) for k, step in enumerate(steps))
            tried = (
                () if lengths in refused else replayed(heuristic, steps, index, steps[index].length + longer)
            )
            pushes = heuristic.pushes_units(tried) * scale
            tried_cost = float("inf")
            if tried:
                most = cost + risk - pushes
                tried_cost = pushes + changed_drives_cost(domain, steps, tried, start, most)
            tried_risk = 0.0
            if tried_cost < cost + risk:
                tried_risk = replanning_units(heuristic, tried, start) * scale
            if tried_cost + tried_risk < cost + risk:
                steps, cost, risk, longer = tried, tried_cost, tried_risk, 2.0 * longer
                continue
            refused.add(lengths)
            if longer == first:
                break
            longer = first
    return steps, cost


def replayed(
    heuristic: PushHeuristic, steps: tuple[PushStep, ...], changed: int, length: float
) -> tuple[PushStep, ...]:
    """The same pushes with one length changed; empty if that push or a later one is not collision-free.

    Parameters
    ----------
    heuristic
        Heuristic of the search.
    steps
        Pushes in order.
    changed, length
        Index of the push to change, and its new length [cells].
    """
    done = list(steps[:changed])
    shifts = steps[changed].shifts_before
    for index, step in enumerate(steps[changed:], start=changed):
        length = length if index == changed else step.length
        again = push_step(heuristic, shifts, step.body, step.contact, length)
        if (
            not 0.0 < length <= heuristic.longest(step.body)
            or not stand_is_free(heuristic, again)
            or free_length(heuristic, again, length) < length - 1e-6
        ):
            return ()
        done.append(again)
        shifts = again.shifts_after
    return tuple(done)


def push_step(heuristic: PushHeuristic, shifts: Shifts, body: int, contact: int, length: float) -> PushStep:
    """A push of a given length from a configuration.

    Parameters
    ----------
    heuristic
        Heuristic of the search.
    shifts
        Displacements of the bodies from their mapped positions [cells].
    body, contact
        Indices of the body and of its contact.
    length
        Length of the push [cells].
    """
    push = heuristic.domain.bodies[body].push(contact)
    after = shifts.copy()
    after[body] = shifts[body] + length * push.direction
    touch = heuristic.domain.bodies[body].centre + shifts[body] + push.robot
    approach = touch - heuristic.stand_off * push.direction
    return PushStep(body, contact, length, shifts, after, approach, touch, approach + length * push.direction)


def stand_is_free(heuristic: PushHeuristic, step: PushStep) -> bool:
    """Whether the drive from the approach position to the contact is free of collisions with other obstacles.

    Parameters
    ----------
    heuristic
        Heuristic of the search.
    step
        The push.
    """
    others = np.arange(len(step.shifts_before)) != step.body
    return bool(
        heuristic.domain.clear_straight(step.shifts_before, step.approach, step.touch[None], others)[0]
    )


def free_length(heuristic: PushHeuristic, step: PushStep, limit: float, among: Among | None = None) -> float:
    """Maximum collision-free length of a push [cells].

    Parameters
    ----------
    heuristic
        Heuristic of the search.
    step
        The push, of any length.
    limit
        Maximum length [cells].
    among
        Bodies that count as obstacles, all by default.
    """
    domain: SearchDomain = heuristic.domain
    body, shift = domain.bodies[step.body], step.shifts_before[step.body]
    direction = body.push(step.contact).direction
    ahead = np.stack([np.zeros(2), limit * direction])
    reach = domain.radius + body.margin + 1.0
    low = np.minimum((body.outline + shift).min(axis=0), step.touch) + ahead.min(axis=0) - reach
    high = np.maximum((body.outline + shift).max(axis=0), step.touch) + ahead.max(axis=0) + reach
    outlines, starts = domain.obstacle_outlines(step.shifts_before, step.body, low, high, among)
    found: float = free_push_length(
        domain.occupied, domain.clearance, body.samples + shift, body.around + shift, body.outline + shift,
        outlines, starts, *step.touch, *direction, needed_clearance(domain.robot.radius_m / domain.map.resolution_m, SWEEP_STEP), limit,
    )  # fmt: skip
    if body.robot is not None and found > 0.0:
        heading = float(np.arctan2(direction[1], direction[0]))
        driven = free_drive(domain.counts, body.robot, *step.approach, heading, heuristic.stand_off + found)
        found = max(min(found, driven - heuristic.stand_off), 0.0)
    return found


def opening_at(
    domain: SearchDomain,
    shifts: Shifts,
    index: int,
    direction: Point,
    limit: float,
    robot: Point,
    among: Among,
) -> Float[np.ndarray, "k"]:
    """Push lengths [cells] at which the robot's side of a body is connected with other free space around the body.

    Parameters
    ----------
    domain
        Static map and bodies.
    shifts
        Displacements of the bodies from their mapped positions [cells].
    index
        Index of the pushed body.
    direction
        Direction of the push.
    limit
        Collision-free push distance [cells].
    robot
        Position of the robot [cells].
    among
        Mask of the bodies that count as obstacles.
    """

    block, shift = domain.block, shifts[index]
    grow = domain.radius + 4.0 * block
    low = np.maximum((domain.extents[0][index] + shift - grow) // block, 0).astype(int)
    high = np.maximum((domain.extents[1][index] + shift + grow) // block + 1, low).astype(int)
    corner = low * float(block)
    without = domain.part(domain.lattice, low, high, shifts, block, among)
    found: Float[np.ndarray, "k"] = opening_lengths(
        without, domain.bodies[index].kept_clear + shift - corner, *direction, domain.closed_below, block, limit,
        *(robot - corner), *(domain.goal - corner),
    )  # fmt: skip
    return found


def end_of_push(domain: SearchDomain, step: PushStep) -> tuple[float, Float[np.ndarray, "3 3"]]:
    """Predicted rotation [rad], and covariance of x, y [m] and rotation about the planned position, so rotated, map frame.

    The 90 % ellipsoid holds 90 % of the simulated pushes.

    Parameters
    ----------
    domain
        Robot, map and bodies.
    step
        The push.
    """
    errors = end_errors(domain, step.body, step.contact, step.length)
    # A push perpendicular to a face rotates its object to either side alike.
    turn_rad = float(errors[:, 2].mean()) * domain.bodies[step.body].push(step.contact).oblique
    errors[:, 2] -= turn_rad
    errors[:, :2] = errors[:, :2] @ rotation_2d(domain.map.origin[2]).T
    return turn_rad, covariance_of_ends(errors)


def replanning_units(heuristic: PushHeuristic, steps: tuple[PushStep, ...], start: Point) -> float:
    """Expected cost of additional pushes where an object of the plan ends in a pose that blocks a later drive [units].

    Such an object is pushed once more, at least by its shortest push.

    Parameters
    ----------
    heuristic
        Heuristic of the search, with its domain, goal and push costs.
    steps
        Pushes in order, with known drives.
    start
        Start position of the robot [cells].
    """
    import shapely

    domain = heuristic.domain
    if not (steps and heuristic.costs.price_ends):
        return 0.0
    drives = drives_cells(domain, steps, start)
    total = 0.0
    for index, step in enumerate(steps):
        again = next((k for k in range(index + 1, len(steps)) if steps[k].body == step.body), len(steps))
        body = domain.bodies[step.body]
        errors = end_errors(domain, step.body, step.contact, step.length, PRICED)
        outlines = body.placed(body.outline, errors, domain.map.resolution_m) + step.shifts_after[step.body]
        closed = 0.0
        grow = domain.radius + 1.0
        low, high = outlines.min(axis=(0, 1)) - grow, outlines.max(axis=(0, 1)) + grow
        polygons = shapely.polygons(outlines)
        for k in range(index + 1, again + 1):
            beside = np.flatnonzero(((drives[k] > low) & (drives[k] < high)).all(axis=1))
            if not len(beside):
                continue
            drive = drives[k][max(beside[0] - 1, 0) : beside[-1] + 2]
            near = outlines[shapely.distance(polygons, shapely.linestrings(drive)) < domain.radius]
            if len(near):
                some = near[:: -(-len(near) // LOOKED_AT)]
                cut = _closed(domain, steps[k - 1].shifts_after, step.body, some, drives[k])
                closed = max(closed, float(cut.mean()) * len(near) / PRICED)
        total += closed * heuristic.shortest_push(step.body)
    return total


def _closed(
    domain: SearchDomain, shifts: Shifts, index: int, outlines: Float[np.ndarray, "n p 2"], drive: Path
) -> Bool[np.ndarray, "n"]:
    """Whether a body at each outline [cells] blocks a drive, within a window of the map around all outlines."""

    grow = 4.0 * domain.radius + 4.0 * domain.block
    low = np.maximum(np.floor(outlines.min(axis=(0, 1)) - grow), 0).astype(int)
    high = np.maximum(np.ceil(outlines.max(axis=(0, 1)) + grow), low).astype(int)
    # On the lattice passages appear wider by up to a node.
    layer = domain.part(domain.clearance, low, high, shifts, 1, np.arange(len(domain.bodies)) != index)
    ends = np.flatnonzero(((drive >= low) & (drive < high)).all(axis=1))[[0, -1]]
    found = np.zeros(len(outlines), dtype=bool)
    for number, outline in enumerate(outlines):
        among = layer.copy()
        lower_clearance(among, outline - low, domain.radius)
        begin, end = (domain.seeds(among, drive[k] - low, reach=2, block=1)[0] for k in ends)
        found[number] = not _travel_kernels.flood(among, domain.radius, begin, end)[end].any()
    return found
