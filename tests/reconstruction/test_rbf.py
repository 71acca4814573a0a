"""The spline compared with SciPy, and its incremental form with a fit of all points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RBFInterpolator

from visuohaptic.core import InputError
from visuohaptic.reconstruction.fusion import SpaceGrid
from visuohaptic.reconstruction.surfaces import RbfSurface, isosurface


def sphere(rng, count=60, radius=0.05, d=0.005):
    """Centres on, outside and inside a sphere, and their distances."""
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    centers = np.concatenate([normals * (radius + shift) for shift in (0, d, -d)])
    return centers, np.repeat([0, d, -d], count)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_equal_to_scipy(seed):
    rng = np.random.default_rng(seed)
    centers, values = sphere(rng, 40)
    points = rng.uniform(-0.08, 0.08, (50, 3))
    ours = RbfSurface(centers, values)
    peer = RBFInterpolator(centers, values, kernel="cubic", degree=1)
    # The condition number is about 1e10: 1e-6 of the values' size (5 mm) is left of 16 digits.
    np.testing.assert_allclose(ours(points), peer(points), atol=1e-8)
    # float32 keeps 7 digits, the weights cancel by about 1e3.
    assert np.abs(ours.on_grid(points) - ours(points)).max() < 5e-5


@given(st.integers(0, 2**32 - 1), st.integers(1, 5))
@settings(max_examples=15, deadline=None)
def test_adding_equals_fitting_all(seed, rounds):
    rng = np.random.default_rng(seed)
    centers, values = sphere(rng, 30)
    grown = RbfSurface(centers, values, 1e-7)
    all_centers, all_values, all_rho = centers, values, np.full(len(values), 1e-7)
    for _ in range(rounds):
        more = rng.uniform(-0.05, 0.05, (3, 3))
        # The extent is that of the first fit: rho means the same in both.
        wanted, rho = rng.normal(0, 0.002, 3), 10.0 ** rng.uniform(-7, -4, 3)
        grown = grown.added(more, wanted, rho)
        all_centers, all_values = np.concatenate([all_centers, more]), np.concatenate([all_values, wanted])
        all_rho = np.concatenate([all_rho, rho])
    points = rng.uniform(-0.06, 0.06, (40, 3))
    whole = RbfSurface(all_centers, all_values, all_rho * (grown.extent_m / extent_of(all_centers)) ** 3)
    np.testing.assert_allclose(grown(points), whole(points), atol=1e-8)
    np.testing.assert_allclose(
        grown.kriging_sigma_m(points), whole.kriging_sigma_m(points), rtol=1e-3, atol=1e-7
    )


def extent_of(centers):
    return np.abs(centers - centers.mean(axis=0)).max()


def test_many_added_centres_are_factored_anew():
    rng = np.random.default_rng(0)
    centers, values = sphere(rng, 30)
    grown = RbfSurface(centers, values, 1e-6)
    extra, wanted = sphere(rng, 70, radius=0.052)
    for part in range(0, 210, 30):
        grown = grown.added(extra[part : part + 30], wanted[part : part + 30], 1e-6)
    assert grown.count == 300
    assert np.abs(grown(extra) - wanted).max() < 0.002


def test_gradient_is_that_of_finite_differences():
    rng = np.random.default_rng(2)
    surface = RbfSurface(*sphere(rng))
    points = rng.uniform(-0.06, 0.06, (20, 3))
    step = 1e-6
    numeric = np.stack(
        [(surface(points + step * axis) - surface(points - step * axis)) / (2 * step) for axis in np.eye(3)],
        axis=-1,
    )
    np.testing.assert_allclose(surface.gradient(points), numeric, atol=1e-5)


def test_the_variance_is_zero_at_centres_and_grows_away_from_them():
    rng = np.random.default_rng(3)
    centers, values = sphere(rng)
    surface = RbfSurface(centers, values)
    # Rounding: the square root of 1e-16 times the condition.
    assert surface.kriging_sigma_m(centers).max() < 1e-5
    away = np.array([[0.05 + shift, 0, 0] for shift in (0.01, 0.02, 0.04)])
    sigma = surface.kriging_sigma_m(away)
    assert (np.diff(sigma) > 0).all()


def test_the_narrow_band_has_the_surface_of_the_whole_grid():
    from skimage.measure import marching_cubes

    surface = RbfSurface(*sphere(np.random.default_rng(4), 150))
    grid = SpaceGrid.around(np.full(3, -0.07175), np.full(3, 0.07175), 0.14 / 40)
    vertices, faces = isosurface(surface, grid)
    whole = surface.on_grid(grid.all_centres_m).reshape(grid.shape)
    expected, triangles, _, _ = marching_cubes(whole, 0.0)
    assert (len(vertices), len(faces)) == (len(expected), len(triangles))
    np.testing.assert_allclose(vertices, grid.centres_m(expected), atol=1e-8)
    # On the sphere: linear interpolation in a cell leaves step^2 / 8 / radius = 0.03 mm, the fit more.
    assert np.abs(np.linalg.norm(vertices, axis=1) - 0.05).max() < 0.0005
    corners = vertices[faces]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((outward * corners.mean(axis=1)).sum(axis=1) > -1e-15).all()


def test_errors_say_what_is_wrong():
    flat = np.random.default_rng(0).random((20, 3)) * [1, 1, 0]
    with pytest.raises(InputError, match="one plane"):
        RbfSurface(flat, np.zeros(20))
    with pytest.raises(InputError, match="finite"):
        RbfSurface(np.full((5, 3), np.nan), np.zeros(5))
    with pytest.raises(InputError, match="n >= 4"):
        RbfSurface(np.zeros((3, 3)), np.zeros(3))
