"""Priors and limits of sensing, by the data and distributions that they stand for."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from visuohaptic.core.errors import CalibrationError
from visuohaptic.sensing.beam.calibration import _refuse_few, _refuse_noise, _refuse_surprise, _refuse_wander
from visuohaptic.sensing.push.at_rest import _noise_m
from visuohaptic.sensing.push.tag import _withstood_N, fixed_probability
from visuohaptic.sensing.scene.contact_surface import _contact_line
from visuohaptic.sensing.scene.obstacle_parallax import _scale

RECORD, PAIR = (SimpleNamespace(where="loads.csv", line=np.arange(count)) for count in (100, 2))


def test_the_prior_of_friction_is_that_of_the_objects_of_table_4_1() -> None:
    """Logarithmic mean and deviation of eight that slid; (1 + 1/2) of (9 + 1) are fastened."""
    slid = np.log([8.1, 1.5, 6.5, 15.9, 2.8, 0.6, 0.9, 1.3])
    for withstood, most in ((2.0, 20.0), (0.5, 3.0), (9.0, 15.0)):
        needs = [0.15 + 0.85 * ndtr((slid.mean() - math.log(one)) / slid.std()) for one in (withstood, most)]
        assert fixed_probability(withstood, most) == pytest.approx(needs[1] / needs[0], rel=0.03)


def test_a_withstood_force_is_below_the_true_one_in_all_but_one_of_forty_cases() -> None:
    """Readings at the quantiles of a normal error of 0.2 N about 5 N; 2.3 % are beyond two standard deviations."""
    phases: Any = SimpleNamespace(contact_s=0.0)
    above = 0
    for error in ndtri((np.arange(1000) + 0.5) / 1000):
        record: Any = SimpleNamespace(
            force_valid=np.ones(1, bool), t_s=np.ones(1), force_N=np.array([5.0 + 0.2 * error]),
            force_scale_sigma=0.0, force_sigma_N=np.array([0.2]),
        )  # fmt: skip
        above += (_withstood_N(record, phases) or 0.0) > 5.0
    assert above == pytest.approx(23, abs=2)


@pytest.mark.parametrize(("rows", "loaded", "enough"), [(8, 4, True), (7, 4, False), (8, 3, False)])
def test_six_unknowns_of_a_beam_need_eight_rows_of_which_four_are_loaded(
    rows: int, loaded: int, enough: bool
) -> None:
    load = np.zeros((rows, 6))
    load[:loaded, 0] = np.linspace(1.0, 2.0, loaded)
    _raises(not enough, "rows, ", _refuse_few, RECORD, load)


def _raises(expected: bool, said: str, check: Any, *args: Any) -> None:
    if not expected:
        check(*args)
        return
    with pytest.raises(CalibrationError, match=said):
        check(*args)


def test_an_axis_is_loaded_when_its_load_changes_by_a_twentieth() -> None:
    for change, loaded in ((0.046, False), (0.054, True)):
        load = np.zeros((10, 6))
        load[:, 2] = 1.0 - change * (np.arange(10) % 2)
        _raises(not loaded, "no load changes by more than 5 %", _refuse_few, RECORD, load)


def test_an_unloaded_beam_wanders_by_a_twentieth_of_the_largest_load_at_most() -> None:
    load = np.zeros((2, 6))
    for scatter, wanders in ((0.046, False), (0.054, True)):
        read = np.zeros((2, 6))
        read[1, 3] = 3.0 * scatter * math.sqrt(2.0)  # two values deviate by their difference over sqrt(2)
        _raises(wanders, "with a scatter of", _refuse_wander, PAIR, load, read, np.full(6, 3.0))


def _noise(rest: np.ndarray, read: np.ndarray) -> tuple[Any, ...]:
    """Six equal axes with a load range of one."""
    return RECORD, np.tile(read[:, None], 6), np.tile(rest[:, None], 6), np.ones(6, bool), np.ones(6)


def test_a_linear_beam_explains_its_readings() -> None:
    """By a twentieth of the range, of the variance, and by seven deviations of a single row."""
    sign, ramp = np.where(np.arange(40) % 2, 1.0, -1.0), np.linspace(-0.5, 0.5, 40)
    for rest, loose in ((0.048, False), (0.052, True)):
        _raises(loose, "scatters by 5 % of the largest load", _refuse_noise, *_noise(rest * sign, ramp))
    for part, linear in ((0.046, True), (0.054, False)):
        across = 0.04 * sign
        read = 0.04 / math.sqrt(part) * np.where(np.arange(40) < 20, 1.0, -1.0)
        _raises(not linear, "the loads explain only", _refuse_noise, *_noise(across, read))
    for far, outlier in ((6.6, False), (7.4, True)):
        usual = 0.01 * float(ndtri(0.75)) * sign  # the median of the absolute errors of a deviation of 0.01
        usual[5] = 0.01 * far
        _raises(outlier, "deviates by 7 standard deviations", _refuse_noise, *_noise(usual, ramp))


def test_a_beam_is_within_five_deviations_of_its_data_sheet() -> None:
    for off, surprising in ((4.7, False), (5.3, True)):
        free = np.zeros(6)
        free[2] = 0.1 * off
        _raises(
            surprising,
            "5 standard deviations",
            _refuse_surprise,
            RECORD,
            2,
            free,
            np.zeros(6),
            np.full(6, 0.1),
        )


def test_the_direction_of_a_contact_of_4_cm_is_known_as_well_as_before_it() -> None:
    """Half of its slope is believed; of one of 12 cm nine tenths."""
    for span, trust in ((0.04, 0.5), (0.12, 0.9)):
        y = np.linspace(-0.5 * span, 0.5 * span, 9)
        contact: Any = SimpleNamespace(delta_m=np.full(9, 0.01), points_foam_m=np.column_stack([0.2 * y, y]))
        _, along = _contact_line(contact, None)
        assert along[0] / along[1] == pytest.approx(0.2 * trust, rel=0.02)


def test_noise_of_a_strip_is_measured_down_to_that_of_rounding() -> None:
    """A quarter of the pixels have the noise of the floor, and two images that are rounded differ by a sixth of a level squared."""
    rng = np.random.default_rng(5)
    level, variance = np.ones((60, 400), np.float32), np.zeros((60, 400), np.float32)
    images = 30.0 + 5.0 * rng.random((2, 60, 400))
    first, second = np.rint(images) - images
    rounded = float(np.var(first - second))
    still = _scale(np.zeros((60, 400), np.float32), variance, level)
    for sigma in (1.5, 6.0):
        noisy = _scale((sigma * rng.standard_normal((60, 400))).astype(np.float32), variance, level)
        assert float(noisy.mean() / still.mean()) == pytest.approx(rounded / sigma**2, rel=0.09)


@pytest.mark.parametrize(("frames", "measured"), [(5, False), (6, True), (4000, True)])
def test_noise_of_a_deflection_is_twice_its_scatter_from_six_free_frames_on(
    frames: int, measured: bool
) -> None:
    """Of white noise, differences from frame to frame have sqrt(2) of its deviation."""
    noise = 1e-5 * np.random.default_rng(6).standard_normal(frames)
    record: Any = SimpleNamespace(deflection_sigma_m=np.full(frames, 1e-3), deflection_m=noise)
    found = _noise_m(record, frames)
    assert (found < 1e-4) == measured
    if frames > 1000:
        assert found == pytest.approx(2e-5, rel=0.05)
