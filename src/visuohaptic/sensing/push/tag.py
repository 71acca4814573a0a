"""The haptic tag of a push: friction, compliance and motion of the object (Alt 2016, Sec. 4.1).

Phase (a), contact until motion: static friction and deformability. Phase (b),
motion until the platform stops: dynamic friction, drift, rotation. Phase (c):
deceleration. Properties that are not observed in a phase are None, not zero.

An estimate refers to *this* push. Static friction is the force at which the object broke away,
dynamic friction the mean friction along the path from there until the platform stops, both converted to a
straight push (:mod:`.off_centre`); stiffness is that of the object at the contact, corrected for the shear of its feet
before they slip. ``value`` +- 1.645 ``sigma`` contains the value of this push with a probability of 0.9. The next push has
another position on the floor, another contact point and another time at rest: :func:`predictive_interval`.

An object that did not move has a static friction F_s above the largest measured force F_w. Whether it is also above the
maximum push force of the platform, F_max, depends on the distribution of friction: F_s is log-normal, F_s ~ LN(m, s), and
a fraction q of the objects is fastened. Then

    P(fixed) = P(F_s > F_max | F_s > F_w) = (q + (1 - q) Q(F_max)) / (q + (1 - q) Q(F_w)),  Q the tail of LN.

Foam that saturates at an edge has measured a few newtons only: that is a lower bound of the friction, and weak evidence for
"fixed".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...core import Estimate, HapticTag, InputError, Primitive
from ...core.measurement import GRAVITY_M_S2, Event, EventKind
from .at_rest import LOSS, LOSS_SIGMA, SCALE, FoamCurve, Rest, rest_hypotheses
from .breakaway import FRICTION, mixture_moments, static_friction
from .events import EventSettings
from .off_centre import straight_push_factor, to_straight_push
from .push_record import Phases, PushRecord, StopReason, find_phases

#: Prior of objects on floors: median [N] and logarithmic standard deviation of the static friction, and fraction of fastened
#: objects. Of the nine objects of Table 4.1 eight slid, at 8.1, 1.5, 6.5, 15.9, 2.8, 0.6, 0.9 and 1.3 N, and one did
#: not: (1 + 1/2) / (9 + 1) by Jeffreys' prior.
FRICTION_MEDIAN_N, FRICTION_LOG_SIGMA, FASTENED = 2.65, 1.1, 0.15
#: Maximum shear displacement of the feet before they slip; uniform prior [m].
SHEAR_M = 1e-4
#: Minimum compliance that counts as observed, in standard deviations.
OBSERVED = 4.0
#: Accepted error rate of "fixed". The lower bound of the withstood force is this many standard deviations below the
#: measured one, with this probability.
FALSE_FIXED, BOUND_SIGMAS = 0.1, 2.0
BOUND_PROBABILITY = 0.5 * math.erfc(-BOUND_SIGMAS / math.sqrt(2.0))


@dataclass(frozen=True, slots=True)
class TagSettings:
    """Settings of the evaluation of a push."""

    events: EventSettings | None = None
    min_frames: int = 4  #: minimum number of frames of an estimate
    travel_sigma_m: float = 2e-4  #: standard deviation of the odometry over a push [m]
    deceleration_min_s: float = 0.1  #: minimum duration of phase (c) for an estimate [s]


def tag_from_push(
    record: PushRecord,
    *,
    phases: Phases | None = None,
    events: Sequence[Event] | None = None,
    stopped_by: StopReason | None = None,
    max_force_N: float = 20.0,
    primitive: Primitive | None = None,
    object_centre_m: float | None = None,
    settings: TagSettings | None = None,
) -> HapticTag:
    """Estimate the haptic tag of one push.

    Parameters
    ----------
    record
        The push, frame by frame.
    phases
        Phases of the push; by default they are found from the events.
    events
        Events raised during the push; falls are only known from these.
    stopped_by
        Why the platform stopped; ``PUSHED_FAR`` implies that the object moved.
    max_force_N
        Maximum push force of the platform [N]; an object that needs more is fixed.
    primitive
        Shape fitted while the platform stood still, in frame F at that time; stored unchanged.
    object_centre_m
        Position of the centre of the object along the strip (y of frame F) [m]. The contact offset is the
        median over phase (a) of the contact position minus this value, positive to the left.
    settings
        Thresholds.

    Examples
    --------
    >>> t_s, nothing = np.arange(200) / 50, np.zeros(200)
    >>> travel_m = 0.02 * t_s  # 20 mm/s; the foam of 1000 N/m yields until the object slides at 8 N
    >>> force_N = np.minimum(1000.0 * travel_m, 8.0) * (1 + 0.002 * np.random.default_rng(0).normal(size=200))
    >>> record = PushRecord(
    ...     t_s, np.ones(200, dtype=bool), force_N, np.full(200, 0.02), 0.01, force_N / 1000, np.full(200, 2e-5),
    ...     travel_m, nothing, nothing, nothing,
    ... )
    >>> tag = tag_from_push(record)
    >>> tag.fixed, abs(tag.dynamic_friction_N.value - 8.0) < 0.3
    (False, True)
    """
    settings = settings or TagSettings()
    given = list(events or ())
    kinds = {event.kind for event in given}
    if phases is None:
        usable = given if EventKind.CONTACT in kinds else None
        phases = find_phases(record, settings=settings.events, events=usable)
    moved = bool(np.isfinite(phases.motion_s))
    fell = EventKind.FALL in kinds
    # Pushed by more than the width of the sensor: it moved, even if the motion was not felt (3.6.2, case c).
    # A falling object is not fixed either.
    fixed = False if moved or fell or stopped_by == StopReason.PUSHED_FAR else None
    withstood = _withstood_N(record, phases) if fixed is None else None
    if withstood is not None and fixed_probability(withstood, max_force_N) >= 1.0 - FALSE_FIXED:
        fixed = True
    if not np.isfinite(phases.contact_s):
        return HapticTag(explored=1, failed=int(fell), falls=True if fell else None, fixed=fixed)

    def straight(chosen: Any) -> tuple[float, float]:
        return straight_push_factor(record.contact_m[chosen], object_centre_m, primitive)

    static, dynamic, rests, chances = _frictions(record, phases, settings, straight)
    deformability, stiffness = _deformation(record, rests, chances)
    # Lateral shift of the contact in the world, and rotation of the object, per pushed distance.
    drift = _slope(record, phases, record.contact_m + record.lateral_m, settings) if moved else None
    rotation = _slope(record, phases, record.angle_rad, settings) if moved else None
    return HapticTag(
        static_friction_N=static,
        dynamic_friction_N=dynamic,
        deceleration_s=_deceleration(record, phases, settings) if moved else None,
        drift=drift,
        deformability=deformability,
        stiffness_N_per_m=stiffness,
        rotation_rad_per_m=rotation,
        contact_offset_m=_contact_offset(record, phases, object_centre_m),
        primitive=primitive,
        deformation_shape_m=record.deepest_points_m,
        fixed=fixed,
        falls=True if fell else (False if moved else None),
        explored=1,
        failed=int(fell or withstood is not None),
        min_static_friction_N=withstood,
    )


def _frictions(
    record: PushRecord,
    phases: Phases,
    settings: TagSettings,
    straight: Callable[[Any], tuple[float, float]],
) -> tuple[Estimate | None, Estimate | None, Sequence[Rest], list[float]]:
    """Static and dynamic friction of a straight push, the rest hypotheses, and their probabilities.

    ``straight`` applies :func:`.off_centre.straight_push_factor` to selected frames.
    """
    moved = bool(np.isfinite(phases.motion_s))
    dynamic = _dynamic_friction(record, phases, phases.motion_s, settings) if moved else None
    rests = rest_hypotheses(record, phases.contact_s, phases.motion_s, dynamic.value if dynamic else 0.0)
    begin = max(rests, key=lambda rest: rest.probability).last if rests else 0
    if rests and moved:
        dynamic = _dynamic_friction(record, phases, float(record.t_s[begin]), settings)
    chances = [rest.probability for rest in rests]
    # Without a phase (b) the object ran ahead at once (a door): the force was inertial.
    if dynamic is None:
        return None, None, rests, chances
    dynamic = to_straight_push(dynamic, straight(phases.pushing(record.t_s)))
    if not rests:
        return None, dynamic, rests, chances
    # Frames between which the object breaks away; it rotates if the contact is off-centre.
    felt = straight(slice(begin, begin + 2))
    static, chances = static_friction(record, rests, dynamic.value / felt[0])
    return to_straight_push(static, felt), dynamic, rests, chances


def fixed_probability(withstood_N: float, max_force_N: float) -> float:
    """Probability that an object needs more than the maximum push force, given that it withstood a smaller force.

    Parameters
    ----------
    withstood_N
        Force that did not move the object [N].
    max_force_N
        Maximum push force of the platform [N].

    Examples
    --------
    >>> round(fixed_probability(4.0, 20.0), 2), round(fixed_probability(18.0, 20.0), 2)
    (0.39, 0.96)
    """
    from scipy.special import ndtr

    if withstood_N >= max_force_N:
        return 1.0
    felt, most = (
        FASTENED + (1.0 - FASTENED) * float(ndtr(-np.log(force / FRICTION_MEDIAN_N) / FRICTION_LOG_SIGMA))
        for force in (max(withstood_N, 1e-9), max_force_N)
    )
    return most / felt


def _withstood_N(record: PushRecord, phases: Phases) -> float | None:
    """Lower bound of the largest force before the platform retreated [N]; None without a positive one."""
    felt = np.flatnonzero(record.force_valid & (record.t_s >= phases.contact_s))
    if len(felt) == 0:
        return None
    force = record.force_N[felt]
    scale = np.broadcast_to(record.force_scale_sigma, record.t_s.shape)[felt]
    sigma = np.hypot(record.force_sigma_N[felt], np.nan_to_num(scale) * force)
    bound = float(np.max(force - BOUND_SIGMAS * sigma))
    return bound if bound > 0.0 else None


def _dynamic_friction(
    record: PushRecord, phases: Phases, begin_s: float, settings: TagSettings
) -> Estimate | None:
    """Mean force between breakaway and stop; the inertial force of the acceleration is part of the error.

    In frames without a force because the foam unloads, the force is that of the loading curve minus the hysteresis loss.
    The variation between neighbouring frames gives the error of the average.
    """
    t, force = record.t_s, record.force_N.copy()
    end = np.nanmin([phases.stop_s, phases.release_s, np.inf])
    chosen = (t > begin_s) & (t <= end)
    foam = FoamCurve.from_frames(record.deflection_m, record.force_N)
    guessed = chosen & ~record.force_valid & (record.deflection_m <= foam.depth_m[-1])
    force[guessed] = (1.0 - LOSS) * foam.force_at(record.deflection_m[guessed])
    chosen &= np.isfinite(force)
    count = int(chosen.sum())
    if count < settings.min_frames:
        return None
    t, force, scale = t[chosen], force[chosen], record.common_sigma(chosen & record.force_valid)
    mean = float(np.trapezoid(force, t) / (t[-1] - t[0]))
    rough = force[1:-1] - 0.5 * (force[:-2] + force[2:])
    speed = float(np.ptp(record.travel_m[chosen]) / (t[-1] - t[0]))
    inertia = mean * speed / (FRICTION * GRAVITY_M_S2 * (t[-1] - t[0]))
    unread = float(np.mean(guessed[chosen]))
    parts = (np.std(rough) / np.sqrt(1.5 * count), inertia, LOSS_SIGMA * unread * mean, scale * mean)
    return Estimate(mean, float(np.linalg.norm(parts)))


def _autocorrelation_frames(values: np.ndarray) -> float:
    """Integrated autocorrelation time in frames; 1 for white noise (initial positive sequence)."""
    centred = values - values.mean()
    power = float(centred @ centred)
    if power <= 0:
        return 1.0
    tau = 1.0
    for lag in range(1, len(values) // 2):
        rho = float(centred[:-lag] @ centred[lag:]) / power
        if rho <= 0.05:
            break
        tau += 2.0 * rho
    return tau


def _line_fit(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Slope and its standard deviation from the residuals, corrected for their autocorrelation."""
    centred = x - x.mean()
    power = float(centred @ centred)
    slope = float(centred @ y) / power
    residual = y - y.mean() - slope * centred
    variance = float(residual @ residual) / max(len(x) - 2, 1)
    sigma = float(np.sqrt(variance * _autocorrelation_frames(residual) / power))
    return slope, sigma


