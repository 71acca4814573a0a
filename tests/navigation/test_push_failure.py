"""Probabilities of failure: limits, monotone, against counting."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from visuohaptic.errors import InputError
from visuohaptic.navigation.push_failure import PushDoubt, push_failure_probability, simulated_failure
from visuohaptic.navigation.push_model import PushModel
from visuohaptic.navigation.quasi_static import line_path
from visuohaptic.objects import Estimate, HapticTag

BOX = 0.15 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def test_the_tail_is_that_of_counted_draws():
    tag = HapticTag(drift=Estimate(0.05, 0.03, 0.04), rotation_rad_per_m=Estimate(0.0, 1e-6))
    rng = np.random.default_rng(0)
    drawn = rng.normal(0.05, 0.05, 200_000) * 1.5
    # 200,000 draws: three standard deviations are 0.003; unexplored, the prior is all there is.
    assert push_failure_probability(tag, 1.5) == pytest.approx((np.abs(drawn) > 0.12).mean(), abs=3e-3)


@given(st.floats(-0.3, 0.3), st.floats(0.0, 0.2), st.integers(0, 9), st.integers(0, 9), st.floats(0.0, 2.0))
def test_it_is_a_probability_that_grows_with_length_and_failures(drift, sigma, explored, failed, length):
    def tag(failures):
        return HapticTag(drift=Estimate(drift, sigma), explored=explored + failures, failed=failures)

    here = push_failure_probability(tag(failed), length)
    assert 0.0 <= here <= 1.0
    assert push_failure_probability(tag(failed), length + 0.5) >= here - 1e-12
    assert push_failure_probability(tag(failed + 1), length) >= here - 1e-12


def test_what_is_fixed_or_falls_fails_and_what_is_known_well_does_not():
    assert push_failure_probability(HapticTag(fixed=True), 0.1) == 1.0
    assert push_failure_probability(HapticTag(falls=True), 0.1) == 1.0
    stool = HapticTag(drift=Estimate(0.03, 0.01), rotation_rad_per_m=Estimate(0.0, 0.1), explored=1)
    assert push_failure_probability(stool, 0.6) < 0.01
    assert push_failure_probability(None, 0.6) > push_failure_probability(stool, 0.6)
    with pytest.raises(InputError, match="length"):
        push_failure_probability(stool, -1.0)


def test_a_short_push_of_a_box_holds_and_one_beside_its_centre_does_not():
    model, rng = PushModel.patch(BOX, 0.3), np.random.default_rng(1)

    def failure(aside):
        path = line_path(np.array([0.0, aside]), np.array([0.5, aside]))
        return simulated_failure(model, (0.33, 0.0, 0.0), path, 0.17, rng, doubt=PushDoubt(), samples=40)

    assert failure(0.0) < 0.3
    assert failure(0.1) > 0.8
