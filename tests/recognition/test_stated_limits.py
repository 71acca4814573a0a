"""What the constants of recognition are said to be, computed by other means."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm

from visuohaptic.deformation.shapes import class_names, draw_variants, load_container
from visuohaptic.deformation.shapes.variants import container_outline
from visuohaptic.deformation.shells.fourier_shell import RevolutionShell, pinch_stiffness
from visuohaptic.deformation.shells.shell_material import MATERIALS, IsotropicMaterial
from visuohaptic.recognition.data import compressions, readings
from visuohaptic.recognition.data.spikes import without_spikes
from visuohaptic.recognition.touch import (
    ModelSettings,
    _round_body,
    belief,
    calibration,
    contents,
    few_curves,
    haptic_model,
    steps,
    unknown_class,
)
from visuohaptic.recognition.touch.unknown_class import posterior_with_unknown
from visuohaptic.recognition.trees import tree_growth
from visuohaptic.recognition.visual import visual_words


def test_a_width_has_the_noise_of_two_tips() -> None:
    """A tenth of a millimetre each, on a container of 6 cm."""
    noise = np.random.default_rng(1).normal(0.0, 1e-4, (50_000, 2)).sum(axis=1) / 0.06
    assert pytest.approx(noise.var(), rel=0.1) == belief.WIDTH_VARIANCE


def test_a_scale_shows_tenths_of_a_gram() -> None:
    mass = np.random.default_rng(1).uniform(0.01, 0.05, 50_000)
    assert compressions._MASS_SIGMA_kg == pytest.approx((np.round(mass, 4) - mass).std(), rel=0.03)


def test_objects_beyond_the_trained_ranges_widen_them_by_a_half() -> None:
    """Every fourth parameter is up to three tenths of the range outside of it, on either side."""
    rng = np.random.default_rng(1)
    inside, beyond = rng.uniform(-0.5, 0.5, 400_000), rng.uniform(0.5, 0.8, 400_000)
    found = math.sqrt(0.75 * np.mean(inside**2) + 0.25 * np.mean(beyond**2))
    assert pytest.approx(found / math.sqrt(np.mean(inside**2)), rel=0.02) == haptic_model.RANGE_WIDENING


def test_a_simulated_stiffness_is_wrong_by_modulus_and_thickness() -> None:
    """k is proportional to E t^2, each known to a tenth; the part by place is that of the thickness alone."""
    rng = np.random.default_rng(1)
    modulus, thickness = rng.normal(1.0, 0.1, (2, 100_000))
    level = float(np.log(np.maximum(modulus * thickness**2, 0.05)).std())
    assert few_curves.SIMULATION_SIGMAS[0] == pytest.approx(level, rel=0.08)


def test_water_and_packings_have_their_densities() -> None:
    """Random packings of grains fill 0.56 to 0.64 of their space, and these grains have 1,100 to 1,500 kg/m^3."""
    liquid, grain = _round_body.FILLINGS["liquid"], _round_body.FILLINGS["grain"]
    assert (liquid.kg_per_m3, liquid.solid) == pytest.approx((1000.0, 1.0), rel=0.005)
    assert 0.56 <= grain.solid <= 0.64
    assert 1100.0 < grain.kg_per_m3 / grain.solid < 1500.0
    low, high = grain.kg_per_m3 * np.exp(norm.ppf([0.05, 0.95]) * grain.sigma)
    assert (low, high) == pytest.approx((500.0, 900.0), rel=0.2)


def test_bottles_are_of_the_material_of_the_library() -> None:
    density = MATERIALS["PET"].density_kg_per_m3
    assert density is not None
    assert pytest.approx(density.value, abs=2.0 * density.sigma) == _round_body.PET_DENSITY


def test_seven_of_eight_ovals_are_less_than_twice_as_wide_as_deep() -> None:
    beyond = 2.0 * norm.sf(math.log(2.0) / unknown_class.OVAL_SIGMA)
    assert beyond == pytest.approx(1 / 8, rel=0.06)


def test_a_membrane_resists_with_the_cube_of_its_deformation() -> None:
    """A string of two halves of unit length that is pulled aside: its tension is its strain."""
    d = np.array([1e-3, 2e-3])
    length = np.hypot(1.0, d)
    force = 2.0 * (length - 1.0) * d / length
    assert math.log2(force[1] / force[0]) == pytest.approx(readings.MEMBRANE, abs=0.01)


def test_trees_and_planner_share_the_error_of_a_simulated_stiffness() -> None:
    assert pytest.approx(ModelSettings().discrepancy) == tree_growth._DISCREPANCY


def test_the_root_of_a_half_fills_a_byte() -> None:
    assert pytest.approx(255.0) == 0.5 * visual_words._BYTE_STEPS


def test_a_nuisance_is_contradicted_by_chance_once_in_twenty_explorations() -> None:
    assert 2.0 * norm.sf(steps._CONTRADICTION_SIGMAS) == pytest.approx(1 / 20, rel=0.15)


def test_a_container_is_empty_or_has_a_filling() -> None:
    assert sum(contents.PRIOR.values()) == pytest.approx(1.0)


def test_a_wall_of_uneven_thickness_differs_by_place_with_its_square() -> None:
    """1.5 % of the thickness; k is proportional to E t^2."""
    thickness = np.random.default_rng(1).normal(1.0, 0.015, 50_000)
    assert pytest.approx(np.log(thickness**2).std(), rel=0.03) == few_curves.PLACE_SIGMA


def test_a_finger_meets_the_radius_of_its_height_on_a_wall_that_widens() -> None:
    """3 mm of height, on a wall that widens by a sixth of it."""
    below, above = 0.03 + (0.06 + np.array([0.0, 0.003])) / 6.0
    assert above - below == pytest.approx(_round_body.RADIUS_M, rel=0.01)


def test_a_container_without_a_width_is_as_wide_as_the_shipped_ones() -> None:
    members = [one for name in class_names() for one in draw_variants(load_container(name), 6, 0)]
    wide_m = np.mean([2.0 * container_outline(one)[:, 0].mean() for one in members])
    assert pytest.approx(wide_m, rel=0.1) == few_curves._USUAL_WIDTH_m


def test_a_gripper_is_tilted_by_three_degrees() -> None:
    assert math.radians(3.0) == pytest.approx(ModelSettings().tilt_rad, rel=0.06)


def test_a_class_has_as_many_parameters_as_the_shipped_ones() -> None:
    """Numbers of a description that differ between its members; both ends of a range are the same in each."""

    def numbers(part: Any) -> list[float]:
        values = part.values() if isinstance(part, dict) else part if isinstance(part, list | tuple) else ()
        return [float(part)] if isinstance(part, float) else [x for value in values for x in numbers(value)]

    found = []
    for name in class_names():
        table = np.array([numbers(one.model_dump()) for one in draw_variants(load_container(name), 6, 0)])
        found.append(0.5 * np.count_nonzero(np.ptp(table, axis=0) > 1e-9))
    assert np.mean(found) == pytest.approx(haptic_model.PARAMETERS, rel=0.1)


def test_a_squeeze_resists_with_this_power_of_the_wall() -> None:
    """Half-way up a bottle with a held mouth, by Fourier series."""
    z_m, wall_m = np.linspace(0.0, 0.2, 65), 3e-4 * np.array([0.9, 1.1])
    material = IsotropicMaterial(2.35e9, 0.38)
    force = [
        pinch_stiffness(RevolutionShell(np.full(65, 0.033), z_m, np.full(65, t), rim_held=True), material, harmonics=40)[30]
        for t in wall_m
    ]  # fmt: skip
    power = math.log(force[1] / force[0]) / math.log(wall_m[1] / wall_m[0])
    assert pytest.approx(power, rel=0.08) == _round_body.WALL_POWER


def test_a_false_alarm_rate_of_one_percent_is_known_to_a_seventh_by_the_simulated_explorations() -> None:
    """Rate beyond the empirical quantile of so many draws: .0100 +- .0015."""
    drawn = np.random.default_rng(1).random((1000, calibration.EXPLORATIONS))
    assert np.quantile(drawn, 0.01, axis=1).std() == pytest.approx(0.0015, rel=0.1)


def test_a_state_that_is_true_is_rejected_once_in_a_thousand() -> None:
    """One piece of evidence of three numbers; the limit is where "none of them" becomes as probable."""
    limit = brentq(
        lambda square: posterior_with_unknown(np.zeros(1), np.array([[square]]), np.array([3]))[1] - 0.5,
        5.0,
        40.0,
    )
    drawn = np.random.default_rng(1).standard_normal((1_500_000, 3))
    assert ((drawn**2).sum(axis=1) > limit).mean() == pytest.approx(1e-3, rel=0.1)


def test_a_curve_loses_a_sample_by_chance_once_in_a_hundred_thousand() -> None:
    """One of nine samples without noise is moved beyond a parabola through the others, by another library's fit."""
    t, d = np.arange(9.0), np.linspace(2e-4, 1.8e-3, 9)
    parabola = np.vander(np.delete(t, 4), 3)
    at = np.array([16.0, 4.0, 1.0])
    sigma_N = 0.1 * math.sqrt(1.0 + at @ np.linalg.inv(parabola.T @ parabola) @ at)
    # Two sides, nine samples, two sensors.
    limit = float(norm.isf(1e-5 / 2 / 9 / 2))
    for factor, spike in ((0.998, False), (1.002, True)):
        f = 3000.0 * d + np.where(t == 4, factor * limit * sigma_N, 0.0)
        kept = without_spikes(np.stack([d, f]), np.array([1e-4, 0.1]), readings.FALSE_ALARM)
        assert kept[4] != spike
        assert kept.sum() == 9 - spike


def test_a_caliper_by_hand_is_two_millimetres_off() -> None:
    assert few_curves.WIDTH_REPEATS[-1] == pytest.approx(0.002 / few_curves._USUAL_WIDTH_m, rel=0.1)
