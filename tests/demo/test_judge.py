"""Evaluation rules: correctness, confidence of a claim, and outcome of a run."""

from __future__ import annotations

import math

import numpy as np
import pytest
from benchmarks._forecasts import expected_calibration_error

from visuohaptic.demo.judge import Claim, RunOutcome


def test_a_number_is_right_within_what_its_use_allows_whatever_was_declared():
    for sigma in (1e-6, 10.0):
        assert Claim("friction", "box", 5.4, 5.0, sigma=sigma).correct
        assert not Claim("friction", "box", 5.6, 5.0, sigma=sigma).correct
    assert Claim("friction", "bin", 0.3, 0.22, sigma=0.1).correct  # a tenth of a newton at least
    assert not Claim("fill", "bottle", 0.5, 0.7, sigma=1.0).correct


def test_a_forecast_is_how_often_a_gaussian_error_is_allowed():
    rng = np.random.default_rng(0)
    for sigma in (0.05, 0.15, 0.6):
        # 20000 draws: a standard error of at most 0.0036.
        often = np.mean(np.abs(sigma * rng.standard_normal(20000)) <= 0.15)
        assert Claim("fill", "bottle", 0.5, 0.5, sigma=sigma).forecast == pytest.approx(often, abs=0.015)
        aside = sigma * rng.standard_normal((20000, 2))
        often = np.mean(np.hypot(*aside.T) <= 0.10)
        place = Claim("place", "table", (1.0, 2.0), (1.0, 2.0), sigma=sigma)
        assert place.forecast == pytest.approx(often, abs=0.015)
    assert Claim("lid", "bottle", "open", "closed", probability=0.7).forecast == pytest.approx(0.7)
    assert Claim("grip", "bottle", True, False).forecast == pytest.approx(1.0)  # said without reserve


def test_a_run_is_complete_honest_or_wrong():
    good, bad = (Claim("lid", "bottle", "open", truth, probability=0.99) for truth in ("open", "closed"))
    assert RunOutcome.of([good], True) is RunOutcome.COMPLETE
    assert RunOutcome.of([good], False) is RunOutcome.HONEST_FAILURE
    assert RunOutcome.of([good, bad], False) is RunOutcome.WRONG
    assert bad.confidently_wrong
    assert not Claim("lid", "bottle", "open", "closed", probability=0.9).confidently_wrong


def test_a_claim_that_is_not_sure_is_a_claim():
    unsure = Claim("friction", "bin", 1.5, 1.3, sigma=0.19)
    assert not unsure.correct
    assert unsure.forecast == pytest.approx(0.57, abs=0.01)
    assert RunOutcome.of([unsure], True) is RunOutcome.WRONG


def test_calibration_is_zero_for_true_forecasts_and_the_gap_for_boasts():
    rng = np.random.default_rng(1)
    p = rng.uniform(0.0, 1.0, 20000)
    honest = list(zip(p, rng.random(20000) < p, strict=True))
    # Bins of 100 draws and more: a standard error of 0.05 at most, weighted by their number.
    assert expected_calibration_error(honest) < 0.02
    boast = [(0.99, bool(good)) for good in rng.random(20000) < 0.7]
    assert expected_calibration_error(boast) == pytest.approx(0.29, abs=0.02)
    assert math.isnan(expected_calibration_error([]))
