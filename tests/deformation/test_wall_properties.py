"""Thickness of a measured wall, from surfaces whose thickness is known by construction."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.deformation.shapes.wall_properties import harmonics, measured_thickness

ANGLE = 2 * np.pi * np.arange(72) / 72
HEIGHTS = np.linspace(0.0, 0.1, 51)


def test_a_handle_does_not_change_the_wall_that_it_is_on() -> None:
    inner = np.full((51, 72), 0.04)
    outer = inner + 0.002
    outer[10:40, 5:10] += 0.03
    thickness, uneven, spread = measured_thickness(inner, outer, HEIGHTS)
    np.testing.assert_allclose(thickness[:, 1], 0.002, rtol=1e-9)
    around = uneven @ harmonics(ANGLE).T
    # Above and below it, beyond the rows that are averaged and its slopes, there is nothing else than the wall.
    np.testing.assert_allclose(around[[0, -1]], 1.0, rtol=1e-9)
    # Where it is, points beside it count as thinner by the slope of the outside, which lets in less than it is wide.
    np.testing.assert_allclose(around.mean(axis=1), 1.0, atol=7 / 72 * 0.5)
    assert spread < 1e-3


@pytest.mark.parametrize("shift_m", [0.0002, -0.0004])
def test_an_eccentric_wall_is_thick_on_one_side(shift_m: float) -> None:
    """A round hole that is off the axis of its round outside: the wall is t + e cos(angle), to (e / R)^2."""
    hole = np.full((51, 72), 0.04)
    outer = hole + 0.002 + shift_m * np.cos(ANGLE)
    thickness, uneven, _ = measured_thickness(hole, outer, HEIGHTS)
    np.testing.assert_allclose(thickness[:, 1], 0.002, rtol=1e-3)
    expected = 1 + shift_m / 0.002 * np.cos(ANGLE)
    np.testing.assert_allclose(uneven @ harmonics(ANGLE).T, np.tile(expected, (len(uneven), 1)), atol=1e-3)
