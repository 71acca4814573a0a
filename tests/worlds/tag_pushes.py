"""Pushes of objects on floors of five kinds, measured by a foam strip: one-dimensional, many pushes simultaneously.

Symbols: x platform, y object, s = x - gap - y squeeze, shared by the foam (d) and an elastic object (e = s - d);
F pushing force, R friction of the floor.

    coulomb    R <= F_s at rest, F_d in motion, with exact stopping (Karnopp)
    stribeck   bristles that bend before they slip (LuGre), R falls with speed to F_d
    rate       friction that grows or falls with the logarithm of the speed and linearly with it
    place      an uneven floor: F_d changes along the path by a tenth to a quarter
    compliant  an elastic object with stick-slip (LuGre with weakening), or a body that rolls

Foam loads along one curve, unloads below it and is slightly viscous. The readings are those of a camera: 30 frames
a second with jitter and missing frames, white noise, a scale error that is partly constant during the push and partly
drifts, and, where unloading was not calibrated, no force while the foam unloads. Every declared standard deviation is true.

The contact point on an object, the position on the floor, the time at rest and the speed differ from push to push.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["SETTINGS", "Push", "pushes"]

SETTINGS = ("coulomb", "stribeck", "rate", "place", "compliant")
GRAVITY_M_S2 = 9.81
#: Time step of the integration, and of its output.
STEP_S, KEPT_STEPS, KEPT_S = 2e-4, 5, 1e-3
FRAME_S = 1 / 30
#: Depth at which the foam's curve has the force of its unit [m].
UNIT_M = 0.008
#: Sliding distance after which bristles have slipped and the object has broken away [m].
BROKEN_M = 5e-4
#: Foam unloads, for the sensor, below its largest deflection by this part and four deviations.
UNLOADED = 0.02
#: Viscosity of the foam, and of an elastic object [N s/m].
FOAM_DAMPING, OBJECT_DAMPING = 1.0, 8.0


@dataclass(frozen=True, eq=False)
class Push:
    """Readings of one push, N frames, and the ground truth."""

    t_s: np.ndarray
    force_N: np.ndarray  #: NaN where the sensor does not read
    force_sigma_N: np.ndarray  #: from frame to frame
    force_scale_sigma: np.ndarray  #: relative, common and slow
    deflection_m: np.ndarray
    deflection_sigma_m: np.ndarray
    travel_m: np.ndarray
    static_N: float  #: pushing force at which the object broke away
    dynamic_N: float  #: mean friction of the floor from there until the platform brakes
    stiffness_N_per_m: float  #: of the object; inf: rigid
    slid_m: float  #: how far it was pushed


@dataclass(eq=False)
class _World:
    """Parameters of all pushes, one value each."""

    kinetic_N: np.ndarray
    static_N: np.ndarray
    mass_kg: np.ndarray  #: that has to be accelerated
    stiffness: np.ndarray
    foam_N: np.ndarray  #: force of the foam at the unit depth
    loss: np.ndarray  #: part of the force that unloading takes away
    loss_m: np.ndarray  #: depth over which it does
    speed: np.ndarray
    gap_m: np.ndarray
    brake_s: np.ndarray  #: when the platform begins to stop
    ripple: np.ndarray  #: of its speed, relative
    bristle: np.ndarray  #: N/m; 0: Karnopp
    stribeck_m_s: np.ndarray
    log_rate: np.ndarray  #: friction by decade of speed
    viscous: np.ndarray  #: N s/m
    uneven: np.ndarray  #: relative amplitude
    waves: np.ndarray  #: wave numbers and phases of the floor, (2, 4, B)


def pushes(cases: Sequence[tuple[str, int, int]]) -> list[Push]:
    """Pushes of cases (setting, seed, number): a seed is an object, a number one of its pushes."""
    rows, readers = [], []
    for setting, seed, number in cases:
        of_object, of_push, reader = (
            np.random.default_rng([seed, SETTINGS.index(setting), *more])
            for more in ((0, 0), (number, 1), (number, 2))
        )
        rows.append(_one(setting, of_object, of_push))
        readers.append(reader)
    world = _World(**{name: np.stack([row[name] for row in rows], axis=-1) for name in rows[0]})
    kept, *truth = _integrated(world)
    return [
        _read(rng, world, i, kept[:, :, i], tuple(float(values[i]) for values in truth))
        for i, rng in enumerate(readers)
    ]


def _one(setting: str, obj: np.random.Generator, push: np.random.Generator) -> dict[str, np.ndarray]:
    """Parameters of one push: first those of the object, then those that differ from push to push."""
    u = obj.uniform
    kinetic, ratio = np.exp(u(np.log(1.0), np.log(12.0))), 1.0 + 0.5 * u() ** 1.5
    mass = kinetic / (u(0.2, 0.6) * GRAVITY_M_S2)
    soft = setting == "compliant" or u() < 0.4
    stiffness = np.exp(u(np.log(1e3), np.log(1.5e4))) if soft else np.inf
    rolls = setting == "compliant" and u() < 0.4
    if rolls:
        mass, kinetic, ratio = 1.5 * mass, 0.15 * kinetic + 0.4, 1.0 + 0.2 * u()
    foam, loss, loss_m, patches = kinetic * ratio * u(1.2, 4.0), u(0.1, 0.35), u(4e-4, 1.2e-3), u(0.05, 0.3)
    bristles = setting == "stribeck" or (setting == "compliant" and not rolls)
    bristle_m, stribeck, viscous = u(1e-5, 6e-5), u(0.003, 0.03), u(0.0, 0.1)
    log_rate, linear, uneven = u(-0.08, 0.08), u(0.0, 3.0), u(0.1, 0.25)
    # Where it is touched and where it stands: the limit surface's ellipse, patches of the floor, time at rest.
    aside = push.uniform(-0.9, 0.9) / 0.67
    place = np.exp(patches * push.normal()) / (np.sqrt(1.0 + aside**2) if not rolls else 1.0)
    kinetic *= place
    dwell = 0.03 * push.uniform(0.0, 3.0)
    static = kinetic * ratio * (1.0 + dwell)
    speed, gap = push.uniform(0.012, 0.03 if setting == "compliant" else 0.045), push.uniform(0.004, 0.01)
    strain = UNIT_M * min(static / foam, 1.3) + (static / stiffness if soft else 0.0)
    brake = (gap + strain + push.uniform(0.02, 0.06)) / speed
    length = 2 * np.pi / np.exp(push.uniform(np.log(0.008), np.log(0.08), 4))
    row = {
        "kinetic_N": kinetic, "static_N": static, "mass_kg": mass, "foam_N": foam, "loss": loss,
        "stiffness": stiffness * np.exp(0.15 * push.normal()),
        "loss_m": loss_m, "speed": speed, "gap_m": gap, "brake_s": brake, "ripple": push.uniform(0.0, 0.03),
        "bristle": static / bristle_m if bristles else 0.0, "stribeck_m_s": stribeck,
        "log_rate": log_rate if setting == "rate" else 0.0,
        "viscous": kinetic * (linear if setting == "rate" else viscous if bristles else 0.0),
        "uneven": uneven if setting == "place" or rolls else 0.0,
        "waves": np.stack([length, push.uniform(0, 2 * np.pi, 4)]),
    }  # fmt: skip
    return {name: np.asarray(value, dtype=float) for name, value in row.items()}


def _curve(depth: np.ndarray, foam_N: np.ndarray) -> np.ndarray:
    """Force of the foam while it is loaded: stiff, a plateau, hardening."""
    part = depth / UNIT_M
    return foam_N * (0.5 * np.tanh(part / 0.3) + 0.3 * part + 0.2 * part**3)


def _slope(depth: np.ndarray, foam_N: np.ndarray) -> np.ndarray:
    part = depth / UNIT_M
    return foam_N / UNIT_M * (0.5 / 0.3 / np.cosh(part / 0.3) ** 2 + 0.3 + 0.6 * part**2)


def _foam(w: _World, depth: np.ndarray, deepest: np.ndarray) -> np.ndarray:
    """Force at a depth after a largest depth."""
    lost = w.loss * -np.expm1((depth - deepest) / w.loss_m)
    return _curve(depth, w.foam_N) * (1.0 - lost)


def _friction(w: _World, y: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Friction of steady sliding [N]."""
    field = np.sin(w.waves[0] * y + w.waves[1]).sum(axis=0) / np.sqrt(2.0)
    kinetic = w.kinetic_N * (1.0 + w.uneven * field / 1.5)
    falls = np.where(
        w.bristle > 0, (w.static_N - w.kinetic_N) * np.exp(-((speed / w.stribeck_m_s) ** 2)), 0.0
    )
    rate = 1.0 + w.log_rate * np.log10(np.maximum(speed, 1e-4) / 0.02)
    return kinetic * rate + falls + w.viscous * speed


