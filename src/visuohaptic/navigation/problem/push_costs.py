"""Cost and failure probability of a push from the haptic tag (Alt 2016, Sec. 4.2.1 a-d).

The components of ``t_mani`` are

- setup: constant, to position the platform (a);
- manipulability: fixed, tips over, too heavy, or drifts too far over this push length (b);
- ``t_push``: length divided by speed, which decreases with the effort (c);
- ``t_fail``: the expected cost of failures (d).

The stool of Sec. 4.4 (8.1 N against 20 N, drift 0.03, explored once) pushed by
0.15 m at 0.05 m/s costs 4 s + 3 s = 7 s.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import erf, isfinite, log, sqrt
from typing import Protocol

from ...core import NON_NEGATIVE, Estimate, HapticTag, InputError, check_ranges
from .robot_model import RobotModel

#: A push is aborted once its object has rotated by this angle [rad].
TURN_LIMIT_RAD = 0.5


@dataclass(frozen=True, slots=True)
class PushCosts:
    """Parameters that the dissertation leaves open, with their defaults."""

    drift_limit_m: float = 0.10  #: maximum lateral drift of the contact over one push
    rotation_limit_rad: float = 1.05  #: maximum rotation of the object over one push
    easy_fraction: float = 0.5  #: fraction of the maximum force up to which the push has full speed
    min_speed_fraction: float = 0.5  #: of the full speed, at the maximum force
    prior_failures: float = 0.2  #: pseudo-counts: a first push fails with 0.2 / (0.2 + 0.8)
    prior_successes: float = 0.8
    unknown_movable: float = 0.5  #: probability that an unexplored object can be pushed
    explore_time_s: float = 8.0  #: to approach, touch and decide
    unknown_force_fraction: float = 0.5  #: of the maximum force: effort assumed if no force was observed
    risk_s: float = 0.0  #: added seconds per -log(1 - p): weight of reliability
    max_push_m: float = 2.0  #: r_mani of Eq. (4.3)
    price_ends: bool = True  #: whether push lengths account for final poses that may block later drives
    #: cost of an object that ends where the robot drives along the navigation graph, as in doorways
    on_route_s: float = 0.0

    def __post_init__(self) -> None:
        check_ranges(self, NON_NEGATIVE)


@dataclass(frozen=True, slots=True)
class Manipulability:
    """Whether an object may be pushed, the maximum push length, and the reason for the limit."""

    possible: bool
    max_length_m: float
    reason: str = ""  #: the limiting quantity, for display
    unknown: bool = False  #: no tag: explore first, then decide


@dataclass(frozen=True, slots=True)
class PushCost:
    """``t_mani`` and its parts [s]."""

    setup_s: float
    push_s: float
    fail_s: float
    failure_probability: float

    @property
    def total_s(self) -> float:
        """``t_mani``."""
        return self.setup_s + self.push_s + self.fail_s


def manipulability(
    tag: HapticTag | None, robot: RobotModel, costs: PushCosts | None = None
) -> Manipulability:
    """Whether, and how far, an object may be pushed: component (b) of ``t_mani``.

    Depends on the events "fixed" and "falls", the force, and the push length that drift and rotation allow.

    Parameters
    ----------
    tag
        Tag from earlier pushes; ``None`` for an object that was never touched.
    robot
        Model of the platform.
    costs
        Limits and priors.
    """
    costs = costs or PushCosts()
    max_length_m = costs.max_push_m
    if tag is None:
        return Manipulability(True, max_length_m, "never touched", unknown=True)
    if tag.fixed:
        return Manipulability(False, 0.0, "fixed")
    if tag.falls:
        return Manipulability(False, 0.0, "falls when pushed")
    force = _largest_force(tag)
    has = f"the platform has {robot.push_force_max_N:.1f} N"
    if force is not None and force.value > robot.push_force_max_N:
        return Manipulability(False, 0.0, f"needs {force.value:.1f} N, {has}")
    if tag.needs_more_than(robot.push_force_max_N):
        return Manipulability(False, 0.0, f"needs more than {tag.min_static_friction_N:.1f} N, {has}")
    reason = ""
    for name, estimate, limit in (
        ("drift", tag.drift, costs.drift_limit_m),
        ("rotation", tag.rotation_rad_per_m, costs.rotation_limit_rad),
    ):
        if estimate is not None and abs(estimate.value) * max_length_m > limit:
            max_length_m = limit / abs(estimate.value)
            reason = f"{name} allows {max_length_m:.2f} m"
    return Manipulability(True, max_length_m, reason)


def push_speed_m_s(tag: HapticTag | None, robot: RobotModel, costs: PushCosts | None = None) -> float:
    """Speed of a push [m/s]: component (c) of ``t_mani``.

    Full speed at low effort, then linearly decreasing up to the maximum force.

    Parameters
    ----------
    tag, robot, costs
        See :func:`manipulability`.
    """
    costs = costs or PushCosts()
    force = None if tag is None else tag.dynamic_friction_N or tag.static_friction_N
    fraction = costs.unknown_force_fraction if force is None else force.value / robot.push_force_max_N
    effort = min(max((fraction - costs.easy_fraction) / (1.0 - costs.easy_fraction), 0.0), 1.0)
    return robot.v_push_m_s * (1.0 + effort * (costs.min_speed_fraction - 1.0))


class PushForce(Protocol):
    """An object with a maximum pushing force: a robot, or the limits of a push."""

    @property
    def push_force_max_N(self) -> float:
        """Maximum pushing force of the platform [N]."""


def failure_probability(
    tag: HapticTag | None, length_m: float, robot: PushForce, costs: PushCosts | None = None
) -> float:
    """Probability that one push of a given length fails, from the counters and the uncertainty of the tag.

    The counters give a Beta posterior mean; force, drift and rotation the
    probability that the next push exceeds what the platform or the limits
    allow, with the predictive standard deviation of each estimate. Drift and rotation may have either sign.

    Parameters
    ----------
    tag
        Haptic tag; ``None`` for an object that was never touched. Pushes of fixed or tipping objects fail with probability 1.
    length_m
        Push length of the object [m]; 0 if only the counters and the force count.
    robot
        Its maximum force.
    costs
        Limits and priors.
    """
    if not (isfinite(length_m) and length_m >= 0):
        raise InputError("failure_probability", f"found a length of {length_m} m, expected at least 0")
    costs = costs or PushCosts()
    if tag is None:
        return 1.0 - costs.unknown_movable
    bound = tag.min_static_friction_N
    if tag.fixed or tag.falls or (bound is not None and bound >= robot.push_force_max_N):
        return 1.0
    holds = 1.0 - _from_counters(tag, costs)
    force = _largest_force(tag)
    if force is not None:
        holds *= 1.0 - _exceeds(force.value, force.predictive_sigma, robot.push_force_max_N)
    for estimate, limit in (
        (tag.drift, costs.drift_limit_m),
        (tag.rotation_rad_per_m, costs.rotation_limit_rad),
    ):
        if estimate is not None and length_m > 0:
            mean, sigma = estimate.value * length_m, estimate.predictive_sigma * length_m
            holds *= 1.0 - min(_exceeds(mean, sigma, limit) + _exceeds(-mean, sigma, limit), 1.0)
    return 1.0 - holds


def push_cost(
    tag: HapticTag | None,
    length_m: float,
    robot: RobotModel,
    costs: PushCosts | None = None,
    *,
    turn_probability: float = 0.0,
) -> PushCost:
    """``t_mani`` of one push.

    The failure penalty is the expected cost of retries, ``p / (1 - p)``
    times the attempt. An object that was explored once without failure has
    none yet ("if the object was explored several times", Sec. 4.2.1); that of an
    unknown object is the exploration.

    Parameters
    ----------
    tag
        Haptic tag; ``None`` for an object that was never touched.
    length_m
        Push length of the object [m].
    robot
        Platform.
    costs
        Limits and priors.
    turn_probability
        Probability that the object rotates away, for pushes oblique to its face.

    Returns
    -------
    PushCost
        Seconds by component; infinite beyond the allowed push length.
    """
    costs = costs or PushCosts()
    allowed = manipulability(tag, robot, costs)
    if not allowed.possible or length_m > allowed.max_length_m * (1 + 1e-9):
        return PushCost(robot.setup_time_s, float("inf"), 0.0, 1.0)
    push_s = length_m / push_speed_m_s(tag, robot, costs)
    attempt_s = robot.setup_time_s + push_s
    p = failure_probability(tag, length_m, robot, costs)
    p = 1.0 - (1.0 - p) * (1.0 - turn_probability)
    if tag is None:
        # Exploration comes first; the cost of a failure depends on the detour, see ``planning.policies``.
        return PushCost(robot.setup_time_s, push_s, costs.explore_time_s + _risk(p, costs), p)
    penalised = p
    if tag.explored <= 1 and tag.failed == 0:
        prior = _from_counters(tag, costs)
        penalised = 1.0 - (1.0 - p) / (1.0 - prior)
    penalised = min(max(penalised, 0.0), 0.99)  # the penalty is limited, so that the cost stays finite
    fail_s = penalised / (1.0 - penalised) * attempt_s + _risk(p, costs)
    return PushCost(robot.setup_time_s, push_s, fail_s, p)


def _risk(p: float, costs: PushCosts) -> float:
    return -costs.risk_s * log(max(1.0 - p, 1e-3))


def _from_counters(tag: HapticTag, costs: PushCosts) -> float:
    tries = max(tag.explored, tag.failed)
    return (tag.failed + costs.prior_failures) / (tries + costs.prior_failures + costs.prior_successes)


def _largest_force(tag: HapticTag) -> Estimate | None:
    forces = [force for force in (tag.static_friction_N, tag.dynamic_friction_N) if force is not None]
    return max(forces, key=lambda force: force.value) if forces else None


def _exceeds(value: float, sigma: float, limit: float) -> float:
    """Probability that a normal variable is above a limit."""
    if sigma <= 0 or not isfinite(limit):
        return 1.0 if value > limit else 0.0
    return 0.5 * (1.0 - erf((limit - value) / (sigma * sqrt(2.0))))
