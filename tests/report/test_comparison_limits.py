"""Intervals of a comparison hold as many errors as they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from visuohaptic.report.comparison import ForceRecord, compare_forces


def _record(name: str, force_N: np.ndarray, sigma_N: float) -> ForceRecord:
    count = len(force_N)
    return ForceRecord(name, 0.1 * np.arange(count), force_N, np.full(count, sigma_N), np.ones(count, bool))


def test_nine_of_ten_normal_errors_are_in_the_interval_and_a_gain_is_told_beyond_one_in_a_thousand() -> None:
    errors = ndtri((np.arange(1000) + 0.5) / 1000)
    truth = np.tile([2.0, 3.0], 500)
    found = compare_forces(
        _record("run", truth + 0.1 * errors, 0.1), _record("scale", truth, 1e-6), offset_s=0.0
    )
    assert abs(found.coverage_90 - 0.9) <= 0.002
    for probability, told in ((1.1e-3, False), (0.9e-3, True)):
        off = -float(ndtri(0.5 * probability))
        lines = replace(found, gain=1.0 + 0.05 * off, gain_sigma=0.05).lines()
        assert any("calibrate again" in line for line in lines) == told