def _contact_offset(record: PushRecord, phases: Phases, object_centre_m: float | None) -> Estimate | None:
    """Offset of the contact in phase (a) from the centre of the object, left positive [m]."""
    touched = phases.rising(record.t_s) & np.isfinite(record.contact_m)
    if object_centre_m is None or not touched.any():
        return None
    where = record.contact_m[touched] - object_centre_m
    return Estimate(float(np.median(where)), float(np.std(where) / np.sqrt(len(where))))


def _slope(record: PushRecord, phases: Phases, values: np.ndarray, settings: TagSettings) -> Estimate | None:
    """Change of a quantity per pushed distance in phase (b)."""
    chosen = phases.pushing(record.t_s) & np.isfinite(values)
    if chosen.sum() < settings.min_frames or np.ptp(record.travel_m[chosen]) <= settings.travel_sigma_m:
        return None
    slope, sigma = _line_fit(record.travel_m[chosen], values[chosen])
    return Estimate(slope, sigma)


def _deformation(
    record: PushRecord, rests: Sequence[Rest], chances: Sequence[float]
) -> tuple[Estimate | None, Estimate | None]:
    """Deformability H_D (1 - deflection / travel) and stiffness of the object, from the rest phase."""
    if not rests:
        return None, None
    rest = rests[int(np.argmax(chances))]
    frames = np.arange(rest.first, rest.last + 1)
    frames = frames[np.isfinite(record.deflection_m[frames])]
    if len(frames) < 3 or np.ptp(record.travel_m[frames]) <= 0:
        return None, None
    # The slope does not depend on the unknown position of the first contact.
    slope, scatter = _line_fit(record.travel_m[frames], record.deflection_m[frames])
    power = float(np.var(record.travel_m[frames])) * len(frames)
    sigma = np.linalg.norm([scatter, rest.noise_m / np.sqrt(power), SCALE * slope])
    deformability = Estimate(1.0 - slope, float(sigma))
    compliances = [(float(one.model[1]), float(np.sqrt(one.covariance[1, 1]))) for one in rests]
    compliance, deviation = mixture_moments(chances, compliances)
    force = float(np.nanmax(record.force_N[frames]))
    deviation = float(np.hypot(deviation, SHEAR_M / np.sqrt(12.0) / force))
    compliance -= 0.5 * SHEAR_M / force
    if compliance < OBSERVED * deviation:
        return deformability, None  # rigid within the uncertainty: no stiffness was observed
    relative = np.hypot(deviation / compliance, record.common_sigma(frames))
    return deformability, Estimate(1.0 / compliance, float(relative / compliance))


