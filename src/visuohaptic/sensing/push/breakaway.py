"""When a pushed object breaks away, and with what force: from its motion behind the foam.

Symbols: x travel of the platform, q squeeze of foam and object together, y = x - q
displacement of the object, F(q) force while they are being compressed, F_s static and F_d
dynamic friction, m mass, t_0 time of the break-away.

At rest q grows by exactly the travel (:mod:`.at_rest`). From t_0 on Newton's law holds,

    m y'' = F(x - y) - F_d,    y = y' = 0 at t_0,    F_s = F(q(t_0)),

with F known from the same push and F_d from its phase (b), at most F_s: what broke away below the mean friction of its
path slid on at once. (With F_d above F_s it would not move until F passes F_d, and every t_0 until then would explain
its rest.) Two unknowns, t_0 and m, are left for the displacements y of the few frames before the platform has been caught up;
a wide prior for the mass comes from F_d (coefficients of friction are 0.2 to 0.8), and
the posterior on a grid gives F_s and how well the frames determine it. The force of the
frame with the largest deflection instead holds the overshoot, m y'' > 0.
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

__all__ = ["breakaway_force", "mixture_moments", "static_friction"]

#: Steps of the grids and of the integration between two frames.
TIMES, MASSES, STEPS = 48, 40, 40
#: Prior of the mass, by the dynamic friction: what slides has a coefficient of 0.4, 0.2 and 0.8 are at two deviations of
#: its logarithm; one thing in five rolls, with 0.02 to 0.2.
FRICTION, LOG_SIGMA, ROLLING, LOG_ROLLING_SIGMA, ROLLS = 0.4, 0.35, 0.06, 0.6, 0.2
#: Foam that is released is stiffer than foam that is compressed, by about this factor.
RELEASED = 1.5
#: Error of the modelled displacement, by that displacement: foam that recovers, frictions that change with speed.
DISPLACEMENT_ERROR = 0.1
#: Error of the method itself, by the force: the Stribeck part of the friction, turning bodies.
METHOD_ERROR = 0.02
#: Prior of a motion that is none of a break-away: frames are missing, or something else gave way.
OTHERWISE = 0.1
#: Frames after the last one at rest that are looked at.
FRAMES = 3


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    """The frames around the break-away; indices count from the first frame of the contact."""

    t: Float[np.ndarray, "n"]
    x: Float[np.ndarray, "n"]
    rest: int  #: last frame in which the object is seen to rest
    at_rest_m: float  #: squeeze in that frame
    chosen: Int[np.ndarray, "F"]  #: frames whose positions are explained
    y: Float[np.ndarray, "F"]  #: displacement of the object in them [m]
    sigma_m: Float[np.ndarray, "F"]
    springs: FoamCurve  #: foam and object in series


def static_friction(
    record: PushRecord, rests: Sequence[Rest], dynamic_N: float
) -> tuple[Estimate, list[float]]:
    """Force at which the object broke away in this push, and how probable each way of resting is after its motion.

    The text takes the largest force of phase (a). But after the break-away the force goes on rising until the object
    is as fast as the platform (its inertia), so the break-away itself is looked for in the object's motion, see
    :func:`breakaway_force`. When it shows none, it lies between the last frame at rest and the largest force.

    Parameters
    ----------
    record
        The push.
    rests
        The object before it moves, in several ways.
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
        weight.append(rest.probability * OTHERWISE)
        found.append((0.5 * (low + peak), (peak - low) / np.sqrt(12.0)))
        fit = breakaway_force(record, rest, dynamic_N)
        if fit is not None:
            weight.append(rest.probability * (1.0 - OTHERWISE) * float(np.exp(min(fit[2], 100.0))))
            found.append(fit[:2])
        chances.append(sum(weight) - sum(chances))
    value, random = mixture_moments(weight, found)
    return Estimate(value, float(np.sqrt(noise**2 + random**2 + (common * value) ** 2))), chances


