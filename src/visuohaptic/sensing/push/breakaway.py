"""Static friction of a pushed object: time and force of its breakaway, from its motion.

Symbols: x travel of the platform, q common compression of foam and object, y = x - q
displacement of the object, F(q) force during loading, F_s static and F_d
dynamic friction, m mass, t_0 time of the breakaway.

At rest q grows by exactly the travel (:mod:`.at_rest`). From t_0 on the equation of motion is

    m y'' = F(x - y) - F_d,    y = y' = 0 at t_0,    F_s = F(q(t_0)),

with F known from the same push and F_d from its phase (b), at most F_s: an object that broke away below the mean friction
along its path slid on at once. (With F_d above F_s it would not move until F exceeds F_d, and every earlier t_0 would
explain the data equally well.) The unknowns t_0 and m are estimated from the displacements y of the few frames until the object
is as fast as the platform. The prior of the mass follows from F_d (coefficients of friction are 0.2 to 0.8), and
the posterior on a grid gives F_s and its standard deviation. The force of the
frame with the largest deflection would be too large by the inertial force, m y'' > 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ...core.measurement import GRAVITY_M_S2
from ...core.objects import Estimate
from .at_rest import EXCESS_SIGMA, STATIC_EXCESS, UNIFORM, FoamCurve, Rest
from .push_record import PushRecord

#: Numbers of grid points of time and mass, and of integration steps between two frames.
TIMES, MASSES, STEPS = 48, 40, 40
#: Prior of the mass from the dynamic friction: the coefficient of a sliding object is 0.4, with 0.2 and 0.8 at two standard
#: deviations of its logarithm; one object in five rolls, with a coefficient of 0.02 to 0.2.
FRICTION, LOG_SIGMA, ROLLING, LOG_ROLLING_SIGMA, ROLLS = 0.4, 0.35, 0.06, 0.6, 0.2
#: Ratio of the stiffness of foam during unloading to that during loading.
RELEASED = 1.5
#: Relative error of the modelled displacement: recovery of the foam, dependence of friction on speed.
DISPLACEMENT_ERROR = 0.1
#: Relative error of the method: Stribeck effect of the friction, rotation of the object.
METHOD_ERROR = 0.02
#: Prior probability that the motion is not a breakaway: frames are missing, or something else moved.
NO_BREAKAWAY_PROBABILITY = 0.1
#: Number of frames after the last one at rest that are used.
FRAMES = 3


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    """The frames around the breakaway; indices count from the first frame of the contact."""

    t: Float[np.ndarray, "n"]
    x: Float[np.ndarray, "n"]
    rest: int  #: last frame in which the object rests
    at_rest_m: float  #: compression of foam and object in that frame [m]
    chosen: Int[np.ndarray, "F"]  #: frames whose displacements are modelled
    y: Float[np.ndarray, "F"]  #: displacement of the object in them [m]
    sigma_m: Float[np.ndarray, "F"]
    springs: FoamCurve  #: foam and object in series


def static_friction(
    record: PushRecord, rests: Sequence[Rest], dynamic_N: float
) -> tuple[Estimate, list[float]]:
    """Static friction of this push, and the posterior weight of each rest hypothesis given the motion after it.

    The dissertation takes the largest force of phase (a). But the force still rises after the breakaway, until the object
    is as fast as the platform (inertia), so the breakaway is estimated from the motion of the object, see
    :func:`breakaway_force`. If the motion is not that of a breakaway, the static friction lies between the force of the last
    frame at rest and the largest force.

    Parameters
    ----------
    record
        The push.
    rests
        Hypotheses of the rest phase.
    dynamic_N
        Dynamic friction [N].
    """
    near = np.arange(rests[0].first, rests[0].deepest + 1)
    near = near[record.force_valid[near]]
    noise = float(np.median(record.force_sigma_N[near]))
    common = record.common_sigma(near[-3:])
    peak = float(record.force_N[near].max())
    weight: list[float] = []
    found: list[tuple[float, float]] = []
    chances: list[float] = []
    for rest in rests:
        low = float(record.force_N[rest.last])
        weight.append(rest.probability * NO_BREAKAWAY_PROBABILITY)
        found.append((0.5 * (low + peak), (peak - low) / np.sqrt(12.0)))
        fit = breakaway_force(record, rest, dynamic_N)
        if fit is not None:
            weight.append(
                rest.probability * (1.0 - NO_BREAKAWAY_PROBABILITY) * float(np.exp(min(fit[2], 100.0)))
            )
            found.append(fit[:2])
        chances.append(sum(weight) - sum(chances))
    value, random = mixture_moments(weight, found)
    return Estimate(value, float(np.sqrt(noise**2 + random**2 + (common * value) ** 2))), chances


def mixture_moments(weight: Sequence[float], found: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Mean and standard deviation of a mixture.

    Parameters
    ----------
    weight, found
        Unnormalised weights, and (mean, standard deviation) of each component.
    """
    fraction = np.array(weight) / np.sum(weight)
    mean, sigma = np.array(found).T
    value = float(fraction @ mean)
    return value, float(np.sqrt(fraction @ (sigma**2 + (mean - value) ** 2)))


