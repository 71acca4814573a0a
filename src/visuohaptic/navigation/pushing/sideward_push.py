"""Sideward push: drive past and brush the object aside without a stop (Alt 2016, Sec. 4.3.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from jaxtyping import Bool, Float

from ...core.errors import InputError
from ...core.geometry import polygon_centroid
from ...core.objects import HapticTag
from ...io.maps.occupancy_map import OccupancyMap
from .direct_push import PushLimits
from .local_costmap import Footprint, LocalGround, local_ground
from .push_failure import PushUncertainty
from .push_model import PushModel
from .quasi_static import PushTrace, arc_path, simulate_push

__all__ = ["Outcome", "SidewardPush", "judge_push", "plan_sideward_push", "sideward_candidates"]

#: Largest distance of start and end from the object: "about 6 r_rob" (Sec. 4.3.2).
SLIDE_M = 1.0
#: Turns of the curves that are tried when all lines fail (rad).
TURNS_RAD = (-0.8, -0.4, 0.4, 0.8)
#: Plans whose failure is simulated.
REFINED = 5


class Outcome(StrEnum):
    """What becomes of a candidate."""

    DROPPED = "dropped"  #: success: contact was lost before the end
    CONTACT = "contact"  #: still in contact at the end
    COLLISION = "collision"  #: the object meets another obstacle
    BLOCKED = "blocked"  #: the platform has no room on its path
    UNTOUCHED = "untouched"  #: the platform never meets the object


@dataclass(frozen=True, slots=True, eq=False)
class SidewardPush:
    """One drive past the object; all in the map frame."""

    path_m: Float[np.ndarray, "k 3"]  #: of the platform: x, y, heading
    trace: PushTrace  #: foreseen motion of the object
    outcome: Outcome
    cost_s: float  #: setup, and the drive at the speed of pushing
    failure_probability: float

    @property
    def drop_m(self) -> Float[np.ndarray, "3"]:
        """Pose of the platform at the drop point."""
        return self.path_m[max(self.trace.last_contact, 0)]


def sideward_candidates(
    ground: LocalGround,
    model: PushModel,
    object_m: tuple[float, float, float],
    enter_m: Sequence[float],
    leave_m: Sequence[float],
    radius_m: float,
    *,
    slide_m: float = SLIDE_M,
    starts: int = 9,
    ends: int = 9,
    start_region: Bool[np.ndarray, "rows columns"] | None = None,
    end_region: Bool[np.ndarray, "rows columns"] | None = None,
) -> tuple[Float[np.ndarray, "a 2"], Float[np.ndarray, "b 2"]]:
    """Starting and end points of the platform.

    Starts lie a radius away from the outline on the side of ``enter_m``, ends
    up to ``slide_m`` from the object on the side of ``leave_m``; both where
    the platform has room, and in the regions where they are given.
    """
    import shapely

    outline = _placed(model.outline_m, object_m)
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
    begins = _with_room(ground, points[front], radius_m, start_region)
    # Ends: over the directions within a right angle of the way out, near and far.
    angle = np.linspace(-1.2, 1.2, 2 * ends + 1)
    reach = float(ring.distance(shapely.Point(*centre)))
    far = np.array([1.0, 0.75]) * (slide_m + reach)
    c, s = np.cos(angle), np.sin(angle)
    rays = np.column_stack([c * ahead[0] - s * ahead[1], s * ahead[0] + c * ahead[1]])
    goals = np.concatenate([centre + distance * rays for distance in far])
    goals = _with_room(ground, goals, radius_m, end_region)
    goals = goals[np.argsort(np.hypot(*(goals - np.asarray(leave_m)[:2]).T), kind="stable")]
    return _spread(begins, starts), goals[: 2 * ends]


def judge_push(
    ground: LocalGround,
    footprint: Footprint,
    model: PushModel,
    object_m: tuple[float, float, float] | Float[np.ndarray, "3"],
    path_m: Float[np.ndarray, "k 3"],
    radius_m: float,
) -> tuple[Outcome, PushTrace | None]:
    """Follow one candidate and say what becomes of it; no trace where the platform has no room."""
    from ._ground_kernels import first_clash, min_distance

    grid = ground.grid
    if min_distance(ground.distance_m, grid, path_m) < radius_m:
        return Outcome.BLOCKED, None
    trace = simulate_push(model, object_m, path_m, radius_m)
    if not trace.touched:
        return Outcome.UNTOUCHED, trace
    rows = trace.last_contact + 1
    clash = first_clash(
        ground.distance_m,
        grid,
        footprint.inner_m,
        ground.margin_m,
        footprint.inside_m,
        footprint.reach_m,
        trace.object_m,
        rows,
    )
    if clash < rows:
        return Outcome.COLLISION, trace
    return (Outcome.DROPPED if trace.dropped else Outcome.CONTACT), trace


def plan_sideward_push(
    map: OccupancyMap,
    footprint_m: Float[np.ndarray, "p 2"],
    enter_m: Sequence[float],
    leave_m: Sequence[float],
    limits: PushLimits | None = None,
    *,
    tag: HapticTag | None = None,
    model: PushModel | None = None,
    slide_m: float = SLIDE_M,
    unknown_is_free: bool = False,
    samples: int = 24,
    rng: np.random.Generator | None = None,
) -> tuple[SidewardPush, ...]:
    """Plans of a sideward push, the best first; empty where none succeeds.

    Parameters
    ----------
    map
        With or without the object's cells.
    footprint_m
        Its outline in the map frame.
    enter_m, leave_m
        Where the platform comes from and wants to go: places on both sides of the object.
    limits, tag, model
        As for :func:`~visuohaptic.navigation.pushing.direct_push.plan_direct_push`.
    slide_m
        Largest length of the drive behind the object.
    samples
        Simulations per plan with drawn friction, centre and place, for its
        probability of failure; 0 for none.

    Returns
    -------
    Sorted by expected cost, cost / (1 - probability of failure). Curves are
    tried only when no straight drive succeeds.
    """
    limits = limits if limits is not None else PushLimits()
    if tag is not None and (tag.fixed or tag.falls or tag.needs_more_than(limits.push_force_max_N)):
        return ()
    outline = np.asarray(footprint_m, dtype=np.float64)
    ground = local_ground(map, outline, slide_m + 3 * limits.radius_m, unknown_is_free=unknown_is_free)
    place = polygon_centroid(outline)
    object_m = (float(place[0]), float(place[1]), 0.0)
    if model is None:
        model = PushModel.patch(outline - place)
    footprint = Footprint.of(model.outline_m, limits.radius_m, map.resolution_m, round_m=model.round_m)
    begins, ends = sideward_candidates(
        ground, model, object_m, enter_m, leave_m, limits.radius_m, slide_m=slide_m
    )
    plans: list[SidewardPush] = []
    for turns in ((0.0,), TURNS_RAD):
        for begin in begins:
            for end in ends:
                for turn in turns:
                    path = arc_path(begin, end, turn)
                    outcome, trace = judge_push(ground, footprint, model, object_m, path, limits.radius_m)
                    if outcome is Outcome.DROPPED and trace is not None:
                        plans.append(SidewardPush(path, trace, outcome, _cost_s(path, limits), 0.0))
        if plans:
            break
    plans.sort(key=lambda plan: plan.cost_s - _reserve_s(plan, limits))
    if samples > 0 and plans:
        rng = rng if rng is not None else np.random.default_rng(0)
        refined = [
            replace(
                plan,
                failure_probability=_failure(ground, footprint, model, object_m, plan, limits, samples, rng),
            )
            for plan in plans[:REFINED]
        ]
        refined.sort(key=lambda plan: plan.cost_s / max(1.0 - plan.failure_probability, 1e-3))
        plans = refined + plans[REFINED:]
    return tuple(plans)


def _failure(
    ground: LocalGround,
    footprint: Footprint,
    model: PushModel,
    object_m: tuple[float, float, float],
    plan: SidewardPush,
    limits: PushLimits,
    samples: int,
    rng: np.random.Generator,
) -> float:
    doubt, failed = PushUncertainty(), 0
    for _ in range(samples):
        drawn, place = doubt.draw(model, object_m, rng)
        try:
            outcome, _ = judge_push(ground, footprint, drawn, place, plan.path_m, limits.radius_m)
        except InputError:
            # Drawn into the platform's start: the drive would begin a little earlier.
            back = plan.path_m[:1] - 0.05 * np.array(
                [np.cos(plan.path_m[0, 2]), np.sin(plan.path_m[0, 2]), 0.0]
            )
            path = np.concatenate([back, plan.path_m])
            try:
                outcome, _ = judge_push(ground, footprint, drawn, place, path, limits.radius_m)
            except InputError:
                outcome = Outcome.CONTACT
        failed += outcome is not Outcome.DROPPED and outcome is not Outcome.UNTOUCHED
    return failed / samples


def _cost_s(path_m: Float[np.ndarray, "k 3"], limits: PushLimits) -> float:
    steps = np.diff(path_m[:, :2], axis=0)
    return limits.setup_time_s + float(np.hypot(steps[:, 0], steps[:, 1]).sum()) / limits.v_push_m_s


def _reserve_s(plan: SidewardPush, limits: PushLimits) -> float:
    """Seconds between drop point and end: an early drop is worth as much as a shorter way, up to 0.2 m."""
    rest = np.diff(plan.path_m[plan.trace.last_contact :, :2], axis=0)
    return min(float(np.hypot(rest[:, 0], rest[:, 1]).sum()), 0.2) / limits.v_push_m_s


def _placed(
    points_m: Float[np.ndarray, "m 2"], object_m: tuple[float, float, float]
) -> Float[np.ndarray, "m 2"]:
    c, s = np.cos(object_m[2]), np.sin(object_m[2])
    return points_m @ np.array([[c, s], [-s, c]]) + np.array(object_m[:2])


def _with_room(
    ground: LocalGround,
    points_m: Float[np.ndarray, "n 2"],
    radius_m: float,
    region: Bool[np.ndarray, "rows columns"] | None,
) -> Float[np.ndarray, "m 2"]:
    room = ground.distance_at(points_m) >= radius_m
    if region is not None:
        cells = ground.map.cell_from_world(points_m)
        inside = ground.map.inside(cells)
        room &= inside & region[np.where(inside, cells[:, 0], 0), np.where(inside, cells[:, 1], 0)]
    return points_m[room]


def _spread(points_m: Float[np.ndarray, "n 2"], count: int) -> Float[np.ndarray, "m 2"]:
    """At most ``count`` of the points, evenly over their order."""
    if len(points_m) <= count:
        return points_m
    return points_m[np.linspace(0, len(points_m) - 1, count).round().astype(int)]