def mixture_moments(weight: Sequence[float], found: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Mean and standard deviation of a mixture.

    Parameters
    ----------
    weight, found
        Weights, up to a common factor, and means with standard deviations.
    """
    fraction = np.array(weight) / np.sum(weight)
    mean, sigma = np.array(found).T
    value = float(fraction @ mean)
    return value, float(np.sqrt(fraction @ (sigma**2 + (mean - value) ** 2)))


def breakaway_force(record: PushRecord, rest: Rest, dynamic_N: float) -> tuple[float, float, float] | None:
    """Static friction and its standard deviation from the motion alone [N].

    Parameters
    ----------
    record
        The push.
    rest
        The object before it moves.
    dynamic_N
        Dynamic friction [N]; 0 when it is not known.

    Returns
    -------
    Value and standard deviation [N], and the logarithm of the Bayes factor against an object that follows the platform
    in any other way; None for too few frames.
    """
    start = _start(record, rest)
    if start is None:
        return None
    t, x, before, springs = start.t, start.x, start.rest, start.springs
    times = np.linspace(t[max(before - 1, 0)], t[min(before + 1, len(t) - 1)], TIMES)
    # Coefficients from that of a trolley to that of rubber.
    coefficients = np.geomspace(0.015, 1.0, MASSES)
    masses = max(dynamic_N, 0.1 * float(springs.force_N[-1])) / (coefficients * GRAVITY_M_S2)
    at_rest = start.at_rest_m + np.interp(times, t, x) - x[before]  # squeeze at t_0
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
    """The frames around the break-away; None when too few show it."""
    part = slice(rest.first, min(rest.last + 2 + FRAMES, len(record.t_s)))
    t, x, d = record.t_s[part], record.travel_m[part], record.deflection_m[part]
    force = np.where(np.isfinite(record.force_N[part]), record.force_N[part], rest.foam.force_at(d))
    last, deepest = rest.last - rest.first, rest.deepest - rest.first
    squeeze = rest.squeeze_m(d, force)
    # Past the frame of the largest deflection the foam is recovering and shows less.
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
    """How far the platform may have been from the straight line between the frames of the break-away [m].

    A change of speed at an unknown time of a span makes a kink of a quarter of the span, at most.
    """
    speed = np.diff(x) / np.diff(t)
    span = slice(max(rest - 1, 0), rest + 2)
    return 0.25 * float(t[rest + 1] - t[rest]) * float(np.ptp(speed[span]))


def _log_normal(value: Float[np.ndarray, "M"], median: float, sigma: float) -> Float[np.ndarray, "M"]:
    """Density of the logarithm."""
    return np.exp(-0.5 * (np.log(value / median) / sigma) ** 2) / sigma


def _moments(values: Float[np.ndarray, "T"], weight: Float[np.ndarray, "T"]) -> tuple[float, float]:
    """Mean and standard deviation under weights that add up to 1."""
    mean = float(weight @ values)
    return mean, float(np.sqrt(weight @ (values - mean) ** 2))


def _displacements(
    times: Float[np.ndarray, "T"],
    masses: Float[np.ndarray, "M"],
    depth0: Float[np.ndarray, "T"],
    start: _Start,
    slides_N: Float[np.ndarray, "T"],
) -> Float[np.ndarray, "T M F"]:
    """Displacement of the object at the frames for every break-away and mass (semi-implicit Euler)."""
    frames, springs = start.t[start.chosen], start.springs
    end = float(frames[-1] - times[0])
    dt = end / (STEPS * len(frames))
    y = np.zeros((len(times), len(masses)))
    v, deepest = np.zeros_like(y), np.repeat(depth0[:, None], len(masses), axis=1)
    after = np.arange(1, STEPS * len(frames) + 1) * dt
    course = [np.zeros_like(y)]
    began_m = np.interp(times, start.t, start.x)  # the platform may slow down meanwhile
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