def breakaway_force(record: PushRecord, rest: Rest, dynamic_N: float) -> tuple[float, float, float] | None:
    """Static friction and its standard deviation from the motion of the object alone [N].

    Parameters
    ----------
    record
        The push.
    rest
        Hypothesis of the rest phase.
    dynamic_N
        Dynamic friction [N]; 0 if unknown.

    Returns
    -------
    Value and standard deviation [N], and the log Bayes factor against an object that follows the platform
    in any other way; None for too few frames.
    """
    start = _start(record, rest)
    if start is None:
        return None
    t, x, before, springs = start.t, start.x, start.rest, start.springs
    times = np.linspace(t[max(before - 1, 0)], t[min(before + 1, len(t) - 1)], TIMES)
    # Coefficients of friction from a trolley to rubber.
    coefficients = np.geomspace(0.015, 1.0, MASSES)
    masses = max(dynamic_N, 0.1 * float(springs.force_N[-1])) / (coefficients * GRAVITY_M_S2)
    at_rest = start.at_rest_m + np.interp(times, t, x) - x[before]  # compression at t_0
    static = springs.force_at(at_rest)
    model = _displacements(times, masses, at_rest, start, np.minimum(dynamic_N, static))
    sigma = np.hypot(start.sigma_m, DISPLACEMENT_ERROR * np.abs(start.y))
    chi2 = np.sum(((model - start.y) / sigma) ** 2, axis=-1)
    prior = (1.0 - ROLLS) * _log_normal(coefficients, FRICTION, LOG_SIGMA)
    prior = np.log(prior + ROLLS * _log_normal(coefficients, ROLLING, LOG_ROLLING_SIGMA))[None, :]
    if dynamic_N > 0:
        excess = static / dynamic_N - 1.0
        prior = prior - 0.5 * (((excess - STATIC_EXCESS) / EXCESS_SIGMA) ** 2)[:, None]
    prior = np.broadcast_to(
        prior - np.logaddexp.reduce(np.broadcast_to(prior, chi2.shape), axis=None), chi2.shape
    )
    posterior = prior - 0.5 * chi2
    total = np.logaddexp.reduce(posterior, axis=None)
    step = np.maximum(np.diff(x[start.chosen], prepend=x[max(start.chosen[0] - 1, 0)]), 0.0)
    otherwise = -np.sum(np.log(step + UNIFORM * rest.noise_m))
    evidence = total - np.sum(np.log(sigma * np.sqrt(2.0 * np.pi))) - otherwise
    value, width = _moments(static, np.exp(posterior - total).sum(axis=1))
    grid = float(np.ptp(static)) / TIMES / np.sqrt(12.0)
    between = springs.slope_N_per_m * _between_m(t, x, before)
    return (
        value,
        float(np.sqrt(width**2 + grid**2 + between**2 + (METHOD_ERROR * value) ** 2)),
        float(evidence),
    )


