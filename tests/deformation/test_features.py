from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from visuohaptic.core import InputError
from visuohaptic.deformation.maps import (
    contact_loads,
    couple,
    curve_coefficients,
    linear_features,
    nonlinear_features,
    normalised,
    own_compliance,
)
from visuohaptic.deformation.nonlinear import Contents
from visuohaptic.deformation.nonlinear.contents import pinch_load, tip_approach
from visuohaptic.deformation.shapes import ShellObject, load_container, mesh_container
from visuohaptic.deformation.shells import dual_tip_compliance, opposing_points


@pytest.fixture(scope="module")
def elliptic() -> ShellObject:
    return mesh_container(load_container("elliptic").middle(), around=32)


@pytest.fixture(scope="module")
def cleaner() -> ShellObject:
    return mesh_container(load_container("cleaner").middle(), around=32)


def test_own_deformation_equals_a_full_solve(cleaner: ShellObject) -> None:
    model = cleaner.model()
    tips = opposing_points(cleaner.mesh, np.array([10 * 32 + 3, 20 * 32 + 8, 25 * 32]))
    c = dual_tip_compliance(model, tips)
    own = own_compliance(model, tips, c)
    for which in range(3):
        moved = model.solve(pinch_load(model, tips, which))
        first = tips.direction[which] @ moved[tips.first[which], :3]
        both = tip_approach(tips, moved, cleaner.mesh.vertices_m)[which]
        assert own[which] == pytest.approx(first, rel=1e-7)
        assert c[which] == pytest.approx(both, rel=1e-7)


def test_a_closed_container_s_own_deformation_equals_a_dense_solve(cleaner: ShellObject) -> None:
    from visuohaptic.deformation.maps.features import _own
    from visuohaptic.deformation.nonlinear import enclosed_gradient

    model = cleaner.model()
    what = Contents(fill=0.8)
    tips = opposing_points(cleaner.mesh, np.array([20 * 32 + 8]), axis_point_m=cleaner.axis_point_m)
    found = _own(cleaner, model, tips, what)[0]
    a, load = enclosed_gradient(cleaner, model), pinch_load(model, tips, 0)
    u, w = model.solve(load), model.solve(a)
    kappa = what.bulk_stiffness(cleaner.volume_m3)
    u = u - w * (kappa * np.sum(a * u) / (1 + kappa * np.sum(a * w)))
    assert found == pytest.approx(tips.direction[0] @ u[tips.first[0], :3], rel=1e-6)


def test_the_grid_follows_the_axes_and_is_symmetric_where_the_object_is(elliptic: ShellObject) -> None:
    found = linear_features(elliptic)
    assert found.values.shape == (16, 4, 3)
    i = found.values[..., 0]
    assert np.isfinite(found.values).all()
    np.testing.assert_allclose(i[:, 0], i[:, 1], rtol=1e-6)
    np.testing.assert_allclose(i[:, 2], i[:, 3], rtol=1e-6)
    # The body of an ellipse is stiff at its tips (x) and soft on its flat sides (y).
    assert (i[2:10, 0] > 2 * i[2:10, 2]).all()
    heights = found.points_m[:, 0, 2] / elliptic.height_m
    np.testing.assert_allclose(heights, (np.arange(16) + 0.5) / 16, atol=1e-9)
    assert (found.points_m[:, 0, 0] > 0).all()
    assert (found.points_m[:, 3, 1] < 0).all()


def test_a_shifted_neck_makes_opposite_sides_differ(cleaner: ShellObject) -> None:
    i = linear_features(cleaner).values[..., 0]
    assert abs(i[13, 2] / i[13, 3] - 1) > 1e-3
    # Between vertices values are linear over one half of a cell: 0.5 % on this coarse mesh.
    np.testing.assert_allclose(i[:, 0], i[:, 1], rtol=0.01)


@given(st.floats(1e-3, 1e3), st.integers(0, 2**32 - 1))
def test_normalised_features_have_no_scale(scale: float, seed: int) -> None:
    feature = np.random.default_rng(seed).uniform(1e3, 1e5, (16, 4))
    for scheme in ("norm", "centre", "point"):
        one = normalised(feature, scheme)
        np.testing.assert_allclose(normalised(scale * feature, scheme), one, rtol=1e-9, atol=1e-12)
    assert np.linalg.norm(normalised(feature, "norm")) == pytest.approx(1)
    assert normalised(feature, "centre")[7].mean() == pytest.approx(0, abs=1e-12)
    assert normalised(feature, "point")[7, 0] == pytest.approx(0, abs=1e-12)


def test_unknown_normalisation_is_refused() -> None:
    with pytest.raises(InputError, match="norm, centre or point"):
        normalised(np.ones((16, 4)), "mean")


@given(st.floats(100, 1e5), st.floats(-1e6, 1e6))
def test_coefficients_of_a_known_curve(a: float, b: float) -> None:
    d = np.linspace(0, 0.008, 33)
    i, full, quadratic = curve_coefficients(d, a * d + b * d**2)
    # Least squares of d^2 by d over 0 .. D is 3 D / 4 in the continuum; a few percent off on 33 points.
    low = d[d <= 0.003 + 1e-12]
    assert i == pytest.approx(a + b * np.sum(low**3) / np.sum(low**2), rel=1e-9)
    assert full == pytest.approx(a + b * np.sum(d**3) / np.sum(d**2), rel=1e-9, abs=1e-6)
    assert quadratic == pytest.approx(b * 0.01**2 / 50, rel=1e-6, abs=1e-6)


def test_features_of_curves_start_from_the_linear_ones() -> None:
    container = mesh_container(load_container("cup-rim").middle(), around=24)
    linear = linear_features(container).values
    curved = nonlinear_features(container, deformation_m=(2e-5, 4e-5), heights=[8]).values
    # Nearest vertex instead of the place itself, on a coarse mesh: some percent.
    assert curved[7, 0, 0] == pytest.approx(linear[7, 0, 0], rel=0.1)
    assert curved[7, 2, 0] == pytest.approx(curved[7, 0, 0])  # round: computed once
    assert np.isnan(curved[0]).all()


def test_contacts_add_up_and_are_reciprocal(elliptic: ShellObject) -> None:
    model = elliptic.model()
    tips = opposing_points(elliptic.mesh, np.array([10 * 32 + 8, 14 * 32 + 9]))
    found = couple(model, tips)
    np.testing.assert_allclose(found.compliance, found.compliance.T, rtol=1e-8)
    loads = contact_loads(model, tips).toarray()
    force = np.array([2.0, -1.0])
    moved = model.solve((loads @ force).reshape(-1, 6)).ravel()
    np.testing.assert_allclose(found.deformation_m(force), loads.T @ moved, rtol=1e-6)
    np.testing.assert_allclose(found.force_N(found.deformation_m(force)), force, rtol=1e-9)


def test_a_finite_tip_presses_with_the_same_force_and_dents_less(elliptic: ShellObject) -> None:
    model = elliptic.model()
    tips = opposing_points(elliptic.mesh, np.array([10 * 32 + 8]))
    spread = contact_loads(model, tips, tip_radius_m=0.012).toarray().reshape(-1, 6)
    point = contact_loads(model, tips).toarray().reshape(-1, 6)
    np.testing.assert_allclose(spread.clip(0).sum(axis=0), point.clip(0).sum(axis=0), atol=1e-12)
    assert couple(model, tips, tip_radius_m=0.012).compliance < couple(model, tips).compliance
    tiny = couple(model, tips, tip_radius_m=1e-6).compliance
    np.testing.assert_allclose(tiny, couple(model, tips).compliance, rtol=1e-9)
