"""A slice of the study of 700 bottles."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.completion import blown_up, spearman_ceiling, study, study_rows, touches_to_tenth


def test_a_slice_of_the_study():
    found = study(1, seed=5, touches=4)
    assert len(found["mean_mse_m2"]["planned"]) == 5
    assert not found["blown_up"]
    assert found["mean_ratio"]["planned"][-1] < 1
    assert {row["name"] for row in study_rows(found, "")} >= {"whole exploration step"}


def test_the_measures_of_the_study():
    assert touches_to_tenth([1.0, 0.5, 0.1, 0.2]) == 2
    assert np.isinf(touches_to_tenth([1.0, 0.5]))
    assert blown_up([1e-5, 1e-6, 2.1e-5])
    assert not blown_up([1e-5, 9e-6, 1e-6])


@pytest.mark.parametrize("factor", [1.5, 3.0, 30.0])
def test_a_true_declaration_has_no_larger_rank_correlation_than_its_deviations_differ(factor):
    """Two halves: a point of the second has the larger error with probability P = 2 / pi arctan(factor)."""
    sigma_m = np.repeat([0.001, 0.001 * factor], 2000)
    expected = np.sqrt(3) * (2 / np.pi * np.arctan(factor) - 0.5)
    assert spearman_ceiling(sigma_m, 0) == pytest.approx(expected, abs=0.01)