def _integrated(w: _World) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Platform, foam's depth, force that the foam shows and whether it unloads, every millisecond; and the truth."""
    size = w.speed.shape
    y, v, z, d, deepest = (np.zeros(size) for _ in range(5))
    static, worked, sliding = np.full(size, np.nan), np.zeros(size), np.zeros(size)
    peak, x, rigid = np.zeros(size), np.zeros(size), ~np.isfinite(w.stiffness)
    k = np.where(rigid, 0.0, w.stiffness)
    # The static friction is that of the floor at the start.
    excess = w.static_N / w.kinetic_N
    kept, pushed_m = [], np.zeros(size)
    brake_end = w.brake_s + 0.1
    for step in range(int((brake_end.max() + 0.4) / STEP_S)):
        t = step * STEP_S
        ramp = np.clip((brake_end - t) / 0.1, 0.0, 1.0)
        drive = w.speed * ramp * (1.0 + w.ripple * np.sin(40.0 * t + w.waves[1, 0]))
        x = x + STEP_S * drive
        squeeze = np.maximum(x - w.gap_m - y, 0.0)
        closing = np.where(squeeze > 0, drive - v, 0.0)
        shown = _foam(w, d, deepest)
        soft_rate = (k * (squeeze - d) - shown + OBJECT_DAMPING * closing) / (OBJECT_DAMPING + FOAM_DAMPING)
        before = d
        d = np.where(rigid, squeeze, np.clip(d + STEP_S * soft_rate, 0.0, squeeze))
        deepest = np.maximum(deepest, d)
        push = np.where(squeeze > 0, _foam(w, d, deepest) + FOAM_DAMPING * (d - before) / STEP_S, 0.0)
        push = np.maximum(push, 0.0)
        steady = _friction(w, y, np.abs(v))
        # LuGre: bristles bend by z and are dragged along.
        bend = v - w.bristle * np.abs(v) * z / steady
        z = z + STEP_S * bend
        damped = 0.6 * np.sqrt(w.bristle * w.mass_kg) * np.exp(-((v / 0.01) ** 2))
        lugre = w.bristle * z + damped * bend
        threshold = steady * excess
        stuck = (v == 0.0) & (push <= threshold)
        karnopp = np.where(stuck, push, steady)
        floor = np.where(w.bristle > 0, lugre, karnopp)
        new = v + STEP_S * (push - floor) / w.mass_kg
        new = np.where(w.bristle > 0, new, np.where(stuck, 0.0, np.maximum(new, 0.0)))
        first = np.isnan(static)
        peak = np.where(first, np.maximum(peak, floor), peak)
        breaks = first & np.where(w.bristle > 0, y > BROKEN_M, (v == 0.0) & ~stuck)
        static = np.where(breaks, np.where(w.bristle > 0, peak, push), static)
        v = new
        y = y + STEP_S * v
        counts = ~np.isnan(static) & (t < w.brake_s)
        worked, sliding = worked + counts * floor, sliding + counts
        pushed_m = np.where(t < w.brake_s, y, pushed_m)
        if step % KEPT_STEPS == 0:
            kept.append((x, d, _foam(w, d, deepest), deepest))
    return np.array(kept), static, worked / np.maximum(sliding, 1), pushed_m


