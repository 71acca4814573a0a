"""Calibration: the right curve from good data, an error with its reason from bad data."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from visuohaptic.core import CalibrationError
from visuohaptic.sensing.foam.material import (
    StrainStress,
    StressCurve,
    calibrate_foam,
    fit_curve,
    plateau,
    read_strain_stress,
)
from visuohaptic.sensing.foam.material.records import direction_from_order

SIZE = {"width_m": 0.02, "height_m": 0.01}


def data_of(strain, stress):
    return StrainStress(
        np.asarray(strain, float), np.asarray(stress, float), np.ones(len(strain), dtype=np.int64)
    )


def test_noise_free_table_is_met_everywhere(calibration, reference_law):
    strain = np.linspace(0, 0.6, 500)
    # Between the 61 points of the table, too: 0.1 % of the highest stress (16 kPa).
    np.testing.assert_allclose(calibration.material.stress(strain), reference_law.stress(strain), atol=16)
    assert calibration.residual_spline_Pa < 5 < 100 < calibration.residual_cubic_Pa
    assert calibration.material.stress(np.array(0.0)) == 0.0


def test_plateau_is_that_of_the_dissertation(material):
    # Sec. 3.2 works in [0.1, 0.5]; this foam was made after its figure.
    np.testing.assert_allclose(material.working_strain, (0.1, 0.5), atol=0.02)
    assert 0.5 < material.densification_strain <= 0.6


def test_declared_sigma_matches_the_scatter_of_repeated_calibrations(reference_law, make_log):
    rng = np.random.default_rng(7)
    at = np.array([0.05, 0.15, 0.3, 0.45])
    found, declared = [], []
    for _ in range(60):
        data = make_log(reference_law.stress, runs=4, noise_Pa=150, rng=rng)
        fit = fit_curve(*data.loading)
        found.append(fit.curve.stress(at))
        declared.append(fit.curve.stress_sigma(at))
    error = np.sqrt(np.mean((np.array(found) - reference_law.stress(at)) ** 2, axis=0))
    ratio = np.mean(declared, axis=0) / error
    # 60 trials give the scatter to 9 %; choosing the knots adds a little bias that the covariance can't see.
    assert np.all(ratio > 0.65), ratio
    assert np.all(ratio < 1.4), ratio


def test_cubic_recovers_its_own_coefficients_and_covariance():
    truth = np.array([4e4, -1e5, 1.1e5])
    rng = np.random.default_rng(3)
    strain = np.tile(np.linspace(0, 0.6, 40), 5)
    design = np.stack([strain, strain**2, strain**3], axis=1)
    fit = fit_curve(strain, design @ truth + rng.normal(0, 50, strain.size), kind="cubic")
    exact = 50**2 * np.linalg.inv(design.T @ design)
    z = (fit.curve.parameters - truth) / np.sqrt(np.diag(exact))
    assert np.all(np.abs(z) < 4)
    # Residual variance of 197 degrees of freedom: 10 % (1 sigma); the inflation adds at most as much.
    np.testing.assert_allclose(np.diag(fit.curve.covariance), np.diag(exact), rtol=0.5)


def test_declared_sigma_holds_for_noise_whose_neighbours_are_alike():
    """A cubic through the origin is linear in its parameters: 300 fits scatter as its covariance says, also where
    each error keeps a part of the one before. Four times the variance of independent errors."""
    rng, correlation = np.random.default_rng(9), 0.6
    truth, strain = np.array([4e4, -1e5, 1.1e5]), np.linspace(0.003, 0.6, 200)
    clean, at = strain[:, None] ** [1, 2, 3] @ truth, np.array([0.1, 0.3, 0.5])
    found, declared = [], []
    for _ in range(300):
        error = rng.normal(0, 50, strain.size)
        for k in range(1, strain.size):
            error[k] = correlation * error[k - 1] + np.sqrt(1 - correlation**2) * error[k]
        curve = fit_curve(strain, clean + error, kind="cubic").curve
        found.append(curve.stress(at))
        declared.append(curve.stress_sigma(at))
    # The scatter of 300 is known to 4 %; the correlation of 200 residuals to .06, which is 9 % of the deviation.
    np.testing.assert_allclose(np.mean(declared, axis=0) / np.std(found, axis=0), 1.0, atol=0.15)


def test_curve_is_monotone_whatever_the_noise(reference_law, make_log):
    rng = np.random.default_rng(5)
    for _ in range(20):
        fit = fit_curve(*make_log(reference_law.stress, noise_Pa=800, rng=rng).loading)
        assert fit.curve.minimum_slope()[1] > 0


def test_slope_and_basis_against_finite_differences(material):
    strain, step = np.linspace(0.01, 0.7, 40), 1e-7
    difference = (material.stress(strain + step) - material.stress(strain - step)) / (2 * step)
    np.testing.assert_allclose(material.slope(strain), difference, rtol=1e-5)
    curve = material.loading
    np.testing.assert_allclose(curve.basis(strain) @ curve.parameters, curve.stress(strain), rtol=1e-10)


def test_unloading_is_split_and_fitted(reference_law):
    up = np.linspace(0, 0.6, 80)
    down = up[::-1]
    law = reference_law.stress
    back = law(down) * (0.5 + 0.5 * (down / 0.6) ** 3)
    # Without directions: the order of the strains tells them.
    strain = np.concatenate([up, down, up, down])
    stress = np.concatenate([law(up), back, law(up), back])
    direction = direction_from_order(strain)
    assert np.count_nonzero(direction < 0) == pytest.approx(160, abs=4)
    found = calibrate_foam(StrainStress(strain, stress, direction), **SIZE)
    loss = 1 - np.trapezoid(back[::-1], up) / np.trapezoid(law(up), up)
    assert found.hysteresis_loss == pytest.approx(loss, abs=0.005)
    np.testing.assert_allclose(found.material.unloading.stress(down), back, atol=0.01 * law(0.6))


def repeated(law, gains, rng, noise_Pa=20.0):
    """One record of several presses up to a strain of 0.5 and back, each with its own gain."""
    up = np.linspace(0, 0.5, 51)
    path = np.concatenate([up, up[-2::-1]])
    direction = np.repeat([1, -1], [51, 50])
    back = np.where(direction > 0, 1.0, 0.8)
    stress = np.concatenate([gain * back * law(path) for gain in gains])
    stress += noise_Pa * rng.standard_normal(len(stress))
    return StrainStress(np.tile(path, len(gains)), stress, np.tile(direction, len(gains)))


@pytest.mark.parametrize("presses", [2, 4])
def test_the_next_press_scatters_as_the_calibrating_ones(reference_law, presses):
    rng, at = np.random.default_rng(presses), np.array([0.1, 0.25, 0.4])
    inside, trials = 0, 50
    for _ in range(trials):
        gains = np.exp(rng.normal(0, 0.03, presses + 1))
        found = calibrate_foam(repeated(reference_law.stress, gains[:-1], rng), **SIZE)
        assert found.presses == presses
        loading = found.material.loading
        z = (loading.stress(at) - gains[-1] * reference_law.stress(at)) / loading.stress_sigma(at)
        inside += float(np.mean(np.abs(z) < 1))
    # 68 % of 50, with a binomial scatter of 3.3 and a common gain at all strains; a single press has a sigma of 0.1 %.
    assert 25 <= inside <= 43


def test_equal_presses_are_known_as_their_noise_tells(reference_law):
    rng = np.random.default_rng(5)
    together = calibrate_foam(repeated(reference_law.stress, [1.0, 1.0, 1.0], rng), **SIZE)
    alone = calibrate_foam(repeated(reference_law.stress, [1.0], rng), **SIZE)
    assert (together.presses, alone.presses) == (3, 1)
    assert np.isnan(alone.press_sigma)
    # 51 points of 20 Pa tell the gain of a press of about 10 kPa to 0.03 %.
    assert together.press_sigma < 1e-3


def test_presses_of_different_speed_are_no_outliers_and_share_their_unloading(reference_law):
    rng = np.random.default_rng(6)
    found = calibrate_foam(repeated(reference_law.stress, [0.94, 1.06], rng), **SIZE)
    # Two gains 12 % apart: each is 8.5 % of one standard deviation from the next, by Student's distribution 1.84 times more.
    assert found.press_sigma == pytest.approx(1.84 * 0.12 / np.sqrt(2) * np.sqrt(1.5), rel=0.02)
    assert found.residual_spline_Pa == pytest.approx(20.0, rel=0.5)
    assert found.hysteresis_loss == pytest.approx(0.2, abs=0.01)
    up = np.linspace(0.05, 0.45, 9)
    np.testing.assert_allclose(found.material.unloading.stress(up), 0.8 * reference_law.stress(up), rtol=0.02)


def released(law, presses, noise_Pa=20.0):
    """One record of presses that turn at the given strains, each with its own gain."""
    strain, stress = [np.zeros(1)], [np.zeros(1)]
    for gain, turns in presses:
        for begin, end in pairwise([0.0, *turns]):
            part = np.linspace(begin, end, 1 + round(abs(end - begin) / 0.01))[1:]
            strain.append(part)
            stress.append(gain * (1.0 if end > begin else 0.8) * law(part))
    path = np.concatenate(strain)
    noise = noise_Pa * np.random.default_rng(7).standard_normal(len(path))
    return StrainStress(path, np.concatenate(stress) + noise, direction_from_order(path))


def test_a_short_release_is_no_press_and_hides_none(reference_law):
    once = [0.06, 0.02, 0.35, 0.2, 0.5, 0.0]
    alone = calibrate_foam(released(reference_law.stress, [(1.0, once)]), **SIZE)
    assert alone.presses == 1
    ended = [(0.97, [0.2, 0.0]), (0.97, once), (1.0, once), (1.03, once), (1.03, [0.2, 0.0])]
    found = calibrate_foam(released(reference_law.stress, ended), **SIZE)
    assert found.presses == 3
    # Three gains with a standard deviation of 3 %, by Student's distribution 1.32 times more.
    assert found.press_sigma == pytest.approx(1.32 * 0.03 * np.sqrt(4 / 3), rel=0.05)


def test_gains_over_different_parts_of_the_curve_are_not_compared():
    strain = np.concatenate([GOOD, GOOD[15:], GOOD])
    gain = np.repeat([1.0, 1.05, 0.95], [61, 46, 61])
    assert calibrate_foam(data_of(strain, gain * law(strain)), **SIZE).presses == 1


def test_a_press_without_stress_is_refused():
    stress = np.concatenate([law(GOOD), 0 * GOOD])
    with pytest.raises(CalibrationError, match="does not rise in press 2 of 2"):
        calibrate_foam(data_of(np.tile(GOOD, 2), stress), **SIZE)


def test_presses_in_different_units_are_refused():
    """A sigma of three times the stress would only be printed."""
    stress = np.concatenate([law(GOOD), 1e-3 * law(GOOD)])
    with pytest.raises(CalibrationError, match="2 presses differ by a factor of 1e\\+03"):
        calibrate_foam(data_of(np.tile(GOOD, 2), stress), **SIZE)


GOOD = np.linspace(0, 0.6, 61)


def law(strain):
    return 9e3 * np.tanh(8 * strain) + 4e3 * strain + 3e4 * strain**4


@pytest.mark.parametrize(
    ("strain", "stress", "message"),
    [
        (GOOD, law(GOOD) - 6e3 * np.exp(-(((GOOD - 0.35) / 0.1) ** 2)), "the stress falls by"),
        (GOOD, 3e3 * np.sin(GOOD / 0.6 * np.pi) + 1e3 * GOOD, "the stress falls by"),
        (GOOD[:8], law(GOOD[:8]), "found 8 different strains of loading, expected 12 or more"),
        (
            np.linspace(0, 0.6, 11),
            law(np.linspace(0, 0.6, 11)),
            "found 11 different strains of loading, expected 12",
        ),
        (GOOD / 3, law(GOOD / 3), "found strains 0.00 to 0.20"),
        (GOOD[20:], law(GOOD[20:]), "found strains 0.20 to 0.60"),
        (GOOD, np.where(GOOD[5] == GOOD, np.nan, law(GOOD)), "found NaN or infinity"),
        (np.repeat(GOOD[::4], 4), np.repeat(law(GOOD[::4]), 4), "repeated exactly"),
        (GOOD, -law(GOOD), "expected compression positive"),
        (GOOD, law(GOOD) - 4e3, "expected 0 or more"),
        (GOOD, np.where(np.arange(61) == 30, 2 * law(GOOD), law(GOOD)), "found 1 outliers"),
        (GOOD, np.full(61, 5e3), "the stress stays at 5000 Pa"),
        (
            np.delete(GOOD, slice(20, 45)),
            law(np.delete(GOOD, slice(20, 45))),
            "no points between strain 0.19 and 0.45",
        ),
        (GOOD, 5e3 * np.minimum(GOOD / 0.1, 1.0), "the curve is flat"),
    ],
)
def test_bad_data_are_refused_with_their_reason(strain, stress, message):
    with pytest.raises(CalibrationError, match=message) as caught:
        calibrate_foam(data_of(strain, stress), **SIZE)
    assert "\n" not in str(caught.value)


def test_large_residual_is_refused():
    rng = np.random.default_rng(1)
    strain = np.tile(GOOD, 10)
    stress = np.maximum(law(strain) + rng.normal(0, 1500, strain.size), 0)
    with pytest.raises(CalibrationError, match=r"leaves a residual|falls by|outliers"):
        calibrate_foam(data_of(strain, stress), **SIZE)


def test_cubic_that_falls_is_refused_but_the_spline_is_not():
    stress = 9e3 * np.tanh(25 * GOOD) + 2e3 * GOOD + 6e4 * GOOD**6
    with pytest.raises(CalibrationError, match="cubic"):
        calibrate_foam(data_of(GOOD, stress), curve="cubic", **SIZE)
    assert calibrate_foam(data_of(GOOD, stress), **SIZE).residual_spline_Pa < 0.01 * stress.max()


def test_plateau_without_a_densification():
    curve = StressCurve("cubic", np.array([0.0, 0.5]), np.array([1e4, 0.0, 0.0]), np.zeros((3, 3)))
    working, densification = plateau(curve)
    assert (*working, densification) == pytest.approx((0.0, 0.5, 0.5))


@pytest.mark.data
def test_published_table(data):
    found = calibrate_foam(read_strain_stress(data / "foam_continuum" / "strain_stress.csv"), **SIZE)
    assert found.residual_spline_Pa < 2.0  # the table is rounded to 0.01 Pa
    assert 100 < found.residual_cubic_Pa < 200
    np.testing.assert_allclose(found.material.working_strain, (0.1, 0.5), atol=0.02)


@pytest.mark.data
@pytest.mark.parametrize("name", ["Ecoflex 00-30", "Dragon Skin 20", "Rebound 25"])
def test_real_tension_of_silicone(data, name):
    """Real curves bend the other way (tension): the spline follows them, and the foam range is refused."""
    lines = (data / "sensing" / "soft_materials" / f"{name}.csv").read_text(encoding="latin-1").splitlines()
    rows = []
    for line in lines:
        cells = line.split(";")
        try:
            values = [float(cell.replace(",", ".")) for cell in cells]
        except ValueError:
            continue
        if len(values) == 5:
            rows.append(values)
    table = np.array(rows)
    strain, stress = table[:, 3], table[:, 4] * 1e6  # elongation per length, true or nominal stress in MPa
    assert len(strain) > 100
    with pytest.raises(CalibrationError, match=r"found strains|smallest"):
        calibrate_foam(data_of(strain, stress), **SIZE)
    scaled = 0.9 * (strain - strain.min()) / np.ptp(strain)
    fit = fit_curve(scaled, stress - stress[np.argmin(strain)])
    cubic = fit_curve(scaled, stress - stress[np.argmin(strain)], kind="cubic")
    assert fit.curve.minimum_slope()[1] > 0
    assert fit.residual_Pa < 0.02 * np.ptp(stress)
    assert fit.residual_Pa <= 1.05 * cubic.residual_Pa
    # Beyond the data the curve goes on along its tangent: no fold, no explosion.
    beyond = fit.curve.stress(np.array([0.9, 0.95, 1.0]))
    assert np.all(np.diff(beyond) > 0)
    np.testing.assert_allclose(np.diff(beyond)[0], np.diff(beyond)[1])