def _deceleration(record: PushRecord, phases: Phases, settings: TagSettings) -> Estimate | None:
    """Time for which the object continues to move after the platform has stopped [s]; zero if it does not."""
    chosen = phases.stopped(record.t_s) & np.isfinite(record.deflection_m)
    t, deflection = record.t_s[chosen], record.deflection_m[chosen]
    if not np.isfinite(phases.stop_s) or len(t) < settings.min_frames:
        return None
    if t[-1] - phases.stop_s < settings.deceleration_min_s:
        return None
    frame = float(np.median(np.diff(t)))
    noise = float(np.median(record.deflection_sigma_m[chosen]))
    last = int(np.searchsorted(record.t_s, phases.stop_s, side="right")) - 1
    before = record.deflection_m[max(last - 2, 0) : last + 1]
    at_stop = float(np.nanmedian(before))
    final = float(np.median(deflection[-max(3, len(deflection) // 4) :]))
    # Relaxation of the foam and odometry noise are not motion of the object.
    if at_stop - final < max(5.0 * noise, 0.1 * at_stop):
        return Estimate(0.0, frame / np.sqrt(12.0))
    arrived = np.flatnonzero(deflection <= final + max(2.0 * noise, 0.05 * (at_stop - final)))
    duration = float(t[int(arrived[0])] - 0.5 * frame - phases.stop_s)
    # Once the object has left the foam its motion is not observed: the time is a lower bound.
    unseen = duration if final <= 2.0 * noise else 0.0
    return Estimate(duration, float(np.hypot(frame, unseen)))


def predictive_interval(
    estimate: Estimate, level: float = 0.9, *, prior_cv: float = 0.23, prior_samples: float = 5.0
) -> tuple[float, float]:
    """Interval of the value in the next push, at another contact point.

    Student's t with the standard deviation of the samples, shrunk towards a prior: the forces of real pushes vary by 17, 19,
    19, 25 and 32 % in the five logs of Zhou et al. (2016), 23 % root mean square, and each log counts as one degree of
    freedom. A single push therefore has a wide interval.

    Parameters
    ----------
    estimate
        Property of a tag.
    level
        Probability of the interval.
    prior_cv
        Relative standard deviation expected before there are repetitions.
    prior_samples
        Weight of the prior in samples; 0: no prior.
    """
    if not 0.0 < level < 1.0:
        raise InputError("level", f"found {level}, expected a probability between 0 and 1")
    from scipy.special import stdtrit

    n = estimate.samples
    freedom = n - 1 + prior_samples
    if freedom <= 0:
        raise InputError("estimate", "found one sample and no prior, expected a prior or more samples")
    squares = (n - 1) * estimate.spread**2 + prior_samples * (prior_cv * estimate.value) ** 2
    variance = squares / freedom * (1.0 + 1.0 / n) + estimate.sigma**2
    half = float(stdtrit(freedom, 0.5 + 0.5 * level)) * float(np.sqrt(variance))
    return estimate.value - half, estimate.value + half
