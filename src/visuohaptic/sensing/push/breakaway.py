"""When a pushed object breaks away, and with what force: from its motion behind the foam.

Symbols: x travel of the platform, d deflection of the foam, y = x - d displacement of the
object, F(d) force while the foam is being compressed, F_s static and F_d dynamic
friction, m mass, t_0 time of the break-away.

At rest the foam deflects by exactly the travel. From t_0 on Newton's law holds,

    m y'' = F(x - y) - F_d,    y = y' = 0 at t_0,    F_s = F(d(t_0)),

with F known from the same push and F_d from its phase (b). Two unknowns, t_0 and m,
are left for the displacements y of the few frames before the platform has been caught up;
a wide prior for the mass comes from F_d (coefficients of friction are 0.2 to 0.8), and
the posterior on a grid gives F_s and how well the frames determine it. The force of the
frame with the largest deflection instead holds the overshoot, m y'' > 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

if TYPE_CHECKING:
    from .push_record import PushRecord

__all__ = ["breakaway_force"]

#: Steps of the grids and of the integration between two frames.
TIMES, MASSES, STEPS = 48, 24, 40
#: Prior of the mass: the dynamic friction of a coefficient of 0.4; 0.2 and 0.8 are at two sigmas.
FRICTION, LOG_MASS_SIGMA = 0.4, 0.35
GRAVITY_M_S2 = 9.81
#: By how much static friction exceeds the dynamic one, as a part of it: most dry pairs of materials stay below
#: 1.4. Without this a static friction near the dynamic one is always read too high, since it cannot be lower.
STATIC_EXCESS = 0.2
#: Foam that is released is stiffer than foam that is compressed, by about this factor.
RELEASED = 1.5
#: Error of the modelled displacement, by that displacement: foam that recovers, frictions that change with speed.
DISPLACEMENT_ERROR = 0.1
#: Error of the method itself, by the force: the Stribeck part of the friction, turning bodies.
METHOD_ERROR = 0.02
#: Frames before the contact that give the noise, and the factor that it is taken larger by: the largest of many
#: noisy points, which the deflection in a contact is a mean of, scatter less than each of them.
QUIET_FRAMES, SAFE_NOISE = 6, 2.0
#: chi^2 per frame from which on the motion is taken for none of a break-away.
MAX_CHI2 = 25.0
#: Frames after the last one at rest that are looked at.
FRAMES = 3
#: An object slides, and rests, when its displacement grows by more, and less, than these parts of the travel.
SLIDES, RESTS = 0.5, 0.05


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    """The frames around the break-away; indices count from the first frame looked at."""

    t: Float[np.ndarray, "n"]
    x: Float[np.ndarray, "n"]
    d: Float[np.ndarray, "n"]
    rest: int  #: last frame in which the object is seen to rest
    chosen: Int[np.ndarray, "F"]  #: frames whose positions are explained
    y: Float[np.ndarray, "F"]  #: displacement of the object in them [m]
    noise_m: float
    foam: _Foam


@dataclass(frozen=True, slots=True, eq=False)
class _Foam:
    """F(d) of the foam while it is compressed, measured in the same push."""

    rising: Float[np.ndarray, "k"]  #: deflections, never falling [m]
    loads: Float[np.ndarray, "k"]  #: forces [N]

    @property
    def stiffness_N_per_m(self) -> float:
        """Mean slope."""
        return float(self.loads[-1] - self.loads[0]) / max(float(self.rising[-1] - self.rising[0]), 1e-9)

    def load(self, depth: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """F(d) [N]; goes on straight beyond the largest deflection."""
        before = max(len(self.rising) - 3, 0)
        slope = (self.loads[-1] - self.loads[before]) / max(self.rising[-1] - self.rising[before], 1e-9)
        return np.interp(depth, self.rising, self.loads) + slope * np.maximum(depth - self.rising[-1], 0.0)


def breakaway_force(
    record: PushRecord, begin: int, until: int, dynamic_N: float
) -> tuple[float, float] | None:
    """Static friction and its standard deviation from the motion alone [N].

    Parameters
    ----------
    record
        The push.
    begin, until
        Frames of phase (a), ``until`` exclusive.
    dynamic_N
        Dynamic friction [N]; 0 when it is not known.

    Returns
    -------
    None for soft objects, which yield from the start, and for too few frames.
    """
    start = _find_start(record, begin, until)
    if start is None:
        return None
    t, x, rest, foam = start.t, start.x, start.rest, start.foam
    times = np.linspace(t[rest], t[min(rest + 2, len(t) - 1)], TIMES)
    log_mass = np.linspace(-2.5, 2.5, MASSES) * LOG_MASS_SIGMA
    typical = max(dynamic_N, 0.1 * float(foam.loads[-1])) / (FRICTION * GRAVITY_M_S2)
    at_rest = start.d[rest] + np.interp(times, t, x) - x[rest]  # deflection at t_0
    static = foam.load(at_rest)
    model = _displacements(times, typical * np.exp(log_mass), at_rest, start, dynamic_N)
    sigma = np.hypot(start.noise_m * np.sqrt(2.0), DISPLACEMENT_ERROR * np.abs(start.y))
    chi2 = np.sum(((model - start.y) / sigma) ** 2, axis=-1) + (log_mass / LOG_MASS_SIGMA) ** 2
    # Coulomb: it takes at least as much to start as to go on.
    prior = (static >= dynamic_N).astype(np.float64)
    if dynamic_N > 0:
        prior *= np.exp(-0.5 * ((static / dynamic_N - 1.0) / STATIC_EXCESS) ** 2)
    if not prior.any() or chi2[prior > 0].min() > MAX_CHI2 * len(start.chosen):
        return None  # it moves as no break-away does: frames are missing, or something else gave way
    chi2 -= chi2[prior > 0].min()
    weight = prior * np.exp(-0.5 * np.maximum(chi2, 0.0)).sum(axis=1)
    if not weight.sum() > 0:
        return None
    value, width = _moments(static, weight)
    # The posterior's width is right for the noise that was assumed. As that is larger than the true one by
    # SAFE_NOISE, its mean errs less: what the prior leaves open, and what the true noise moves it by.
    fraction = min(width / max(_moments(static, prior)[1], 1e-12), 1.0)
    width *= float(np.sqrt(fraction**2 + (1.0 - fraction**2) / SAFE_NOISE**2))
    grid = float(np.ptp(static)) / TIMES / np.sqrt(12.0)
    between = foam.stiffness_N_per_m * _between_m(t, x, rest)
    return value, float(np.sqrt(width**2 + grid**2 + between**2 + (METHOD_ERROR * value) ** 2))


def _find_start(record: PushRecord, begin: int, until: int) -> _Start | None:
    """Where the object begins to slide; None when it yields from the start or too few frames show it."""
    from scipy.optimize import isotonic_regression

    begin, until = max(begin - 1, 0), min(until + FRAMES, len(record.t_s))
    part = slice(begin, until)
    t, x, d, force = record.t_s[part], record.travel_m[part], record.deflection_m[part], record.force_N[part]
    if len(t) < 4 or not (np.isfinite(d).all() and np.isfinite(force).all()):
        return None
    noise = _noise_m(record, begin)
    pressed = np.flatnonzero(d > 5 * noise)
    if len(pressed) < 3:
        return None
    origin = int(pressed[0])
    moved = (x - x[origin]) - (d - d[origin])
    # Rest is tested in steps: a scale error of the deflection must not look like a motion.
    steps_x, steps_y = np.diff(x[origin:]), np.diff(moved[origin:])
    slides = np.flatnonzero(steps_y > SLIDES * steps_x)
    slides = slides[slides > 0]
    if len(slides) == 0:
        return None
    step = int(slides[0])
    while step > 0 and steps_y[step - 1] > RESTS * steps_x[step - 1] + 3.0 * noise:
        step -= 1
    if step == 0 or slides[0] - step >= FRAMES:
        return None  # soft, or it gave way before it was seen to rest
    # The last step that looks like rest may hold the first hundredths of a millimetre.
    rest = origin + step - 1
    zero = float(np.mean(moved[max(origin, rest - 2) : rest + 1]))
    chosen = np.arange(rest, min(rest + 2 + FRAMES, len(t)))
    deepest = int(np.argmax(d))
    rising = np.concatenate([[0.0], np.maximum.accumulate(d[origin : max(deepest, rest) + 1])])
    # Isotonic: the largest so far of noisy forces would be too high.
    seen = np.maximum(force[origin : max(deepest, rest) + 1], 0.0)
    loads = np.concatenate([[0.0], isotonic_regression(seen).x])
    # Past the frame of the largest deflection the foam is recovering and shows less.
    chosen = chosen[chosen <= max(deepest, rest + 1) + 1]
    if len(chosen) < 2:
        return None
    return _Start(t, x, d, rest, chosen, moved[chosen] - zero, noise, _Foam(rising, loads))


def _between_m(t: Float[np.ndarray, "n"], x: Float[np.ndarray, "n"], rest: int) -> float:
    """How far the platform may have been from the straight line between the frames of the break-away [m].

    A change of speed at an unknown time of a span makes a kink of a quarter of the span, at most.
    """
    speed = np.diff(x) / np.diff(t)
    span = slice(max(rest - 1, 0), rest + 2)
    return 0.25 * float(t[rest + 1] - t[rest]) * float(np.ptp(speed[span]))


def _moments(values: Float[np.ndarray, "T"], weight: Float[np.ndarray, "T"]) -> tuple[float, float]:
    """Mean and standard deviation under weights that need not add up to 1."""
    fraction = weight / weight.sum()
    mean = float(fraction @ values)
    return mean, float(np.sqrt(fraction @ (values - mean) ** 2))


def _noise_m(record: PushRecord, before: int) -> float:
    """Noise of the deflection from frame to frame [m].

    The declared sigma holds what stays the same in every frame, too (zero reference,
    texture at the edge), and that falls out of differences in time: with enough frames
    before the contact their scatter is used instead, never more than declared.
    """
    declared = max(float(np.nanmedian(record.deflection_sigma_m)), 1e-7)
    free = record.deflection_m[:before]
    free = free[np.isfinite(free)]
    if len(free) < QUIET_FRAMES:
        return declared
    return min(declared, max(SAFE_NOISE * float(np.std(np.diff(free))) / np.sqrt(2.0), 1e-6))


def _displacements(
    times: Float[np.ndarray, "T"],
    masses: Float[np.ndarray, "M"],
    depth0: Float[np.ndarray, "T"],
    start: _Start,
    dynamic_N: float,
) -> Float[np.ndarray, "T M F"]:
    """Displacement of the object at the frames for every break-away and mass (semi-implicit Euler)."""
    frames, foam = start.t[start.chosen], start.foam
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
        push = foam.load(deepest) - RELEASED * foam.stiffness_N_per_m * (deepest - depth)
        v = np.maximum(v + dt * (np.maximum(push, 0.0) - dynamic_N) / masses, 0.0)
        y = y + dt * v
        course.append(y)
    stack = np.array(course)
    at = np.clip((frames[None, :] - times[:, None]) / dt, 0.0, len(after) - 1e-6)
    low = at.astype(np.int64)
    fraction = at - low
    rows = np.arange(len(times))[:, None]
    found = stack[low, rows] * (1.0 - fraction)[..., None] + stack[low + 1, rows] * fraction[..., None]
    return np.moveaxis(found, 2, 1)
