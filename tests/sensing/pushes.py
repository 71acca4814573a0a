"""Truth for haptic tags, made apart: a platform on a line, a foam, and what it pushes.

Newton's law of a block with Coulomb friction (static and dynamic), pushed
through a nonlinear foam in series with an elastic object, integrated with
small steps; sampled at the frame rate with noise and a common scale error.
"""

from __future__ import annotations

import gzip
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from visuohaptic.sensing.push import PushRecord, StopReason

KINDS = ("block", "heavy", "fixed", "door", "soft")
CAPABILITY_N = 40.0
DENSIFIED_M = 0.012


def foam_force(delta: np.ndarray | float) -> np.ndarray | float:
    """A strip pressed over some centimetres: stiff start, plateau, hardening [N]."""
    return (
        12.0 * np.tanh(np.asarray(delta) / 0.0015) + 1.2e3 * np.asarray(delta) + 8e8 * np.asarray(delta) ** 4
    )


@dataclass(frozen=True)
class TruePush:
    kind: str
    record: PushRecord
    stopped_by: StopReason | None
    static_N: float
    dynamic_N: float
    stiffness_N_per_m: float
    drift: float
    rotation_rad_per_m: float
    moves_s: float  # nan when it never moves
    stop_s: float
    coasts_s: float


def simulate(rng: np.random.Generator, kind: str | None = None) -> TruePush:
    kind = kind or KINDS[int(rng.integers(len(KINDS)))]
    dynamic = {"block": rng.uniform(2, 12), "heavy": rng.uniform(12, 25), "door": 0.15}.get(kind, 1e6)
    static = dynamic * rng.uniform(1.0, 1.3)
    stiffness = np.inf
    if kind == "soft":
        stiffness = rng.uniform(1e3, 5e3)
        dynamic = rng.uniform(4, 10)
        static = dynamic * rng.uniform(1.0, 1.3)
    # A block of friction mu m g with mu about 0.4; a door has inertia and hardly any friction.
    mass = 6.0 if kind == "door" else min(dynamic, 30.0) / 4.0
    speed, width = 0.02, rng.uniform(0.04, 0.08)
    gap = rng.uniform(0.005, 0.01)
    delta = np.linspace(0, 0.02, 4001)
    force_of = np.asarray(foam_force(delta))
    total = delta + (force_of / stiffness if np.isfinite(stiffness) else 0.0)
    dt, frame = 2e-4, 1 / 30
    t, x, y, v, moved_at, stop_at = 0.0, 0.0, 0.0, 0.0, np.nan, np.nan
    why: StopReason | None = None
    rows, next_frame, end = [], 0.0, np.inf
    robot_speed, last_motion = speed, np.nan
    damping = 60.0  # of the foam in compression [N s/m], keeps the block from ringing
    grid = total[1:] / delta[1:]
    assert grid.min() >= 1.0
    step_total = total[-1] / 4000
    # Numbers of Python: steps with those of NumPy take three times as long.
    table_force = np.interp(np.arange(4001) * step_total, total, force_of).tolist()
    table_delta = np.interp(np.arange(4001) * step_total, total, delta).tolist()
    step_total = float(step_total)
    while t < end and t < 9.0:
        squeeze = x - gap - y
        if squeeze > 0:
            place = min(squeeze / step_total, 3999.0)
            low = int(place)
            fraction = place - low
            force = table_force[low] + fraction * (table_force[low + 1] - table_force[low])
            d = table_delta[low] + fraction * (table_delta[low + 1] - table_delta[low])
        else:
            force, d = 0.0, 0.0
        drive = force + (damping * (robot_speed - v) if squeeze > 0 and v != 0 else 0.0)
        drive = max(drive, 0.0)
        if t >= next_frame:
            rows.append((t, x, y, d, force))
            next_frame += frame
            if math.isnan(stop_at):
                if d >= DENSIFIED_M:
                    why = StopReason.DENSIFIED
                elif force >= CAPABILITY_N:
                    why = StopReason.TOO_HEAVY
                elif y > width:
                    why = StopReason.PUSHED_FAR
                if why is not None:
                    stop_at, robot_speed, end = t, 0.0, t + 1.5
        if v == 0.0:
            if force > static:
                v = 1e-6
                if math.isnan(moved_at):
                    moved_at = t
        else:
            new = v + dt * (drive - math.copysign(dynamic, v)) / mass
            v = 0.0 if new <= 0 else new
            if v > 1e-3:
                last_motion = t
        y += dt * v
        x += dt * robot_speed
        t += dt
    times, travel, position, deflection, force = np.array(rows).T
    count = len(times)
    sigma_d, sigma_f, scale_sigma = 2e-5, rng.uniform(0.005, 0.03), 0.01
    drift, turn = rng.normal(0, 0.05), rng.normal(0, 0.5)
    scale = 1.0 + scale_sigma * rng.standard_normal()
    record = PushRecord(
        t_s=times,
        force_valid=np.ones(count, dtype=bool),
        force_N=force * scale + sigma_f * rng.standard_normal(count),
        force_sigma_N=np.full(count, sigma_f),
        force_scale_sigma=scale_sigma,
        deflection_m=deflection + sigma_d * rng.standard_normal(count),
        deflection_sigma_m=np.full(count, sigma_d),
        travel_m=travel,
        lateral_m=np.zeros(count),
        contact_m=0.01 + drift * position + 2e-4 * rng.standard_normal(count),
        angle_rad=turn * position + 2e-3 * rng.standard_normal(count),
    )
    coasts = max(last_motion - stop_at, 0.0) if np.isfinite(stop_at) and np.isfinite(last_motion) else 0.0
    return TruePush(kind, record, why, static, dynamic, stiffness, drift, turn, moved_at, stop_at, coasts)


