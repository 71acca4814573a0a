"""Constants of the prior of walls: what the campaign prints, and that its fit is right."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.grasp_walls import grasped, most_probable

from visuohaptic.grasping.feasibility import UNSTATED_SIGMA
from visuohaptic.recognition.touch.refinement import CLASS, OUTLINE


def test_the_constants_are_the_most_probable_ones_of_the_campaign() -> None:
    """Printed by ``benchmarks.grasp_walls --fit --count 24``, and with ``--oval``: within a fifth, of which half is rounding."""
    np.testing.assert_allclose(OUTLINE, (0.178, 0.230, 0.0100), rtol=0.1)
    np.testing.assert_allclose(CLASS, (0.548, 0.246, 0.0053), rtol=0.1)
    assert np.hypot(*CLASS[:2]) == pytest.approx(UNSTATED_SIGMA)


def test_the_fit_finds_the_constants_of_drawn_walls() -> None:
    rng, z = np.random.default_rng(0), np.linspace(0.02, 0.17, 40)
    near = 0.25**2 * np.exp(-0.5 * ((z[:, None] - z) / 0.008) ** 2) + 0.02**2 * np.eye(40)
    shape = np.linalg.cholesky(np.kron(np.eye(2), near) + 0.5**2)
    drawn = [(z, (shape @ rng.standard_normal(80)).reshape(2, 40), np.zeros((2, 40))) for _ in range(40)]
    common, local, reach_m = most_probable(drawn, CLASS)
    # 40 common parts, and about 500 independent local ones: 0.11 and 0.03.
    assert common == pytest.approx(0.5, rel=0.3)
    assert local == pytest.approx(0.25, rel=0.1)
    assert reach_m == pytest.approx(0.008, rel=0.1)


def test_a_grasp_is_compared_with_the_wall_it_was_planned_for() -> None:
    """One container: the expected deformation is that of the true wall within four of its standard deviations."""
    row = grasped(0)
    assert row is not None
    off = np.log(row["expected_m"] / row["true_m"]) / (row["sigma_m"] / row["expected_m"])
    assert abs(off) < 4
