"""Constraints of the spline: what a touched wall encloses is inside."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core.geometry import sphere_directions
from visuohaptic.reconstruction.completion import constrain_axis, with_off_surface
from visuohaptic.reconstruction.surfaces.rbf import RbfSurface


def closing_ends(seed):
    """Spline of two cut balls of 30 mm, seen with .5 mm of noise, that close towards each other, and the smoothing of its centres as in a completion."""
    ways = sphere_directions(120)
    ways = ways[ways[:, 2] < 0.8]
    noise_m = 5e-4 * np.random.default_rng(seed).standard_normal((2, len(ways), 1))
    lower, upper = (0.03 + noise_m) * (ways, ways * (1, 1, -1))
    points_m = np.vstack([lower + np.array((0, 0, 0.005)), upper + np.array((0, 0, 0.105))])
    fit = RbfSurface(*with_off_surface(points_m, np.vstack([ways, ways * (1, 1, -1)]), 0.008)[:2], 1e-8)
    return fit, lambda sigma_m, extent_m: (np.asarray(sigma_m) / extent_m) ** 2 / fit.process_scale


@pytest.mark.parametrize("seed", [1, 2])
def test_two_ends_of_a_touched_wall_are_not_closed_separately(seed):
    fit, rho = closing_ends(seed)
    angles = np.array([0.3, 2.4, 4.4])
    heights_m = np.array([0.043, 0.055, 0.066])
    contacts_m = np.column_stack([0.03 * np.cos(angles), 0.03 * np.sin(angles), heights_m])
    axis_m = np.column_stack([np.zeros((9, 2)), np.linspace(heights_m[0], heights_m[-1], 9)])
    touched = fit.added(contacts_m, np.zeros(3), rho(np.full(3, 3e-4), fit.extent_m))
    assert touched(axis_m).max() > 0.0  # contacts alone do not join them
    joined = constrain_axis(touched, np.zeros(2), contacts_m, 0.006, rho)
    assert joined(axis_m).max() < 0.0
    np.testing.assert_allclose(joined(contacts_m), 0.0, atol=1e-3)


def test_an_axis_that_is_inside_gets_no_centres():
    fit, rho = closing_ends(1)
    assert constrain_axis(fit, np.zeros(2), np.array([[0.03, 0.0, 0.005]]), 0.006, rho) is fit
