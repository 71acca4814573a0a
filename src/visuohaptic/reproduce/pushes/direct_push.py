"""Direct push: contact point, path and goal of a push that clears a path (Alt 2016, Sec. 4.3.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Float32

from ...core.geometry import polygon_centroid, rotation_2d
from ...core.objects import HapticTag
from ...core.ranges import NON_NEGATIVE, POSITIVE, check_ranges
from ...io.maps.occupancy_map import OccupancyMap
from ...navigation.problem.push_costs import failure_probability
from .goal_maps import are_goals, clashes, path_distance
from .push_failure import centre_from_tag, simulated_failure
from .push_scene import PushedObject, PushLimits, PushScene

__all__ = ["ContactPoint", "DirectPush", "DirectPushSettings", "contact_points", "plan_direct_push"]

#: Directions that are tried.
DIRECTIONS = 72
#: Distance between places along a push (m).
STEP_M = 0.02
#: Plans whose failure is simulated.
REFINED = 6


@dataclass(frozen=True, slots=True)
class DirectPushSettings:
    """How a direct push is searched for."""

    reach_m: float = field(default=1.0, metadata=POSITIVE)  #: r_mani: maximum length of a push
    samples: int = field(default=16, metadata=NON_NEGATIVE)  #: simulated pushes per plan; 0 for the tag alone

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True, slots=True, eq=False)
class ContactPoint:
    """Where the platform can begin a straight push through the centre of friction."""

    point_m: Float[np.ndarray, "2"]  #: x on the outline
    platform_m: Float[np.ndarray, "3"]  #: pose of the platform that touches there, heading along the push
    tilt_rad: float  #: angle between push and the outline's normal


@dataclass(frozen=True, slots=True, eq=False)
class DirectPush:
    """One plan that pushes an object out of the way; all in the map frame."""

    contact: ContactPoint  #: x
    path_m: Float[np.ndarray, "k 3"]  #: v, of the platform: x, y, heading
    object_goal_m: Float[np.ndarray, "3"]  #: y: x, y of the footprint's centroid, turn from now
    length_m: float
    cost_s: float  #: setup and push
    failure_probability: float


def contact_points(
    scene: PushScene,
    *,
    centre_offset_m: Float[np.ndarray, "2"] | None = None,
    reachable: Bool[np.ndarray, "rows columns"] | None = None,
) -> tuple[ContactPoint, ...]:
    """Contacts (a) on the outline, (b) with room for the platform, (c) that it can reach, (d) that push straight.

    A fan of directions, each within ``tolerance_rad`` of the outline's normal. The search over pushes takes the
    perpendiculars of the faces instead, see
    :func:`~visuohaptic.navigation.pushing.contact_candidates.push_contacts`.

    Parameters
    ----------
    scene
        Object, local costmap and platform.
    centre_offset_m
        Centre of friction from the outline's centroid [m], map frame; see ``centre_from_tag``.
    reachable
        Cells of the costmap that the platform can drive to while the object stands.
    """
    from ...navigation.pushing._contact_kernels import touch_along

    model, object_m, costmap, limits = scene.model, scene.object_m, scene.costmap, scene.limits
    turn = rotation_2d(object_m[2])
    centre = polygon_centroid(model.outline_m)
    if centre_offset_m is not None:
        centre = centre + np.asarray(centre_offset_m) @ turn
    place = np.array(object_m[:2])
    contacts = np.zeros((4, 6))
    far = 2.0 * model.reach_m + limits.radius_m + float(np.hypot(*centre)) + 0.1
    found = []
    for direction in np.arange(DIRECTIONS) * (2 * math.pi / DIRECTIONS):
        ahead = np.array([math.cos(direction), math.sin(direction)])
        own = ahead @ turn
        away = touch_along(
            model.outline_m, model.round_m, centre[0], centre[1], own[0], own[1], limits.radius_m, far, contacts
        )  # fmt: skip
        if away < 0:
            continue
        normal = turn @ contacts[0, :2]
        tilt = math.acos(min(1.0, max(-1.0, float(normal @ ahead))))
        platform = place + turn @ centre - away * ahead
        if tilt > limits.tolerance_rad or float(costmap.distance_at(platform)) < limits.radius_m:
            continue
        if reachable is not None:
            # The cell where it stands touching is nearer to the object than it drives.
            back = costmap.map.cell_from_world(platform - 1.5 * costmap.map.resolution_m * ahead)
            if not (bool(costmap.map.inside(back)) and reachable[back[0], back[1]]):
                continue
        point = place + turn @ contacts[0, 2:4]
        found.append(ContactPoint(point, np.array([*platform, direction]), tilt))
    return tuple(found)


def plan_direct_push(
    map: OccupancyMap,
    obj: PushedObject,
    limits: PushLimits | None = None,
    *,
    robot_m: Sequence[float] | None = None,
    blocked_path_m: Float[np.ndarray, "k 2"] | None = None,
    settings: DirectPushSettings | None = None,
    rng: np.random.Generator | None = None,
) -> tuple[DirectPush, ...]:
    """Plans of a direct push, the best first; empty where the object cannot be pushed out of the way.

    Parameters
    ----------
    map
        With or without the object's cells.
    obj
        Its footprint, and what is known of it.
    limits
        The platform.
    robot_m
        Where the platform is: x, y [m], map frame; contacts that it cannot reach are left out.
        Without it all that have room are kept.
    blocked_path_m
        The path to open, map frame [m]; without it, any place that blocks nothing is a goal.
    settings
        Length of the push, number of simulations.
    rng
        Of the simulated pushes.

    Returns
    -------
    Sorted by expected cost, cost / (1 - probability of failure).

    Raises
    ------
    InputError
        The footprint is not an outline or not on the map.
    """
    limits = limits if limits is not None else PushLimits()
    settings = settings if settings is not None else DirectPushSettings()
    if not obj.pushable(limits):
        return ()
    scene = PushScene.of(map, obj, limits, settings.reach_m + 2.5 * limits.radius_m)
    reachable = None
    if robot_m is not None:
        robot = np.asarray(robot_m, dtype=np.float64)[:2]
        reachable = scene.costmap.reachable(robot, np.asarray(obj.footprint_m, np.float64), limits.radius_m)
    offset = None
    if obj.tag_direction_rad is not None:
        offset = centre_from_tag(obj.tag, obj.tag_direction_rad, scene.model, limits.radius_m)
        scene = replace(scene, model=scene.model.with_centre_moved(float(offset[0]), float(offset[1])))
    from_path = path_distance(scene.costmap, blocked_path_m)
    plans = [
        plan
        for contact in contact_points(scene, centre_offset_m=offset, reachable=reachable)
        if (plan := _shortest_push(scene, contact, from_path, settings.reach_m, obj.tag)) is not None
    ]  # fmt: skip
    plans.sort(key=_expected_s)
    if settings.samples > 0 and plans:
        rng = rng if rng is not None else np.random.default_rng(0)
        refined = [_simulated(plan, scene, rng, settings.samples) for plan in plans[:REFINED]]
        plans = sorted(refined, key=_expected_s) + plans[REFINED:]
    return tuple(plans)


def _shortest_push(
    scene: PushScene,
    contact: ContactPoint,
    from_path: Float32[np.ndarray, "rows columns"],
    reach_m: float,
    tag: HapticTag | None,
) -> DirectPush | None:
    """The shortest push from one contact along a straight line, or ``None``."""
    object_m, costmap, footprint, limits = scene.object_m, scene.costmap, scene.footprint, scene.limits
    heading = contact.platform_m[2]
    moved = np.outer(
        STEP_M * np.arange(int(reach_m / STEP_M) + 1), [math.cos(heading), math.sin(heading), 0.0]
    )
    platforms, objects = contact.platform_m + moved, np.array(object_m) + moved
    # An object that stands at a wall begins with samples too near to it: they do not become more.
    bad = np.diff(clashes(costmap, footprint, objects), prepend=np.inf) > 0
    bad |= costmap.distance_at(platforms[:, :2]) < limits.radius_m
    goals = are_goals(costmap, footprint, objects, limits.radius_m, from_path)
    goals[0] = False
    row = int(np.argmax(goals | bad))
    if bad[row] or not goals[row]:
        return None
    length = STEP_M * row
    cost = limits.setup_time_s + length / limits.v_push_m_s
    failure = failure_probability(tag, length, limits)
    # An oblique contact slides first: one that is at the tolerance counts as half as good.
    failure = 1.0 - (1.0 - failure) * (1.0 - 0.5 * (contact.tilt_rad / limits.tolerance_rad) ** 2)
    return DirectPush(contact, platforms[: row + 1], objects[row], length, cost, failure)


def _simulated(plan: DirectPush, scene: PushScene, rng: np.random.Generator, samples: int) -> DirectPush:
    """The plan with the larger of both failure probabilities: from the tag, and from simulation."""
    fraction = simulated_failure(
        scene.model, scene.object_m, plan.path_m, scene.limits.radius_m, rng, samples=samples
    )
    return replace(plan, failure_probability=max(plan.failure_probability, fraction))


def _expected_s(plan: DirectPush) -> float:
    return plan.cost_s / max(1.0 - plan.failure_probability, 1e-3)
