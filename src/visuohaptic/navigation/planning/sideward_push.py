"""Sideward push: drive past an object and displace it sideward without a stop (Alt 2016, Sec. 4.3.2).

Candidates are straight drives, and arcs if no line succeeds, in the frame of an
:class:`~visuohaptic.navigation.planning.off_centre_rollouts.OffCentreScene`: metres along the grid's axes about the
centre of the object, whose pose is (0, 0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import product

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ..problem.push_costs import failure_probability
from ..pushing.push_failure import PushUncertainty
from ..pushing.quasi_static import PushTrace, arc_path, remaining_m, simulate_push
from .arrays import Point
from .off_centre_rollouts import OffCentreScene, fits, has_room
from .search.push_states import Deadline

#: Maximum distance of start and end from the object: "about 6 r_rob" (Sec. 4.3.2).
SLIDE_M = 1.0
#: Heading changes of the arcs that are tried if all lines fail (rad).
TURNS_RAD = (-0.8, -0.4, 0.4, 0.8)
#: Number of drives whose failure probability is simulated.
REFINED = 5
#: Simulated drives of each: the standard error of a probability of 0.1 is 0.06.
SAMPLES = 24
#: Up to this length [m], an early release counts as much as a shorter path.
RESERVE_M = 0.2
#: Sampled drives start earlier by this distance: five standard deviations of the object's position [m].
BACK_M = 0.05


class SidewardOutcome(StrEnum):
    """Result of a candidate."""

    RELEASED = "released"  #: success: contact was lost before the end
    CONTACT = "contact"  #: still in contact at the end
    COLLISION = "collision"  #: the object collides with another obstacle
    BLOCKED = "blocked"  #: the path of the platform is blocked
    UNTOUCHED = "untouched"  #: the platform never touches the object


@dataclass(frozen=True, slots=True, eq=False)
class SidewardPush:
    """One drive past the object, in the frame of its scene."""

    path_m: Float[np.ndarray, "k 3"]  #: of the platform: x, y [m], heading [rad]
    trace: PushTrace  #: predicted motion of the object
    attempt_s: float  #: setup, and the drive at the speed of pushing
    failure_probability: float = 0.0
    end_covariance: Float[np.ndarray, "3 3"] | None = None  #: second moment about the predicted end

    @property
    def cost_s(self) -> float:
        """Expected cost, with retries."""
        return self.attempt_s / max(1.0 - self.failure_probability, 1e-3)


def sideward_candidates(
    scene: OffCentreScene,
    enter_m: Point,
    leave_m: Point,
    *,
    slide_m: float = SLIDE_M,
    starts: int = 9,
    ends: int = 9,
) -> tuple[Float[np.ndarray, "a 2"], Float[np.ndarray, "b 2"]]:
    """Start and end points of the platform's path [m].

    Starts lie one radius away from the outline on the side of ``enter_m``, ends
    up to ``slide_m`` from the object on the side of ``leave_m``; both where
    the platform is collision-free.

    Parameters
    ----------
    scene
        The object and its surroundings.
    enter_m, leave_m
        Positions before and after the push on the path of the platform: x, y [m].
    slide_m
        Maximum distance of an end from the object [m].
    starts
        Maximum number of start points.
    ends
        A third of the maximum number of end points: directions at three distances each.

    Raises
    ------
    InputError
        ``enter_m`` and ``leave_m`` are the same position.
    """
    import shapely

    model, radius_m = scene.model, scene.radius_m
    # One millimetre away, so that a start is not in contact.
    shape = (shapely.Polygon if len(model.outline_m) > 2 else shapely.MultiPoint)(model.outline_m)
    ring = shape.buffer(model.round_m + radius_m + 1e-3).exterior
    ahead = leave_m - enter_m
    length = float(np.hypot(*ahead))
    if not length > 0:
        raise InputError(
            "sideward_candidates", f"found enter {enter_m} and leave {leave_m}, expected two places"
        )
    ahead = ahead / length
    points = shapely.get_coordinates(ring.interpolate(np.linspace(0, ring.length, 120, endpoint=False)))
    begins = points[has_room(scene, points) & (points @ ahead < -0.3 * radius_m)]
    # Ends: over the directions within a right angle of the direction of leaving, near and far.
    angle = np.linspace(-1.2, 1.2, 2 * ends + 1)
    c, s = np.cos(angle), np.sin(angle)
    rays = np.column_stack([c * ahead[0] - s * ahead[1], s * ahead[0] + c * ahead[1]])
    reach = float(ring.distance(shapely.Point(0.0, 0.0)))
    goals = np.concatenate([share * (slide_m + reach) * rays for share in (1.0, 0.75, 0.5)])
    goals = goals[has_room(scene, goals)]
    goals = goals[np.argsort(np.hypot(*(goals - leave_m).T), kind="stable")]
    thinned = np.linspace(0, max(len(begins) - 1, 0), min(len(begins), starts)).round().astype(int)
    return begins[thinned], goals[: 3 * ends]


def evaluate_push(
    scene: OffCentreScene, path_m: Float[np.ndarray, "k 3"]
) -> tuple[SidewardOutcome, PushTrace | None]:
    """Simulate one candidate and classify the outcome.

    Parameters
    ----------
    scene
        The object and its surroundings.
    path_m
        Poses of the platform: x, y [m], heading [rad].

    Returns
    -------
    The outcome, and the simulated motion; no motion if the path of the platform is blocked.

    Raises
    ------
    InputError
        The platform starts inside the object.
    """
    if not has_room(scene, path_m[:, :2]).all():
        return SidewardOutcome.BLOCKED, None
    trace = simulate_push(scene.model, (0.0, 0.0, 0.0), path_m, scene.radius_m)
    return _outcome(scene, trace), trace


def _outcome(scene: OffCentreScene, trace: PushTrace) -> SidewardOutcome:
    if not trace.touched:
        return SidewardOutcome.UNTOUCHED
    if not fits(scene, trace.object_m[: trace.last_contact + 1]).all():
        return SidewardOutcome.COLLISION
    return SidewardOutcome.RELEASED if trace.released else SidewardOutcome.CONTACT


def sideward_pushes(
    scene: OffCentreScene, enter_m: Point, leave_m: Point, deadline: Deadline | None = None
) -> tuple[SidewardPush, ...]:
    """Successful sideward pushes, the best first; empty if there are none.

    Arcs are tried only when no straight drive succeeds.

    Parameters
    ----------
    scene, enter_m, leave_m
        See :func:`sideward_candidates`.
    deadline
        Time limit: drives that were not simulated by then are omitted.

    Raises
    ------
    InputError
        ``enter_m`` and ``leave_m`` are the same position.
    """
    robot, pushes = scene.domain.robot, []
    starts, ends = sideward_candidates(scene, enter_m, leave_m)
    for turns in ((0.0,), TURNS_RAD):
        for start, end, turn in product(starts, ends, turns):
            if deadline is not None and deadline.passed:
                break
            path = arc_path(start, end, turn)
            outcome, trace = evaluate_push(scene, path)
            if outcome is SidewardOutcome.RELEASED and trace is not None:
                attempt_s = robot.setup_time_s + remaining_m(path, 0) / robot.v_push_m_s
                pushes.append(SidewardPush(path, trace, attempt_s))
        if pushes:
            break
    reserve_s = RESERVE_M / robot.v_push_m_s
    pushes.sort(
        key=lambda push: (
            push.attempt_s
            - min(remaining_m(push.path_m, push.trace.last_contact) / robot.v_push_m_s, reserve_s)
        )
    )
    rng = np.random.default_rng(0)  # one plan, one answer
    refined: list[SidewardPush] = []
    for push in pushes[:REFINED]:
        if deadline is not None and refined and deadline.passed:
            break
        refined.append(_sampled(scene, push, rng))
    return tuple(sorted(refined, key=lambda push: push.cost_s))


def _sampled(scene: OffCentreScene, push: SidewardPush, rng: np.random.Generator) -> SidewardPush:
    """A push with the fraction of simulated drives that neither release nor miss the object, and their final poses."""
    failed, errors = 0, []
    # An object that is nearer than estimated is touched before the start.
    heading = push.path_m[0, 2]
    back = push.path_m[:1] - BACK_M * np.array([np.cos(heading), np.sin(heading), 0.0])
    drive = np.concatenate([back, push.path_m])
    for friction, support, place in zip(
        *PushUncertainty().samples(scene.model, (0.0, 0.0, 0.0), rng, SAMPLES), strict=True
    ):
        model = replace(scene.model, contact_friction=float(friction), support_m=support)
        try:
            trace = simulate_push(model, place, drive, scene.radius_m)
        except InputError:
            continue  # the sampled object overlaps the platform: no information
        failed += _outcome(scene, trace) not in (SidewardOutcome.RELEASED, SidewardOutcome.UNTOUCHED)
        errors.append(trace.object_m[-1] - push.trace.object_m[-1])
    if not errors:
        return replace(push, failure_probability=1.0)
    off = np.array(errors)
    # Drift and rotation of straight pushes do not apply here; the counters and the force do.
    holds = 1.0 - failure_probability(scene.body.obj.tag, 0.0, scene.domain.robot, scene.domain.costs)
    risk = 1.0 - holds * (1.0 - failed / len(errors))
    return replace(push, failure_probability=risk, end_covariance=off.T @ off / len(errors))
