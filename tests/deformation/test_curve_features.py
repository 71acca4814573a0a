"""Features from curves: departures from linear elasticity, on coarse meshes and between heights."""

from __future__ import annotations

import re

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.deformation.maps import (
    GraspCurve,
    PinchPlane,
    curve_coefficients,
    feature_locations,
    linear_features,
    nonlinear_features,
)
from visuohaptic.deformation.maps.curve_features import _between, _judged
from visuohaptic.deformation.nonlinear import Contents
from visuohaptic.deformation.shapes import ContainerDescription, ShellObject, load_container, mesh_container


def shipped(name: str, around: int = 16) -> ShellObject:
    return mesh_container(load_container(name).middle(), around=around)


def test_small_deformations_give_the_linear_features() -> None:
    for name in ("elliptic", "cleaner"):
        container = shipped(name, 24)
        for contents in (None, Contents(fill=0.5)):
            linear = linear_features(container, contents).values
            found = nonlinear_features(container, contents, deformation_m=(1e-6, 2e-6), heights=[5, 12])
            for row in (4, 11):
                # The force has an error of 1e-5, its curvature is of the order of d / t.
                np.testing.assert_allclose(found.values[row, :, :2], linear[row, :, :2], rtol=5e-3)
            assert np.isnan(found.values[5]).all()
            assert found.reached is not None
            np.testing.assert_allclose(found.reached[[4, 11]], 1.0)
            assert found.valid[[4, 11]].all()
            assert (found.reason[[4, 11]] == "").all()
            assert not found.valid[5].any()
            assert (found.reason[5] == "no curve was computed here").all()


def test_a_coefficient_is_the_linear_one_times_what_the_curve_says() -> None:
    container = shipped("elliptic")
    steps = (0.0005, 0.001, 0.002, 0.004)
    found = nonlinear_features(container, deformation_m=steps, heights=[8])
    vertex = int(np.argmin(np.linalg.norm(container.mesh.vertices_m - found.points_m[7, 2], axis=1)))
    plane = PinchPlane(container, np.pi / 2, one_way=True)
    curve = plane.curve(vertex, deformation_m=steps)
    wanted = np.array(curve_coefficients(curve.first_m, curve.force_N)) * plane.linear(vertex)[0]
    linear = linear_features(container).values[7, 2, 0]
    np.testing.assert_allclose(found.values[7, 2], linear * wanted, rtol=1e-6)
    # A flat side softens, then stiffens.
    assert found.values[7, 2, 0] < linear


def test_between_heights_and_on_a_coarser_mesh() -> None:
    """On a smooth wall both stay near the curves of every height: within some percent, II in its unit."""
    smooth = ContainerDescription.model_validate(
        {
            "base": {"shape": "ellipse", "radius": "35 mm", "radius_y": "28 mm"},
            "sections": [{"height": "160 mm", "radius": "30 mm"}],
            "wall": "0.6 mm",
        }
    )
    fine, coarse = mesh_container(smooth, around=32), mesh_container(smooth, around=24)
    steps = (0.0005, 0.001, 0.002, 0.003)
    rows = [5, 7, 9, 11]
    whole = nonlinear_features(fine, deformation_m=steps, heights=[6, 8, 10, 12]).values[rows]
    between = nonlinear_features(fine, deformation_m=steps, heights=[6, 10, 12], fill_in=True).values
    other = nonlinear_features(fine, deformation_m=steps, heights=[6, 8, 10, 12], coarse=coarse).values[rows]
    assert np.isfinite(between).all()
    # The curves belong to the nearest vertices, a few millimetres off.
    np.testing.assert_allclose(between[[5, 9, 11]], whole[[0, 2, 3]], rtol=0.05)
    np.testing.assert_allclose(between[7, :, :2], whole[1, :, :2], rtol=0.05)
    np.testing.assert_allclose(other[..., :2], whole[..., :2], rtol=0.1)


def curve(force: list[float], *, stable: bool = True, reason: str = "") -> GraspCurve:
    d, f = np.array(WANTED_m[: len(force)]), np.array(force)
    none = np.zeros(3)
    return GraspCurve(
        f,
        d,
        d,
        d,
        np.zeros(len(f)),
        np.full(len(f), stable),
        np.zeros(len(f)),
        none,
        none,
        len(f) == 6,
        reason,
        1,
        1,
        1,
    )


WANTED_m = (0.0005, 0.001, 0.002, 0.003, 0.005, 0.008)


@pytest.mark.parametrize(
    ("found", "valid", "said"),
    [
        (curve([1, 2, 4, 6, 10, 16]), [True, True, True], "^$"),
        (
            curve([1, 2, 4, 6], reason="the walls touch"),
            [True, False, False],
            "ends at 38 %: the walls touch",
        ),
        (curve([1, 2], reason="the walls touch"), [False, False, False], "ends at 12 %"),
        (curve([1, 2, 4, 3, 5, 9]), [True, True, False], "snaps through"),
        (curve([1, 2, 4, 6, 10, 16], stable=False), [True, True, False], "snaps through"),
        (curve([5, 9, 9.1, 9.2, 9.3, 9.4]), [True, True, False], "from a parabola"),
    ],
)
def test_what_a_curve_does_not_say_is_marked(found: GraspCurve, valid: list[bool], said: str) -> None:
    got = float(found.deformation_m[-1] / WANTED_m[-1])
    marked, reason = _judged(found, np.array(WANTED_m), got)
    assert marked.tolist() == valid
    assert re.search(said, reason)


def test_between_two_curves_is_valid_what_is_valid_in_both() -> None:
    departure = np.full((16, 4, 3), np.nan)
    at_m, level_m = np.full((16, 4), np.nan), np.repeat(np.arange(16.0)[:, None], 4, axis=1)
    valid, reason = np.zeros((16, 4, 3), dtype=bool), np.full((16, 4), "none", dtype=object)
    for row, good in ((2, True), (6, True), (10, False)):
        departure[row], at_m[row], reason[row] = 1.0, row, "" if good else "snaps"
        valid[row] = [True, True, good]
    out, sure, why = _between(departure, at_m, level_m, valid, reason)
    assert np.isfinite(out).all()
    assert sure[:7].all()
    assert (why[:7] == "").all()
    assert not sure[7:, :, 2].any()
    assert sure[7:, :, :2].all()
    assert why[8, 0] == "between two curves, of which: snaps"


def test_rings_where_the_features_are() -> None:
    container = mesh_container(load_container("cien").middle(), around=24, levels=16)
    points, corners, weights = feature_locations(container)
    nearest = np.take_along_axis(corners, weights.argmax(axis=2)[..., None], axis=2)[..., 0]
    away = np.abs(container.mesh.vertices_m[nearest, 2] - points[..., 2])
    # Some give way to a break of the profile close by, none is farther off than a quarter of a cell.
    assert (away < 1e-9).mean() > 0.7
    assert away.max() < 0.25 * 2 * np.pi * 0.04 / 24


def test_wrong_heights_are_refused() -> None:
    with pytest.raises(InputError, match="1 to 16"):
        nonlinear_features(shipped("cup"), heights=[0, 3])
