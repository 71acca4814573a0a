from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError, StiffnessMap
from visuohaptic.recognition.touch import correct_map


def test_a_corrected_map_is_right_where_it_was_touched_and_doubtful_elsewhere() -> None:
    z = np.linspace(0, 0.2, 81)
    points = np.stack([0 * z, 0 * z, z], axis=1)
    simulated = np.full(81, 1000.0)
    found = StiffnessMap(points, np.array([[0, 1, 2]]), simulated, 200 + 0 * z)
    new = correct_map(found, points[[20, 60]], np.array([1300.0, 1000.0]), np.full(2, 0.01))
    assert new.stiffness_N_per_m[20] == pytest.approx(1300, rel=0.02)
    assert new.stiffness_N_per_m[60] == pytest.approx(1000, rel=0.02)
    relative = new.stiffness_sigma_N_per_m / new.stiffness_N_per_m
    assert relative[20] < 0.015
    assert relative[[0, 40, 80]].min() > 2 * relative[20]
    # All of it by one common factor: no place keeps its old value.
    both = correct_map(found, points[[20, 60]], np.array([1300.0, 1300.0]), np.full(2, 0.01))
    assert (both.stiffness_N_per_m > 1200).all()


def test_the_deviation_of_a_corrected_map_is_that_of_its_two_parts() -> None:
    """A common factor of 20 % and a local one of 10 % over 4 cm, conditioned on one exact measurement, in closed form."""
    z = np.array([0.0, 0.04, 1.0])
    points = np.stack([0 * z, 0 * z, z], axis=1)
    found = StiffnessMap(points, np.array([[0, 1, 2]]), np.full(3, 1000.0), np.full(3, 200.0))
    new = correct_map(found, points[:1], np.array([1300.0]), np.array([1e-6]))
    shared = 0.2**2 + 0.1**2 * np.exp([0.0, -0.5, -np.inf])
    whole = 0.2**2 + 0.1**2
    np.testing.assert_allclose(new.stiffness_N_per_m, 1000 * 1.3 ** (shared / whole), rtol=1e-4)
    sigma = np.sqrt(np.maximum(whole - shared**2 / whole, 0.0))
    relative = new.stiffness_sigma_N_per_m / new.stiffness_N_per_m
    np.testing.assert_allclose(relative, sigma, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(("stiffness", "sigma"), [(0.0, 0.1), (1300.0, 0.0)])
def test_measurements_of_no_stiffness_and_without_error_are_refused(stiffness: float, sigma: float) -> None:
    points = np.eye(3)
    found = StiffnessMap(points, np.array([[0, 1, 2]]), np.full(3, 1000.0), np.full(3, 200.0))
    with pytest.raises(InputError, match="above 0"):
        correct_map(found, points[:1], np.array([stiffness]), np.array([sigma]))
