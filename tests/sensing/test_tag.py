"""Haptic tags against simulated pushes with known truth, and on real pushes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.sensing import pushes

from visuohaptic.core import Estimate, Event, EventKind
from visuohaptic.database import merge_tags
from visuohaptic.sensing.push import (
    StopLimits,
    StopReason,
    fixed_probability,
    predictive_interval,
    stop_reason,
    tag_from_push,
)

TYPICAL_90 = 1.645


@pytest.fixture(scope="module")
def campaign():
    rng = np.random.default_rng(100)
    truths = [pushes.simulate(rng) for _ in range(100)]
    return [(truth, tag_from_push(truth.record, stopped_by=truth.stopped_by)) for truth in truths]


def test_fixed_and_movable_are_all_told_apart(campaign) -> None:
    for truth, tag in campaign:
        assert tag.fixed is (truth.kind == "fixed"), truth.kind
        assert tag.explored == 1


def test_fixed_is_as_probable_as_among_things_that_withstood_as_much() -> None:
    """Against 10^6 draws of what stands on floors; four deviations of a fraction of some 10^5 of them are 0.6 %."""
    rng = np.random.default_rng(8)
    needed = np.exp(np.log(2.65) + 1.1 * rng.standard_normal(10**6))
    needed[rng.random(10**6) < 0.15] = np.inf
    for withstood, limit in ((3.0, 20.0), (7.0, 20.0), (7.0, 10.0), (18.0, 20.0)):
        held = needed[needed > withstood]
        assert fixed_probability(withstood, limit) == pytest.approx(np.mean(held > limit), abs=0.006)
    assert fixed_probability(20.0, 20.0) == 1.0


def test_a_bound_is_below_what_was_needed(campaign) -> None:
    """Of 100 pushes none may say more than the friction; two sigma miss it once in 44 at most."""
    bounds = [(t, g.min_static_friction_N) for t, g in campaign if g.min_static_friction_N is not None]
    assert sum(bound > truth.static_N for truth, bound in bounds) <= 1
    for truth, tag in campaign:
        assert (tag.min_static_friction_N is None) is (tag.fixed is False), truth.kind


def test_dynamic_friction_is_within_five_percent_and_its_interval_honest(campaign) -> None:
    pairs = [(t, g.dynamic_friction_N) for t, g in campaign if t.kind in ("block", "heavy", "soft")]
    assert all(estimate is not None for _, estimate in pairs)
    error = np.array([estimate.value / truth.dynamic_N - 1 for truth, estimate in pairs])
    assert np.abs(error).max() < 0.05
    inside = [abs(e.value - t.dynamic_N) < TYPICAL_90 * e.sigma for t, e in pairs]
    # About 60 pushes: three standard deviations of a 90 % interval are 12 %.
    assert 0.78 <= np.mean(inside) <= 1.0


def test_static_friction_is_between_the_break_away_and_the_overshoot(campaign) -> None:
    pairs = [
        (t, g.static_friction_N)
        for t, g in campaign
        if t.kind in ("block", "heavy", "soft") and g.static_friction_N is not None
    ]
    error = np.array([estimate.value / truth.static_N - 1 for truth, estimate in pairs])
    assert len(pairs) > 30
    assert np.median(np.abs(error)) < 0.10


def test_a_door_shows_no_static_friction_and_a_wall_no_friction_at_all(campaign) -> None:
    for truth, tag in campaign:
        if truth.kind == "door":
            assert tag.static_friction_N is None
        if truth.kind == "fixed":
            assert tag.static_friction_N is None
            assert tag.dynamic_friction_N is None
            assert tag.drift is None
            assert tag.deformability is not None
            assert abs(tag.deformability.value) < 3 * tag.deformability.sigma


def test_drift_and_rotation_agree_with_the_truth(campaign) -> None:
    deviations = []
    for truth, tag in campaign:
        if tag.drift is not None and truth.kind in ("heavy", "block"):
            # Platform's way and object's way differ while the foam gives: 2 % of the push.
            deviations.append(abs(tag.drift.value - truth.drift) / np.hypot(tag.drift.sigma, 0.02))
            turned = tag.rotation_rad_per_m
            assert turned is not None
            assert abs(turned.value - truth.rotation_rad_per_m) < 5 * turned.sigma + 0.1
    assert max(deviations) < 4


def test_a_soft_object_shows_its_stiffness() -> None:
    rng = np.random.default_rng(8)
    found = []
    for _ in range(12):
        truth = pushes.simulate(rng, "soft")
        tag = tag_from_push(truth.record, stopped_by=truth.stopped_by)
        if tag.stiffness_N_per_m is not None:
            assert tag.deformability is not None
            assert 0.2 < tag.deformability.value < 1
            found.append(tag.stiffness_N_per_m.value / truth.stiffness_N_per_m)
    assert len(found) >= 4
    # A linear compression model on a nonlinear foam, as in the text.
    assert np.median(found) == pytest.approx(1.0, abs=0.15)


def test_the_largest_of_many_noisy_values_is_not_taken_at_face_value() -> None:
    """A plateau of one second before the motion: the raw maximum is 2 sigma too high."""
    rng = np.random.default_rng(3)
    values, raw = [], []
    for _ in range(60):
        t = np.arange(90) / 30
        travel = 0.01 * t
        deflection = np.minimum(travel, 0.008)
        force = np.minimum(1000 * deflection, 5.0)  # plateau of the foam from 5 mm on
        noisy = force + 0.1 * rng.standard_normal(90)
        record = pushes.PushRecord(
            t, np.ones(90, bool), noisy, np.full(90, 0.1), 0.0, deflection, np.full(90, 2e-5), travel,
            np.zeros(90), np.zeros(90), np.full(90, np.nan),
        )  # fmt: skip
        tag = tag_from_push(record)
        assert tag.static_friction_N is not None
        assert tag.rotation_rad_per_m is None
        values.append(tag.static_friction_N.value)
        raw.append(noisy[:81].max())
    assert np.mean(raw) > 5.15
    assert abs(np.mean(values) - 5.0) < 0.1


def test_a_fall_is_a_failure() -> None:
    truth = pushes.simulate(np.random.default_rng(2), "block")
    tag = tag_from_push(truth.record, events=[Event(EventKind.FALL, 2.0)])
    assert (tag.falls, tag.failed, tag.explored) == (True, 1, 1)


def test_stop_conditions() -> None:
    limits = StopLimits(deflection_m=0.012, force_N=30.0, distance_m=0.25)
    assert stop_reason(0.013, 1, 0, limits) == StopReason.DENSIFIED
    assert stop_reason(0.002, 29.9, 0, limits, force_sigma_N=0.1) == StopReason.TOO_HEAVY
    assert stop_reason(0.002, 5, 0.3, limits) == StopReason.PUSHED_FAR
    assert stop_reason(0.002, 5, 0.2, limits) is None


@pytest.mark.parametrize(("deflection_m", "force_N"), [(0.002, np.nan), (np.nan, 5.0), (np.nan, np.nan)])
def test_a_push_whose_force_is_not_read_stops(deflection_m: float, force_N: float) -> None:
    limits = StopLimits(deflection_m=0.012, force_N=30.0, distance_m=0.25, max_unread_frames=4)
    # Who does not count frames stops at the first; who counts may bridge three.
    assert stop_reason(deflection_m, force_N, 0.0, limits) == StopReason.UNREAD
    reasons = [stop_reason(deflection_m, force_N, 0.0, limits, unread_frames=n) for n in range(1, 6)]
    assert reasons == [None, None, None, StopReason.UNREAD, StopReason.UNREAD]


def test_a_limit_that_is_seen_says_more_than_a_reading_that_is_not() -> None:
    limits = StopLimits(deflection_m=0.012, force_N=30.0, distance_m=0.25)
    assert stop_reason(0.013, np.nan, 0.0, limits) == StopReason.DENSIFIED
    assert stop_reason(np.nan, 31.0, 0.0, limits) == StopReason.TOO_HEAVY
    assert stop_reason(np.nan, np.nan, 0.3, limits) == StopReason.PUSHED_FAR


def test_the_predictive_interval_covers_the_next_push() -> None:
    rng = np.random.default_rng(1)
    hits = []
    for _ in range(2000):
        draws = rng.normal(5.0, 1.5, 6)
        estimate = Estimate(draws[:5].mean(), 0.0, draws[:5].std(ddof=1), 5)
        low, high = predictive_interval(estimate, prior_samples=0.0)
        hits.append(low < draws[5] < high)
    assert np.mean(hits) == pytest.approx(0.9, abs=0.027)  # four sigma of 2000 draws


@pytest.mark.data
def test_real_pushes_spread_and_the_tag_carries_it(data: Path) -> None:
    """Five logs of 50 pushes (Zhou 2016): other contact points, same object and floor."""
    rng = np.random.default_rng(0)
    logs = sorted((data / "navigation" / "dev" / "push" / "zhou2016").glob("*.txt.gz"))
    assert len(logs) == 5
    hits, spreads = [], []
    for log in logs:
        real = pushes.read_real_pushes(log)
        assert len(real) in (49, 50)
        tags = [tag_from_push(pushes.real_record(push)) for push in real]
        tags = [tag for tag in tags if tag.dynamic_friction_N is not None]
        assert len(tags) >= 48
        forces = np.array([tag.dynamic_friction_N.value for tag in tags])
        spreads.append(forces.std(ddof=1) / forces.mean())
        for _ in range(60):
            order = rng.permutation(len(tags))
            merged = tags[order[0]]
            for i in order[1:8]:
                merged = merge_tags(merged, tags[i])
            low, high = predictive_interval(merged.dynamic_friction_N)
            held_out = forces[order[8:]]
            hits.append(np.mean((held_out > low) & (held_out < high)))
    # 18-49 % is told for the force of these recordings; its magnitude spreads by less than one component.
    assert min(spreads) > 0.12
    assert max(spreads) < 0.49
    assert 0.85 <= np.mean(hits) <= 0.95
