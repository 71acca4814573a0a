"""The break-away against pushes integrated here: a linear foam, another integrator, finer steps."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.sensing.push import PushRecord, breakaway_force, rest_hypotheses

FRAME_S, NOISE_M = 1 / 30, 1e-5


def push(
    rng: np.random.Generator,
    *,
    speed: float,
    mass: float,
    static: float,
    dynamic: float,
    k: float = 1000.0,
    slower: float = 1.0,
    drop: float = 0.0,
    object_k: float = np.inf,
) -> tuple[PushRecord, int, int]:
    """Record of an object, rigid or a linear spring, in front of a linear foam, and the frames of phase (a).

    From 60 ms after the contact on the platform drives at ``slower`` of its speed; frames are lost with
    probability ``drop``.
    """
    dt, y, v, moving = 2e-5, 0.0, 0.0, False
    rows, next_frame, start = [], rng.uniform(0, FRAME_S), -0.002
    for step in range(round(0.6 / dt)):
        t = step * dt
        late = max(t + start / speed - 0.06, 0.0)
        x = start + speed * (t - (1 - slower) * late)
        depth = max(x - y, 0.0) / (1.0 + k / object_k)  # springs in series
        moving = moving or k * depth > static
        if moving:
            v = max(v + dt * (k * depth - dynamic) / mass, 0.0)
            y += dt * v
        if t >= next_frame:
            if rng.random() >= drop:
                rows.append((t, x, depth, k * depth, y))
            next_frame += FRAME_S
    t, x, depth, force, way = np.array(rows).T
    count = len(t)
    nothing = np.zeros(count)
    record = PushRecord(
        t, np.ones(count, bool), force + 0.002 * rng.standard_normal(count), np.full(count, 0.002), 0.0,
        depth + NOISE_M / 2 * rng.standard_normal(count), np.full(count, NOISE_M), x - start,
        nothing, nothing, np.full(count, np.nan),
    )  # fmt: skip
    return record, int(np.argmax(depth > 5e-5)), int(np.argmax(way > 1e-4)) + 1


def breakaway(record: PushRecord, begin: int, until: int, dynamic: float):
    rests = rest_hypotheses(record, record.t_s[begin], record.t_s[until - 1], dynamic)
    return breakaway_force(record, max(rests, key=lambda rest: rest.probability), dynamic) if rests else None


@pytest.mark.parametrize("speed", [0.02, 0.035, 0.05])
def test_static_friction_without_the_overshoot(speed: float) -> None:
    rng = np.random.default_rng(7)
    error, peak, inside = [], [], []
    for _ in range(30):
        dynamic = rng.uniform(2.0, 6.0)
        static = dynamic * rng.uniform(1.0, 1.25)
        mass = dynamic / (rng.uniform(0.25, 0.6) * 9.81)
        record, begin, until = push(rng, speed=speed, mass=mass, static=static, dynamic=dynamic)
        found = breakaway(record, begin, until, dynamic)
        if found is None:
            continue  # two frames of phase (a) at most
        value, sigma, _ = found
        error.append(value / static - 1)
        peak.append(record.force_N.max() / static - 1)
        inside.append(abs(value - static) < 1.645 * sigma)
    assert len(error) >= 27
    # The peak is too high by v sqrt(m k), a fifth and more; the aim for the break-away is 5 %.
    assert np.median(np.abs(error)) < 0.05
    assert np.median(np.abs(error)) < 0.5 * np.median(np.abs(peak))
    # 30 pushes: two standard deviations of a 90 % interval are 11 %.
    assert np.mean(inside) >= 0.79


def test_a_platform_that_slows_down_and_frames_that_are_lost() -> None:
    """A controller brakes at the contact, and a fifth of the frames never came: no worse than three sigmas."""
    rng = np.random.default_rng(8)
    off = []
    for _ in range(40):
        dynamic = rng.uniform(3.0, 6.0)
        static = dynamic * rng.uniform(1.0, 1.25)
        mass = dynamic / (rng.uniform(0.25, 0.6) * 9.81)
        record, begin, until = push(
            rng, speed=0.06, mass=mass, static=static, dynamic=dynamic, slower=0.33, drop=0.2
        )
        found = breakaway(record, begin, until, dynamic)
        if found is not None:
            off.append((abs(found[0] - static) / found[1], abs(found[0] / static - 1)))
    sigmas, fraction = np.array(off).T
    assert len(off) >= 20
    assert fraction.max() < 0.3
    # Of 40 normal errors one in a hundred beyond three sigmas is one at the most by chance.
    assert (sigmas > 3.0).sum() <= 1


def test_a_soft_object_yields_before_it_slides() -> None:
    """An object of 3000 N/m behind a foam of 1000 N/m: a quarter of the travel is its own, and none of it is sliding."""
    rng = np.random.default_rng(9)
    error, compliance = [], []
    for _ in range(20):
        dynamic = rng.uniform(3.0, 6.0)
        static, mass = dynamic * rng.uniform(1.05, 1.25), dynamic / (rng.uniform(0.25, 0.6) * 9.81)
        record, begin, until = push(
            rng, speed=0.02, mass=mass, static=static, dynamic=dynamic, object_k=3000.0
        )
        rests = rest_hypotheses(record, record.t_s[begin], record.t_s[until - 1], dynamic)
        best = max(rests, key=lambda rest: rest.probability)
        compliance.append((best.model[1] * 3000.0 - 1.0, 3000.0 * np.sqrt(best.covariance[1, 1])))
        found = breakaway_force(record, best, dynamic)
        assert found is not None
        error.append(found[0] / static - 1)
    off, sigma = np.array(compliance).T
    assert np.median(np.abs(error)) < 0.05
    # Twenty normal errors: one in three hundred beyond three sigmas.
    assert np.abs(off / sigma).max() < 3.0
    assert sigma.max() < 0.2


def test_what_is_not_touched_is_not_at_rest() -> None:
    t = np.arange(40) * FRAME_S
    nothing = np.zeros(40)
    record = PushRecord(
        t, np.ones(40, bool), nothing, np.full(40, 0.01), 0.0, nothing, np.full(40, NOISE_M), 0.03 * t,
        nothing, nothing, nothing,
    )  # fmt: skip
    assert rest_hypotheses(record, 0.1, 1.0, 3.0) == ()
