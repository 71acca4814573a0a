"""Direct push: contact point, path and goal that open a way, one plan after the other (Alt 2016, Sec. 4.3.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from ...core.errors import InputError
from ...core.geometry import polygon_centroid, rotation_2d
from ...core.objects import HapticTag
from ...io.maps.occupancy_map import OccupancyMap
from ..problem.push_costs import failure_probability
from .goal_maps import _path_distance
from .local_costmap import Footprint, LocalGround, local_ground
from .push_failure import PushUncertainty, centre_from_tag, simulated_failure
from .push_model import PushModel

__all__ = ["ContactPoint", "DirectPush", "PushLimits", "contact_points", "plan_direct_push"]

#: Directions that are tried.
DIRECTIONS = 72
#: Distance between places along a push (m).
STEP_M = 0.02
#: Plans whose failure is simulated.
REFINED = 6


@dataclass(frozen=True, slots=True)
class PushLimits:
    """The platform as far as a push is concerned."""

    radius_m: float = 0.17
    v_push_m_s: float = 0.05
    setup_time_s: float = 4.0
    push_force_max_N: float = 20.0
    #: angle between push and the outline's normal at the contact; more would slide
    tolerance_rad: float = 0.35

    def __post_init__(self) -> None:
        values = (self.radius_m, self.v_push_m_s, self.push_force_max_N, self.tolerance_rad)
        if not (all(math.isfinite(v) and v > 0 for v in values) and self.setup_time_s >= 0):
            raise InputError("PushLimits", f"found {self}, expected numbers > 0")


@dataclass(frozen=True, slots=True, eq=False)
class ContactPoint:
    """Where the platform can begin a straight push through the centre of friction."""

    point_m: Float[np.ndarray, "2"]  #: x on the outline
    platform_m: Float[np.ndarray, "3"]  #: pose of the platform that touches there, heading along the push
    slant_rad: float  #: angle between push and the outline's normal


@dataclass(frozen=True, slots=True, eq=False)
class DirectPush:
    """One way to push an object out of the way; all in the map frame."""

    contact: ContactPoint  #: x
    path_m: Float[np.ndarray, "k 3"]  #: v, of the platform: x, y, heading
    object_goal_m: Float[np.ndarray, "3"]  #: y: x, y of the footprint's centroid, turn from now
    length_m: float
    cost_s: float  #: setup and push
    failure_probability: float


def contact_points(
    ground: LocalGround,
    model: PushModel,
    object_m: tuple[float, float, float],
    limits: PushLimits,
    *,
    centre_offset_m: Float[np.ndarray, "2"] | None = None,
    reachable: Bool[np.ndarray, "rows columns"] | None = None,
    directions: int = DIRECTIONS,
) -> tuple[ContactPoint, ...]:
    """Places (a) on the outline, (b) with room for the platform, (c) that it can reach, (d) that push straight.

    Parameters
    ----------
    ground
        Surroundings without the object.
    model, object_m
        Outline, and where its reference point stands: x, y [m], yaw [rad].
    centre_offset_m
        Centre of friction from the outline's centroid, map frame; see ``centre_from_tag``.
    reachable
        Cells that the platform can drive to while the object stands.
    """
    from ._push_kernels import touch_along

    turn = rotation_2d(object_m[2])
    centre = polygon_centroid(model.outline_m)
    if centre_offset_m is not None:
        centre = centre + np.asarray(centre_offset_m) @ turn
    place = np.array(object_m[:2])
    contacts = np.zeros((4, 6))
    far = 2.0 * model.reach_m + limits.radius_m + float(np.hypot(*centre)) + 0.1
    found = []
    for direction in np.arange(directions) * (2 * math.pi / directions):
        ahead = np.array([math.cos(direction), math.sin(direction)])
        own = ahead @ turn
        away = touch_along(
            model.outline_m,
            model.round_m,
            centre[0],
            centre[1],
            own[0],
            own[1],
            limits.radius_m,
            far,
            contacts,
        )
        if away < 0:
            continue
        normal = turn @ contacts[0, :2]
        slant = math.acos(min(1.0, max(-1.0, float(normal @ ahead))))
        platform = place + turn @ centre - away * ahead
        if slant > limits.tolerance_rad or float(ground.distance_at(platform)) < limits.radius_m:
            continue
        if reachable is not None:
            # The cell where it stands touching is nearer to the object than it drives.
            back = ground.map.cell_from_world(platform - 1.5 * ground.map.resolution_m * ahead)
            if not (bool(ground.map.inside(back)) and reachable[back[0], back[1]]):
                continue
        point = place + turn @ contacts[0, 2:4]
        found.append(ContactPoint(point, np.array([*platform, direction]), slant))
    return tuple(found)


def plan_direct_push(
    map: OccupancyMap,
    footprint_m: Float[np.ndarray, "p 2"],
    limits: PushLimits | None = None,
    *,
    robot_m: Sequence[float] | None = None,
    blocked_path_m: Float[np.ndarray, "k 2"] | None = None,
    tag: HapticTag | None = None,
    tag_direction_rad: float | None = None,
    model: PushModel | None = None,
    reach_m: float = 1.0,
    curvatures_per_m: Sequence[float] = (0.0,),
    unknown_is_free: bool = False,
    samples: int = 16,
    rng: np.random.Generator | None = None,
) -> tuple[DirectPush, ...]:
    """Plans of a direct push, the best first; empty where the object cannot be pushed out of the way.

    Parameters
    ----------
    map
        With or without the object's cells.
    footprint_m
        Its outline in the map frame.
    limits
        The platform.
    robot_m
        Where the platform is (x, y); contacts that it cannot reach are left out.
        Without it all that have room are kept.
    blocked_path_m
        The path to open; without it, any place that blocks nothing is a goal.
    tag
        What a former push has told; one that is fixed, falls or is too heavy is never pushed.
    tag_direction_rad
        Direction of that push on the object as it now stands, map frame: with
        it the contact goes to the centre of friction that the tag tells of.
    model
        Outline about the footprint's centroid, supports, contact friction; by
        default a flat bottom.
    reach_m
        r_mani: largest length of a push.
    curvatures_per_m
        Path primitives. Only the straight one is reliable with a platform that
        holds nothing sideways; curves are for others.
    samples
        Simulated pushes per plan for its probability of failure; 0 for the tag alone.

    Returns
    -------
    Sorted by expected cost, cost / (1 - probability of failure).
    """
    limits = limits if limits is not None else PushLimits()
    if tag is not None and (tag.fixed or tag.falls or tag.needs_more_than(limits.push_force_max_N)):
        return ()
    outline = np.asarray(footprint_m, dtype=np.float64)
    ground = local_ground(map, outline, reach_m + 2.5 * limits.radius_m, unknown_is_free=unknown_is_free)
    place = polygon_centroid(outline)
    object_m = (float(place[0]), float(place[1]), 0.0)
    if model is None:
        model = PushModel.patch(outline - place)
    footprint = Footprint.of(model.outline_m, limits.radius_m, map.resolution_m, round_m=model.round_m)
    reachable = None
    if robot_m is not None:
        reachable = ground.reachable(np.asarray(robot_m, dtype=np.float64)[:2], outline, limits.radius_m)
    offset = None
    if tag_direction_rad is not None:
        offset = centre_from_tag(tag, tag_direction_rad, model, limits.radius_m)
        model = model.with_centre_moved(float(offset[0]), float(offset[1]))
    contacts = contact_points(ground, model, object_m, limits, centre_offset_m=offset, reachable=reachable)
    from_path = _path_distance(ground, blocked_path_m)
    plans = []
    for contact in contacts:
        for curvature in curvatures_per_m:
            plan = _push(contact, curvature, object_m, ground, footprint, from_path, limits, reach_m, tag)
            if plan is not None:
                plans.append(plan)
    plans.sort(key=_expected_s)
    if samples > 0 and plans:
        rng = rng if rng is not None else np.random.default_rng(0)
        refined = [_simulated(plan, model, object_m, limits, rng, samples) for plan in plans[:REFINED]]
        plans = sorted(refined, key=_expected_s) + plans[REFINED:]
    return tuple(plans)


def _push(
    contact: ContactPoint,
    curvature: float,
    object_m: tuple[float, float, float],
    ground: LocalGround,
    footprint: Footprint,
    from_path: Float[np.ndarray, "rows columns"],
    limits: PushLimits,
    reach_m: float,
    tag: HapticTag | None,
) -> DirectPush | None:
    """The shortest push from one contact along one primitive, or ``None``."""
    from ._ground_kernels import first_goal

    platforms = _primitive(contact.platform_m, curvature, reach_m)
    turn = platforms[:, 2] - platforms[0, 2]
    lever = np.array(object_m[:2]) - platforms[0, :2]
    c, s = np.cos(turn), np.sin(turn)
    objects = np.column_stack(
        [
            platforms[:, 0] + c * lever[0] - s * lever[1],
            platforms[:, 1] + s * lever[0] + c * lever[1],
            object_m[2] + turn,
        ]
    )
    row = first_goal(
        ground.distance_m,
        from_path,
        ground.grid,
        footprint.inner_m,
        footprint.ring_m,
        footprint.border_m,
        ground.margin_m,
        footprint.inside_m,
        footprint.reach_m,
        limits.radius_m,
        objects,
        platforms,
    )
    if row < 0:
        return None
    length = STEP_M * row
    cost = limits.setup_time_s + length / limits.v_push_m_s
    failure = failure_probability(tag, length, limits)
    # A slanted contact slides first: one that is at the tolerance counts as half as good.
    failure = 1.0 - (1.0 - failure) * (1.0 - 0.5 * (contact.slant_rad / limits.tolerance_rad) ** 2)
    return DirectPush(contact, platforms[: row + 1], objects[row], length, cost, failure)


def _primitive(
    start_m: Float[np.ndarray, "3"], curvature: float, length_m: float
) -> Float[np.ndarray, "k 3"]:
    """Poses on an arc of a curvature [1/m], ``STEP_M`` apart."""
    s = STEP_M * np.arange(int(length_m / STEP_M) + 1)
    heading = start_m[2] + curvature * s
    # Chord of each part of the arc: length s sinc, direction half way.
    half = 0.5 * curvature * s
    reach = s * np.sinc(half / math.pi)
    direction = start_m[2] + half
    return np.column_stack(
        [start_m[0] + reach * np.cos(direction), start_m[1] + reach * np.sin(direction), heading]
    )


def _simulated(
    plan: DirectPush,
    model: PushModel,
    object_m: tuple[float, float, float],
    limits: PushLimits,
    rng: np.random.Generator,
    samples: int,
) -> DirectPush:
    fraction = simulated_failure(
        model, object_m, plan.path_m, limits.radius_m, rng, doubt=PushUncertainty(), samples=samples
    )
    return replace(plan, failure_probability=max(plan.failure_probability, fraction))


def _expected_s(plan: DirectPush) -> float:
    return plan.cost_s / max(1.0 - plan.failure_probability, 1e-3)