@dataclass(frozen=True)
class RealPush:
    """One push of the CMU recordings (Zhou 2016), SI units."""

    force_t_s: np.ndarray
    force_N: np.ndarray  # (n, 2), zeroed on the first half second
    pusher_t_s: np.ndarray
    pusher_m: np.ndarray  # (m, 2)
    object_before: np.ndarray  # x, y [m], angle [rad]
    object_after: np.ndarray


def read_real_pushes(path: Path) -> list[RealPush]:
    """Read one log: count, then per push both object poses, the forces and the pusher's poses."""

    def pose(line: str) -> np.ndarray:
        x, y, _, w, _, _, z = (float(value) for value in line.split())
        return np.array([x / 1000, y / 1000, 2 * np.arctan2(z, w)])

    with gzip.open(path, "rt", encoding="ascii") as stream:
        count = int(next(stream))
        pushes = []
        for _ in range(count):
            before, after = pose(next(stream)), pose(next(stream))
            forces = np.array([next(stream).split() for _ in range(int(next(stream)))], dtype=float)
            poses = np.array([next(stream).split() for _ in range(int(next(stream)))], dtype=float)
            zero = forces[:50, 1:].mean(axis=0)
            pushes.append(
                RealPush(forces[:, 0], forces[:, 1:] - zero, poses[:, 0], poses[:, 1:3] / 1000, before, after)
            )
    return pushes


def real_record(push: RealPush) -> PushRecord:
    """A rigid pusher has no foam: its deflection is the force through a stiff spring, as a foam would say."""
    t = push.force_t_s
    keep = np.concatenate([[True], np.diff(t) > 0])
    t = t[keep]
    force = np.hypot(*push.force_N[keep].T)
    x = np.interp(t, push.pusher_t_s, push.pusher_m[:, 0])
    y = np.interp(t, push.pusher_t_s, push.pusher_m[:, 1])
    travel = np.maximum.accumulate(np.hypot(x - x[0], y - y[0]))
    loaded = force > 0.3
    first = int(np.argmax(loaded))
    turn = np.angle(np.exp(1j * (push.object_after[2] - push.object_before[2])))
    # Only the poses before and after are known: the object turns evenly with the push.
    fraction = np.clip((travel - travel[first]) / max(travel[-1] - travel[first], 1e-9), 0, 1)
    return PushRecord(
        t_s=t - t[0],
        force_valid=np.ones(len(t), dtype=bool),
        force_N=force,
        force_sigma_N=np.full(len(t), 0.01),
        force_scale_sigma=0.0,
        deflection_m=force / 2e4,
        deflection_sigma_m=np.full(len(t), 1e-6),
        travel_m=travel,
        lateral_m=np.zeros(len(t)),
        contact_m=np.zeros(len(t)),
        angle_rad=turn * fraction,
    )
