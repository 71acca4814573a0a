"""Costs of pushes compared with the numbers of the text, and their invariants."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from visuohaptic.core import Estimate, HapticTag, InputError
from visuohaptic.navigation.problem import (
    PushCosts,
    failure_probability,
    manipulability,
    push_cost,
    push_speed_m_s,
)

from .plan_scenes import BIN, FULL_BIN, ROBOT, STOOL, TABLE, TOWER


def test_the_stool_of_the_text_costs_seven_seconds_of_which_four_are_constant():
    cost = push_cost(STOOL, 0.15, ROBOT)
    assert cost.total_s == pytest.approx(7.0)
    assert cost.setup_s == 4.0
    assert cost.push_s == pytest.approx(3.0)
    assert cost.failure_probability == pytest.approx(0.1)  # of the contract's example


def test_an_object_that_may_turn_away_is_pushed_once_more_as_often():
    cost = push_cost(STOOL, 0.15, ROBOT, turn_probability=0.3)
    assert cost.failure_probability == pytest.approx(1 - 0.9 * 0.7)
    # Of its own failures nothing is charged before it has failed; three in ten attempts of 7 s turn, and are made again.
    assert cost.fail_s == pytest.approx(7.0 * 0.3 / 0.7)
    risky = push_cost(STOOL, 0.15, ROBOT, PushCosts(risk_s=10.0), turn_probability=0.3)
    assert risky.fail_s - cost.fail_s == pytest.approx(-10.0 * math.log(0.63))


@pytest.mark.parametrize(
    ("tag", "reason"),
    [
        (TOWER, "fixed"),
        (HapticTag(falls=True), "falls"),
        (HapticTag(static_friction_N=Estimate(20.1, 0.0)), "20.1 N"),
        (HapticTag(min_static_friction_N=20.1), "more than 20.1 N"),
    ],
)
def test_fixed_falling_and_heavy_objects_are_never_pushed(tag, reason):
    allowed = manipulability(tag, ROBOT)
    assert not allowed.possible
    assert reason in allowed.reason
    assert push_cost(tag, 0.1, ROBOT).total_s == math.inf


def test_drift_and_rotation_limit_the_length():
    tag = HapticTag(drift=Estimate(-0.5, 0.0))
    assert manipulability(tag, ROBOT).max_length_m == pytest.approx(0.2)
    assert push_cost(tag, 0.21, ROBOT).total_s == math.inf
    assert math.isfinite(push_cost(tag, 0.2, ROBOT).total_s)
    turning = HapticTag(rotation_rad_per_m=Estimate(2.1, 0.0))
    assert manipulability(turning, ROBOT).max_length_m == pytest.approx(0.5)


def test_effort_slows_the_push_and_several_failures_make_it_dear():
    speeds = [push_speed_m_s(tag, ROBOT) for tag in (BIN, FULL_BIN, STOOL, TABLE)]
    assert speeds == sorted(speeds, reverse=True)
    assert speeds[2] == ROBOT.v_push_m_s
    assert speeds[3] < ROBOT.v_push_m_s
    costs = [push_cost(replace(STOOL, explored=5, failed=failed), 0.3, ROBOT).total_s for failed in range(6)]
    assert costs == sorted(costs)
    assert math.isfinite(costs[-1])


def test_failure_from_the_counters_is_the_mean_of_a_beta_distribution():
    costs = PushCosts()
    rng = np.random.default_rng(0)
    tag = HapticTag(explored=4, failed=1)
    # Importance sampling of the posterior: prior Beta(0.2, 0.8), likelihood p (1 - p)^3.
    p = rng.beta(costs.prior_failures, costs.prior_successes, 400_000)
    weight = p * (1 - p) ** 3
    # 400,000 weighted draws: standard error below 0.002.
    expected = (p * weight).sum() / weight.sum()
    assert failure_probability(tag, 0.2, ROBOT) == pytest.approx(expected, abs=0.006)


def test_uncertain_friction_near_the_limit_is_a_risk():
    sure = HapticTag(static_friction_N=Estimate(18.0, 0.0), explored=1)
    assert failure_probability(HapticTag(static_friction_N=Estimate(20.5, 0.0)), 0.2, ROBOT) == pytest.approx(
        1.0
    )
    unsure = HapticTag(static_friction_N=Estimate(18.0, 2.0), explored=1)
    assert failure_probability(sure, 0.2, ROBOT) == pytest.approx(0.1)
    # P(F > 20) for N(18, 2) is 0.1587.
    assert failure_probability(unsure, 0.2, ROBOT) == pytest.approx(1 - 0.9 * (1 - 0.1587), abs=1e-3)
    assert push_cost(unsure, 0.2, ROBOT).total_s > push_cost(sure, 0.2, ROBOT).total_s


def test_the_tails_are_those_of_counted_draws():
    tag = HapticTag(drift=Estimate(0.05, 0.03, 0.04), rotation_rad_per_m=Estimate(0.2, 0.5))
    rng = np.random.default_rng(0)
    # The counters, the contact that slides to either side, the turn to either side: each ends the push.
    holds = rng.random(200_000) > PushCosts().prior_failures
    holds &= np.abs(rng.normal(0.05, 0.05, 200_000) * 1.5) <= PushCosts().drift_limit_m
    holds &= np.abs(rng.normal(0.2, 0.5, 200_000) * 1.5) <= PushCosts().rotation_limit_rad
    # 200,000 draws: three standard deviations are 0.003.
    assert failure_probability(tag, 1.5, ROBOT) == pytest.approx(1.0 - holds.mean(), abs=3.5e-3)


@given(st.floats(-0.3, 0.3), st.floats(0.0, 0.2), st.integers(0, 9), st.integers(0, 9), st.floats(0.0, 2.0))
def test_failure_is_a_probability_that_grows_with_length_and_failures(drift, sigma, explored, failed, length):
    def tag(failures):
        return HapticTag(drift=Estimate(drift, sigma), explored=explored + failures, failed=failures)

    here = failure_probability(tag(failed), length, ROBOT)
    assert 0.0 <= here <= 1.0
    assert failure_probability(tag(failed), length + 0.5, ROBOT) >= here - 1e-12
    assert failure_probability(tag(failed + 1), length, ROBOT) >= here - 1e-12


def test_what_is_fixed_or_falls_fails_and_what_is_known_well_does_not():
    assert failure_probability(HapticTag(fixed=True), 0.1, ROBOT) == 1.0
    assert failure_probability(HapticTag(falls=True), 0.1, ROBOT) == 1.0
    stool = HapticTag(drift=Estimate(0.03, 0.01), rotation_rad_per_m=Estimate(0.0, 0.1), explored=1)
    # What is left is the prior of the counters, 0.2 / 2.
    assert failure_probability(stool, 0.6, ROBOT) == pytest.approx(0.1, abs=0.01)
    assert failure_probability(None, 0.6, ROBOT) > failure_probability(stool, 0.6, ROBOT)
    with pytest.raises(InputError, match="length"):
        failure_probability(stool, -1.0, ROBOT)


@given(
    force=st.floats(0, 20),
    drift=st.floats(-0.3, 0.3),
    sigma=st.floats(0, 3),
    explored=st.integers(0, 9),
    failed=st.integers(0, 9),
    length_m=st.floats(0.01, 2.0),
)
def test_costs_are_sound_for_any_tag(force, drift, sigma, explored, failed, length_m):
    tag = HapticTag(
        static_friction_N=Estimate(force, sigma),
        drift=Estimate(drift, 0.01 * sigma),
        explored=explored,
        failed=failed,
    )
    cost = push_cost(tag, length_m, ROBOT)
    assert 0.0 <= cost.failure_probability <= 1.0
    if math.isfinite(cost.total_s):
        assert cost.total_s >= ROBOT.setup_time_s + length_m / ROBOT.v_push_m_s - 1e-9
        assert cost.push_s <= length_m / (PushCosts().min_speed_fraction * ROBOT.v_push_m_s) + 1e-9
        assert push_cost(tag, 0.5 * length_m, ROBOT).total_s <= cost.total_s + 1e-9
    else:
        assert abs(drift) * length_m > PushCosts().drift_limit_m * (1 - 1e-9)
