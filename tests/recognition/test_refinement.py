from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError, StiffnessMap
from visuohaptic.deformation.maps import linear_features
from visuohaptic.deformation.shapes import load_container, mesh_container
from visuohaptic.recognition.touch import combine_models, correct_map, fit_wall


def test_a_wall_is_found_again_where_the_modulus_is_known() -> None:
    cup = load_container("cup").middle()
    thicker = cup.model_copy(update={"wall": tuple(1.15 * value for value in cup.wall)})
    truth = linear_features(mesh_container(thicker, around=16)).values[..., 0]
    measured = np.full((16, 4), np.nan)
    measured[[3, 7, 11], 0] = truth[[3, 7, 11], 0]
    found = fit_wall(cup, measured, np.full((16, 4), 0.02), modulus_spread=0.001, around=16)
    # The prior of 30 % pulls by sigma^2 / (4 * 3 * 0.3^2), far below 1 %.
    assert found.wall_m == pytest.approx(1.15 * cup.wall[0], rel=0.01)
    assert found.chi2_per_measurement < 0.5
    # Three measurements of 2 %, k as t^2.
    assert found.wall_sigma_m / found.wall_m == pytest.approx(0.02 / np.sqrt(3) / 2, rel=0.2)


def test_wall_and_modulus_are_not_told_apart_and_the_covariance_says_so() -> None:
    cup = load_container("cup").middle()
    measured = np.full((16, 4), np.nan)
    measured[7, 0] = 1.2 * linear_features(mesh_container(cup, around=16)).values[7, 0, 0]
    found = fit_wall(cup, measured, np.full((16, 4), 0.02), around=16)
    spread = np.sqrt(np.diag(found.log_covariance))
    assert found.log_covariance[0, 1] / spread.prod() < -0.9
    with pytest.raises(InputError, match="at least one stiffness"):
        fit_wall(cup, np.full((16, 4), np.nan), np.ones((16, 4)))


def test_models_are_combined_as_they_were_mixed() -> None:
    rng = np.random.default_rng(0)
    models = rng.normal(8, 1, (3, 12))
    weights = combine_models(models, 0.3 * models[0] + 0.7 * models[2], np.full(12, 0.1))
    np.testing.assert_allclose(weights, [0.3, 0, 0.7], atol=1e-6)


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
