"""A slice of the study of 700 bottles."""

from __future__ import annotations

import numpy as np
from benchmarks.completion import blown_up, study, study_rows, touches_to_tenth


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
