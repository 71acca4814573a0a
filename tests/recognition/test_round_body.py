"""Bodies of revolution whose contents are felt: volumes in closed form, and errors of an outline by another library's filter."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from visuohaptic.core import InputError
from visuohaptic.recognition.touch._round_body import (
    EMPTY,
    round_body,
    stiffness_scatter,
    wall_from_stiffness,
)

RADIUS_M, HEIGHT_M, WALL_M = 0.03, 0.2, 4e-4
Z_M = np.linspace(0.0, HEIGHT_M, 81)
TUBE_M = np.column_stack([np.full(81, RADIUS_M), Z_M])


def test_volume_mass_and_level_of_a_tube() -> None:
    body = round_body(TUBE_M, WALL_M)
    volume_m3 = math.pi * RADIUS_M**2 * HEIGHT_M
    assert body.below_m3[-1] == pytest.approx(volume_m3)
    assert body.level_m(0.25) == pytest.approx(0.25 * HEIGHT_M)
    wall_m = 0.9 * WALL_M + 0.1 * 1.2e-3  # the neck is a tenth of the height, to half a step of the grid
    assert body.wall_kg == pytest.approx(1380.0 * 2 * math.pi * RADIUS_M * HEIGHT_M * wall_m, rel=0.015)


def test_water_adds_its_pressure_and_a_lid_the_compressed_air() -> None:
    body, d = round_body(TUBE_M, WALL_M), np.array([0.0, 0.001, 0.004])
    empty, no_air = body.force_N((False, EMPTY, 0.0), 0.05, d)
    full, _ = body.force_N((False, "liquid", 1.0), 0.05, d)
    # A wall that gives way by d on two sides: the pressure of 15 cm of water on 3 pi r d of it.
    np.testing.assert_allclose(full - empty, 3 * math.pi * RADIUS_M * 1000 * 9.80665 * 0.15 * d, rtol=1e-3)
    assert not no_air.any()
    _, enclosed = body.force_N((True, EMPTY, 0.0), 0.05, d)
    # The work of both fingers is that done on the air, isothermal to first order.
    deep = np.linspace(0.0, 0.004, 2001)
    force = body.force_N((True, EMPTY, 0.0), 0.05, deep)[1]
    lost_m3 = math.pi * (3 * deep[-1] ** 2 * RADIUS_M - deep[-1] ** 3)
    air_m3 = body.below_m3[-1]
    work_J = 101325 * (-air_m3 * math.log(1 - lost_m3 / air_m3) - lost_m3)
    assert 2 * np.trapezoid(force, deep) == pytest.approx(work_J, rel=0.01)
    assert enclosed[-1] == pytest.approx(force[-1])


def test_the_wall_is_that_with_which_the_stiffness_was_made() -> None:
    body = round_body(TUBE_M, WALL_M)
    felt = [(z, float(np.interp(z, body.z_m, body.stiffness_N_per_m[1]))) for z in (0.06, 0.1)]
    assert wall_from_stiffness(TUBE_M, [*felt, (0.1, -1.0), (0.1, math.nan)], 1e-3) == pytest.approx(
        WALL_M, rel=0.01
    )
    with pytest.raises(InputError, match="no squeeze with a stiffness"):
        wall_from_stiffness(TUBE_M, [(0.1, math.nan)], 1e-3)


def test_an_outline_with_dents_scatters_more_than_one_of_another_radius() -> None:
    """Errors are correlated over 2 cm: white noise through a Gaussian of 2 cm / sqrt(2) has that correlation."""
    assert not stiffness_scatter(TUBE_M, WALL_M, 0.0).any()
    sigma_m, rng, logs = 5e-4, np.random.default_rng(5), []
    pixels = 0.02 / np.sqrt(2) / (Z_M[1] - Z_M[0])
    for _ in range(24):
        noise = gaussian_filter1d(rng.standard_normal(481), pixels)[200:281]
        noise *= sigma_m * math.sqrt(2 * math.sqrt(math.pi) * pixels)
        body = round_body(np.column_stack([RADIUS_M + noise, Z_M]), WALL_M)
        logs.append(np.log(body.stiffness_N_per_m[0][20:60]))
    expected = math.sqrt(np.mean(np.var(logs, axis=0, ddof=1)))
    found = math.sqrt(np.mean(stiffness_scatter(TUBE_M, WALL_M, sigma_m)[:, 20:60] ** 2))
    assert expected > 0.05  # by the radius alone it would be 0.013
    # From 16 outlines: their standard deviation has a standard error of 18 % at each of five independent heights.
    assert found == pytest.approx(expected, rel=0.3)