def _start(record: PushRecord, rest: Rest) -> _Start | None:
    """Select the frames around the breakaway; None if there are too few."""
    part = slice(rest.first, min(rest.last + 2 + FRAMES, len(record.t_s)))
    t, x, d = record.t_s[part], record.travel_m[part], record.deflection_m[part]
    force = np.where(np.isfinite(record.force_N[part]), record.force_N[part], rest.foam.force_at(d))
    last, deepest = rest.last - rest.first, rest.deepest - rest.first
    squeeze = rest.squeeze_m(d, force)
    # At most one frame after that of the largest deflection: later the foam recovers and underestimates the compression.
    chosen = np.arange(max(last - 1, 0), min(len(t), max(deepest, last + 1) + 2))
    chosen = chosen[np.isfinite(squeeze[chosen])]
    if len(chosen) < 2 or chosen[-1] <= last:
        return None
    design = np.column_stack([np.ones(len(chosen)), force[chosen], d[chosen]])
    known = np.einsum("fi,ij,fj->f", design, rest.covariance, design)
    y = x[chosen] - rest.model[0] - squeeze[chosen]
    springs = FoamCurve.from_frames(squeeze[: deepest + 1], force[: deepest + 1])
    sigma = np.sqrt(rest.noise_m**2 + known)
    return _Start(t, x, last, float(x[last] - rest.model[0]), chosen, y, sigma, springs)


def _between_m(t: Float[np.ndarray, "n"], x: Float[np.ndarray, "n"], rest: int) -> float:
    """Maximum deviation of the platform from linear interpolation between the frames of the breakaway [m].

    A change of speed at an unknown time within an interval deviates from the line by at most a quarter of
    the interval times the change.
    """
    speed = np.diff(x) / np.diff(t)
    span = slice(max(rest - 1, 0), rest + 2)
    return 0.25 * float(t[rest + 1] - t[rest]) * float(np.ptp(speed[span]))


def _log_normal(value: Float[np.ndarray, "M"], median: float, sigma: float) -> Float[np.ndarray, "M"]:
    """Density of the logarithm of ``value``, up to a constant factor."""
    return np.exp(-0.5 * (np.log(value / median) / sigma) ** 2) / sigma


def _moments(values: Float[np.ndarray, "T"], weight: Float[np.ndarray, "T"]) -> tuple[float, float]:
    """Mean and standard deviation for normalised weights."""
    mean = float(weight @ values)
    return mean, float(np.sqrt(weight @ (values - mean) ** 2))


def _displacements(
    times: Float[np.ndarray, "T"],
    masses: Float[np.ndarray, "M"],
    depth0: Float[np.ndarray, "T"],
    start: _Start,
    slides_N: Float[np.ndarray, "T"],
) -> Float[np.ndarray, "T M F"]:
    """Displacement of the object at the frames for every breakaway time and mass [m] (semi-implicit Euler)."""
    frames, springs = start.t[start.chosen], start.springs
    end = float(frames[-1] - times[0])
    dt = end / (STEPS * len(frames))
    y = np.zeros((len(times), len(masses)))
    v, deepest = np.zeros_like(y), np.repeat(depth0[:, None], len(masses), axis=1)
    after = np.arange(1, STEPS * len(frames) + 1) * dt
    course = [np.zeros_like(y)]
    began_m = np.interp(times, start.t, start.x)  # the platform may decelerate meanwhile
    for tau in after:
        depth = (depth0 + np.interp(times + tau, start.t, start.x) - began_m)[:, None] - y
        deepest = np.maximum(deepest, depth)
        push = springs.force_at(deepest) - RELEASED * springs.slope_N_per_m * (deepest - depth)
        v = np.maximum(v + dt * (np.maximum(push, 0.0) - slides_N[:, None]) / masses, 0.0)
        y = y + dt * v
        course.append(y)
    stack = np.array(course)
    at = np.clip((frames[None, :] - times[:, None]) / dt, 0.0, len(after) - 1e-6)
    low = at.astype(np.int64)
    fraction = at - low
    rows = np.arange(len(times))[:, None]
    found = stack[low, rows] * (1.0 - fraction)[..., None] + stack[low + 1, rows] * fraction[..., None]
    return np.moveaxis(found, 2, 1)