def _read(
    rng: np.random.Generator,
    w: _World,
    i: int,
    kept: np.ndarray,
    truth: tuple[float, ...],
) -> Push:
    """Frames of one push: ``kept`` is (milliseconds, 4)."""
    grid = KEPT_S * np.arange(len(kept))
    end = min(float(w.brake_s[i]) + 0.5, grid[-1])
    t = np.arange(rng.uniform(0, FRAME_S), end, FRAME_S)
    t = t + rng.uniform(-0.002, 0.002, len(t))
    t = t[(rng.random(len(t)) > 0.02) & (t >= 0)]
    x, d, force, deepest = (np.interp(t, grid, column) for column in kept.T)
    noise_m = rng.uniform(1e-5, 4e-5)
    noise_N = np.hypot(0.004, noise_m * _slope(d, w.foam_N[i]))
    scale = np.full(len(t), rng.uniform(0.007, 0.03))
    unloads = deepest - d > np.maximum(UNLOADED * deepest, 4 * noise_m)
    calibrated = rng.random() < 0.7
    scale = np.hypot(scale, np.where(unloads, 0.2 * w.loss[i], 0.0))
    same = rng.uniform(0.5, 1.0)
    slow = _wandering(rng, t)
    relative = scale * (same * rng.normal() + np.sqrt(1.0 - same**2) * slow)
    reading = force * (1.0 + relative) + noise_N * rng.standard_normal(len(t))
    reading[unloads & (not calibrated)] = np.nan
    wheels = 1.0 + 0.003 * rng.normal()
    travel = wheels * x + np.cumsum(rng.normal(0.0, 1.0, len(t))) * 1e-4 / np.sqrt(len(t))
    return Push(
        t, reading, noise_N, scale, d * (1.0 + 0.005 * rng.normal()) + noise_m * rng.standard_normal(len(t)),
        np.full(len(t), noise_m), travel, truth[0], truth[1], float(w.stiffness[i]), truth[2],
    )  # fmt: skip


def _wandering(rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """A unit Gaussian process that forgets within half a second."""
    value = np.empty(len(t))
    value[0] = rng.normal()
    for j in range(1, len(t)):
        keep = np.exp(-(t[j] - t[j - 1]) / 0.5)
        value[j] = keep * value[j - 1] + np.sqrt(1.0 - keep**2) * rng.normal()
    return value
