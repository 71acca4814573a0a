"""What the constants of the sensors are said to do, computed by other means."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from visuohaptic.sensing.foam import _texture_kernels, edges, profile
from visuohaptic.sensing.foam.strip import _reference, encoding
from visuohaptic.sensing.push import at_rest, breakaway
from visuohaptic.sensing.scene import obstacle_parallax


def test_an_edge_at_rest_seems_to_be_a_gap_once_in_forty_times() -> None:
    assert norm.sf(edges._CHANCE_SIGMAS) == pytest.approx(1 / 40, rel=0.12)


def test_noise_of_a_strip_of_85_points_is_a_contact_once_in_a_hundred_thousand_frames() -> None:
    """Either test alone less often than that, and neither needs more than a tenth of its deviations less for a million."""
    for alarms in (85 * norm.sf(profile.SEED_SINGLE_SIGMAS), 84 * norm.sf(profile.SEED_PAIR_SIGMAS) ** 2):
        assert 1e-6 < alarms < 1e-5


def test_the_biweight_is_as_efficient_as_a_mean_to_a_twentieth() -> None:
    """Asymptotic variance of an M-estimator: the mean square of psi over the squared mean of its derivative."""
    c = _reference._TUKEY

    def mean(part: Callable[[float], float]) -> float:
        return float(quad(lambda x: part(x) * norm.pdf(x), -c, c)[0])

    square = mean(lambda x: (x * (1.0 - (x / c) ** 2) ** 2) ** 2)
    slope = mean(lambda x: (1.0 - (x / c) ** 2) * (1.0 - 5.0 * (x / c) ** 2))
    assert slope**2 / square == pytest.approx(0.95, abs=0.002)


def test_texture_is_that_of_the_zero_image_or_another() -> None:
    assert math.exp(_texture_kernels._SAME) + math.exp(_texture_kernels._OTHER) == pytest.approx(
        1.0, abs=0.01
    )


@pytest.mark.parametrize("step", [0.0, 0.5, 1.0, 2.0, 5.0, 20.0])
def test_a_blurred_step_has_about_the_density_that_is_assumed(step: float) -> None:
    """A uniform density over a step with noise of one; without a step it has the peak of a normal density."""
    peak = norm.pdf(0.0) if step == 0.0 else (norm.cdf(0.5 * step) - norm.cdf(-0.5 * step)) / step
    assumed = 1.0 / (step + at_rest.UNIFORM)
    assert peak / 1.6 < assumed < peak * (1.0 + 1e-12)
    if step == 0.0:
        assert assumed == pytest.approx(peak)


def test_two_noiseless_images_differ_by_their_rounding() -> None:
    grey = np.random.default_rng(1).uniform(50.0, 200.0, 20_000)
    other = grey + np.random.default_rng(2).uniform(-20.0, 20.0, 20_000)
    left = np.round(grey) - grey - (np.round(other) - other)
    assert pytest.approx(left.std(), rel=0.05) == obstacle_parallax._MIN_NOISE


def test_a_registration_to_the_nearest_bin_is_off_by_a_third_of_it() -> None:
    place = np.random.default_rng(1).uniform(0.0, 100.0, 20_000)
    assert pytest.approx((np.round(place) - place).std(), rel=0.06) == obstacle_parallax._REGISTRATION_BINS


def test_a_camera_encodes_light_as_srgb_does() -> None:
    """IEC 61966-2-1; a power law comes within a hundredth of white of it over all grey levels."""
    grey = np.linspace(0.0, 1.0, 256)
    light = np.where(grey <= 0.04045, grey / 12.92, ((grey + 0.055) / 1.055) ** 2.4)
    assert np.abs(grey**encoding._EXPONENT - light).max() < 0.01


def test_objects_slide_with_a_friction_of_a_fifth_to_four_fifths_and_roll_with_a_tenth_of_that() -> None:
    """Two standard deviations of the logarithm on either side."""
    for middle, sigma, low, high in (
        (breakaway.FRICTION, breakaway.LOG_SIGMA, 0.2, 0.8),
        (breakaway.ROLLING, breakaway.LOG_ROLLING_SIGMA, 0.02, 0.2),
    ):
        found = middle * np.exp(2.0 * sigma * np.array([-1.0, 1.0]))
        assert found == pytest.approx((low, high), rel=0.12)
