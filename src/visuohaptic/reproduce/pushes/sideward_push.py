"""Sideward push: drive past and brush the object aside without a stop (Alt 2016, Sec. 4.3.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import product

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ...core.ranges import NON_NEGATIVE, POSITIVE, check_ranges
from ...io.maps.occupancy_map import OccupancyMap
from ...navigation.pushing.push_failure import PushUncertainty
from ...navigation.pushing.quasi_static import PushTrace, arc_path, remaining_m, simulate_push
from .push_scene import PushedObject, PushLimits, PushScene

__all__ = [
    "SidewardOutcome",
    "SidewardPush",
    "SidewardPushSettings",
    "evaluate_push",
    "plan_sideward_push",
    "sideward_candidates",
]

#: Largest distance of start and end from the object: "about 6 r_rob" (Sec. 4.3.2).
SLIDE_M = 1.0
#: Turns of the curves that are tried when all lines fail (rad).
TURNS_RAD = (-0.8, -0.4, 0.4, 0.8)
#: Plans whose failure is simulated.
REFINED = 5


class SidewardOutcome(StrEnum):
    """What becomes of a candidate."""

    RELEASED = "released"  #: success: contact was lost before the end
    CONTACT = "contact"  #: still in contact at the end
    COLLISION = "collision"  #: the object meets another obstacle
    BLOCKED = "blocked"  #: the platform has no room on its path
    UNTOUCHED = "untouched"  #: the platform never meets the object


@dataclass(frozen=True, slots=True)
class SidewardPushSettings:
    """How a sideward push is searched for."""

    slide_m: float = field(
        default=SLIDE_M, metadata=POSITIVE
    )  #: maximum length of the drive behind the object
    unknown_is_free: bool = False  #: whether the platform may enter cells that were never observed
    samples: int = field(default=24, metadata=NON_NEGATIVE)  #: simulated drives per plan; 0 for none

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True, slots=True, eq=False)
class SidewardPush:
    """One drive past the object; all in the map frame."""

    path_m: Float[np.ndarray, "k 3"]  #: of the platform: x, y, heading
    trace: PushTrace  #: predicted motion of the object
    outcome: SidewardOutcome
    cost_s: float  #: setup, and the drive at the speed of pushing
    failure_probability: float


def sideward_candidates(
    scene: PushScene,
    enter_m: Sequence[float],
    leave_m: Sequence[float],
    *,
    slide_m: float = SLIDE_M,
    starts: int = 9,
    ends: int = 9,
) -> tuple[Float[np.ndarray, "a 2"], Float[np.ndarray, "b 2"]]:
    """Start and end points of the platform's path, map frame [m].

    Starts lie a radius away from the outline on the side of ``enter_m``, ends
    up to ``slide_m`` from the object on the side of ``leave_m``; both where
    the platform has room.

    Parameters
    ----------
    scene
        Object, local costmap and platform.
    enter_m, leave_m
        Where the platform comes from and has to go: x, y [m], map frame.
    slide_m
        Maximum distance of an end from the object [m].
    starts
        Maximum number of start points.
    ends
        Half of the maximum number of end points: directions at two distances each.

    Raises
    ------
    InputError
        ``enter_m`` and ``leave_m`` are one place.
    """
    import shapely

    model, radius_m = scene.model, scene.limits.radius_m
    outline = _placed(model.outline_m, scene.object_m)
    shape = shapely.Polygon(outline) if len(outline) > 2 else shapely.MultiPoint(outline)
    # A millimetre off: a start that touches would be one that has begun.
    ring = shape.buffer(model.round_m + radius_m + 1e-3).exterior
    centre = np.array(shape.centroid.coords[0])
    ahead = np.asarray(leave_m, dtype=np.float64)[:2] - np.asarray(enter_m, dtype=np.float64)[:2]
    length = float(np.hypot(*ahead))
    if not length > 0:
        raise InputError(
            "sideward_candidates", f"found enter {enter_m} and leave {leave_m}, expected two places"
        )
    ahead = ahead / length
    points = np.array(
        [ring.interpolate(s).coords[0] for s in np.linspace(0, ring.length, 120, endpoint=False)]
    )
    front = (points - centre) @ ahead < -0.3 * radius_m
    begins = _with_room(scene, points[front])
    # Ends: over the directions within a right angle of the direction of leaving, near and far.
    angle = np.linspace(-1.2, 1.2, 2 * ends + 1)
    reach = float(ring.distance(shapely.Point(*centre)))
    far = np.array([1.0, 0.75]) * (slide_m + reach)
    c, s = np.cos(angle), np.sin(angle)
    rays = np.column_stack([c * ahead[0] - s * ahead[1], s * ahead[0] + c * ahead[1]])
    goals = np.concatenate([centre + distance * rays for distance in far])
    goals = _with_room(scene, goals)
    goals = goals[np.argsort(np.hypot(*(goals - np.asarray(leave_m)[:2]).T), kind="stable")]
    return _thinned(begins, starts), goals[: 2 * ends]


def evaluate_push(
    scene: PushScene, path_m: Float[np.ndarray, "k 3"]
) -> tuple[SidewardOutcome, PushTrace | None]:
    """Simulate one candidate and classify what becomes of it.

    Parameters
    ----------
    scene
        Object, local costmap and platform.
    path_m
        Poses of the platform: x, y [m], heading [rad], map frame.

    Returns
    -------
    The outcome, and the simulated motion; no motion where the platform has no room on its path.

    Raises
    ------
    InputError
        The platform starts inside the object.
    """
    from ._ground_kernels import first_clash, min_distance

    costmap, footprint = scene.costmap, scene.footprint
    if min_distance(costmap.distance_m, costmap.grid, path_m) < scene.limits.radius_m:
        return SidewardOutcome.BLOCKED, None
    trace = simulate_push(scene.model, scene.object_m, path_m, scene.limits.radius_m)
    if not trace.touched:
        return SidewardOutcome.UNTOUCHED, trace
    rows = trace.last_contact + 1
    clash = first_clash(
        costmap.distance_m, costmap.grid, footprint.inner_m, costmap.margin_m, footprint.inside_m,
        footprint.reach_m, trace.object_m, rows,
    )  # fmt: skip
    if clash < rows:
        return SidewardOutcome.COLLISION, trace
    return (SidewardOutcome.RELEASED if trace.released else SidewardOutcome.CONTACT), trace


def plan_sideward_push(
    map: OccupancyMap,
    obj: PushedObject,
    enter_m: Sequence[float],
    leave_m: Sequence[float],
    limits: PushLimits | None = None,
    *,
    settings: SidewardPushSettings | None = None,
    rng: np.random.Generator | None = None,
) -> tuple[SidewardPush, ...]:
    """Plans of a sideward push, the best first; empty where none succeeds.

    Parameters
    ----------
    map
        With or without the object's cells.
    obj
        Its footprint, and what is known of it.
    enter_m, leave_m
        Where the platform comes from and has to go: x, y [m], map frame, on both sides of the object.
    limits
        The platform.
    settings
        Length of the drive behind the object, number of simulations.
    rng
        Of the simulated pushes.

    Returns
    -------
    Sorted by expected cost, cost / (1 - probability of failure). Arcs are
    tried only when no straight drive succeeds.

    Raises
    ------
    InputError
        The footprint is not an outline or not on the map, or ``enter_m`` and ``leave_m`` are one place.
    """
    limits = limits if limits is not None else PushLimits()
    settings = settings if settings is not None else SidewardPushSettings()
    if not obj.pushable(limits):
        return ()
    scene = PushScene.of(
        map, obj, limits, settings.slide_m + 3 * limits.radius_m, unknown_is_free=settings.unknown_is_free
    )
    starts, ends = sideward_candidates(scene, enter_m, leave_m, slide_m=settings.slide_m)
    plans: list[SidewardPush] = []
    for turns in ((0.0,), TURNS_RAD):
        for start, end, turn in product(starts, ends, turns):
            path = arc_path(start, end, turn)
            outcome, trace = evaluate_push(scene, path)
            if outcome is SidewardOutcome.RELEASED and trace is not None:
                plans.append(SidewardPush(path, trace, outcome, _cost_s(path, limits), 0.0))
        if plans:
            break
    plans.sort(key=lambda plan: plan.cost_s - _reserve_s(plan, limits))
    if settings.samples > 0 and plans:
        rng = rng if rng is not None else np.random.default_rng(0)
        refined = [
            replace(plan, failure_probability=_failure(scene, plan, settings.samples, rng))
            for plan in plans[:REFINED]
        ]
        refined.sort(key=lambda plan: plan.cost_s / max(1.0 - plan.failure_probability, 1e-3))
        plans = refined + plans[REFINED:]
    return tuple(plans)


def _failure(scene: PushScene, plan: SidewardPush, samples: int, rng: np.random.Generator) -> float:
    """Fraction of simulated drives that neither release the object nor pass it."""
    failed = 0
    for _ in range(samples):
        sampled = scene.sampled(*PushUncertainty().sample(scene.model, scene.object_m, rng))
        try:
            outcome, _ = evaluate_push(sampled, plan.path_m)
        except InputError:
            # Sampled into the platform's start: the drive would begin a little earlier.
            back = plan.path_m[:1] - 0.05 * np.array(
                [np.cos(plan.path_m[0, 2]), np.sin(plan.path_m[0, 2]), 0.0]
            )
            try:
                outcome, _ = evaluate_push(sampled, np.concatenate([back, plan.path_m]))
            except InputError:
                outcome = SidewardOutcome.CONTACT
        failed += outcome not in (SidewardOutcome.RELEASED, SidewardOutcome.UNTOUCHED)
    return failed / samples


def _cost_s(path_m: Float[np.ndarray, "k 3"], limits: PushLimits) -> float:
    return limits.setup_time_s + remaining_m(path_m, 0) / limits.v_push_m_s


def _reserve_s(plan: SidewardPush, limits: PushLimits) -> float:
    """Seconds between release and end: an early release is worth as much as a shorter path, up to 0.2 m."""
    return min(remaining_m(plan.path_m, plan.trace.last_contact), 0.2) / limits.v_push_m_s


def _placed(
    points_m: Float[np.ndarray, "m 2"], object_m: tuple[float, float, float]
) -> Float[np.ndarray, "m 2"]:
    c, s = np.cos(object_m[2]), np.sin(object_m[2])
    return points_m @ np.array([[c, s], [-s, c]]) + np.array(object_m[:2])


def _with_room(scene: PushScene, points_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "m 2"]:
    return points_m[scene.costmap.distance_at(points_m) >= scene.limits.radius_m]


def _thinned(points_m: Float[np.ndarray, "n 2"], count: int) -> Float[np.ndarray, "m 2"]:
    """At most ``count`` of the points, evenly over their order."""
    if len(points_m) <= count:
        return points_m
    return points_m[np.linspace(0, len(points_m) - 1, count).round().astype(int)]
