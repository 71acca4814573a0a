"""Cross sections against closed forms, and the figures 3.4 and (3.10)."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.sensing.foam.material import (
    StressCurve,
    section_height,
    section_material,
    section_stress,
    sensitivity,
)

LINEAR = StressCurve("cubic", np.array([0.0, 0.6]), np.array([5e4, 0.0, 0.0]), np.zeros((3, 3)))


def test_linear_foam_in_a_trapezoid():
    """Slabs in series: strain = N / E * mean of 1 / h = stress / E * ln(1 / front) / (1 - front)."""
    strain, stress = section_stress(LINEAR, "trapezoid")
    front = 0.5
    expected = stress / 5e4 * np.log(1 / front) / (1 - front)
    np.testing.assert_allclose(strain, expected, rtol=1e-4, atol=1e-9)  # midpoint rule of 200 slabs
    assert stress[-1] == pytest.approx(front * 3e4)  # the front is at the end of its calibration


def test_rectangle_is_the_base_foam(material):
    strain, stress = section_stress(material.loading, "rectangle")
    np.testing.assert_allclose(stress, material.stress(strain), rtol=1e-4, atol=1)
    assert section_material(material, "rectangle").loading is material.loading


def test_shapes():
    y = np.array([0.0, 0.5, 1.0])
    np.testing.assert_allclose(section_height("trapezoid", y), [1, 0.75, 0.5])
    assert section_height("triangle", y)[2] < 0.05
    with pytest.raises(InputError, match="expected one of rectangle, triangle, trapezoid"):
        section_height("circle", y)


def test_sensitivity_curves_have_the_shape_of_figure_3_4(material):
    rods = {name: section_material(material, name) for name in ("rectangle", "trapezoid", "triangle")}
    start = {name: float(sensitivity(rod, np.array(0.0))) for name, rod in rods.items()}
    # "the barrier at zero strain is significantly reduced" for the trapezoid, and most for the triangle
    assert start["triangle"] < 0.4 * start["rectangle"]
    assert start["trapezoid"] < 0.85 * start["rectangle"]
    # "an almost constant low pressure derivative for low and mid-range strains"
    middle = sensitivity(rods["triangle"], np.linspace(0.05, 0.4, 20))
    assert middle.max() < 1.6 * middle.min()
    # "the overall level is lower for both, compared to the rectangle"
    for name in ("trapezoid", "triangle"):
        assert rods[name].stress(np.array(0.3)) < material.stress(np.array(0.3))
    # The triangle has "no strong increase for high strains"
    assert sensitivity(rods["triangle"], np.array(0.5)) < 0.6 * sensitivity(material, np.array(0.5))


def test_sensitivity_is_3_9(material):
    expected = 0.3 / (1800 * np.sin(np.radians(70))) * material.slope(np.array(0.2)) / 0.02
    assert sensitivity(material, np.array(0.2)) == pytest.approx(expected)
    # Finite difference: one pixel more, (3.8) with d(delta) = d / (f sin gamma).
    pixel_m = 0.3 / (1800 * np.sin(np.radians(70)))
    rise = material.stress(np.array(0.2 + 0.5 * pixel_m / 0.02)) - material.stress(
        np.array(0.2 - 0.5 * pixel_m / 0.02)
    )
    assert sensitivity(material, np.array(0.2)) == pytest.approx(float(rise), rel=1e-3)


def test_covariance_of_a_rod_follows_the_foam(reference_law, make_log):
    """Linearised covariance against refitting rods of noisy foams."""
    from visuohaptic.sensing.foam.material import calibrate_foam

    rng = np.random.default_rng(3)
    values, sigmas = [], []
    for _ in range(40):
        log = make_log(reference_law.stress, runs=4, noise_Pa=120, rng=rng)
        rod = section_material(calibrate_foam(log, width_m=0.02, height_m=0.01).material, "trapezoid")
        values.append(rod.stress(np.array(0.25)))
        sigmas.append(rod.loading.stress_sigma(np.array(0.25)))
    # 40 trials: 11 %; three of it.
    assert 0.6 < np.mean(sigmas) / np.std(values) < 1.6
