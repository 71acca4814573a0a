"""Features from curves: departures from linear elasticity, on coarse meshes and between heights."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.deformation import (
    Contents,
    PinchPlane,
    ShellObject,
    curve_coefficients,
    linear_features,
    load_container,
    mesh_container,
    nonlinear_features,
)
from visuohaptic.deformation.container import ContainerDescription
from visuohaptic.errors import InputError


def shipped(name: str, around: int = 16) -> ShellObject:
    return mesh_container(load_container(name).middle(), around=around)


def test_small_deformations_give_the_linear_features() -> None:
    for name in ("elliptic", "cleaner"):
        thing = shipped(name, 24)
        for contents in (None, Contents(fill=0.5)):
            linear = linear_features(thing, contents).values
            found = nonlinear_features(thing, contents, deformation_m=(1e-6, 2e-6), heights=[5, 12])
            for row in (4, 11):
                # The force has an error of 1e-5, its curvature is of the order of d / t.
                np.testing.assert_allclose(found.values[row, :, :2], linear[row, :, :2], rtol=5e-3)
            assert np.isnan(found.values[5]).all()
            assert found.reached is not None
            np.testing.assert_allclose(found.reached[[4, 11]], 1.0)


def test_a_coefficient_is_the_linear_one_times_what_the_curve_says() -> None:
    thing = shipped("elliptic")
    steps = (0.0005, 0.001, 0.002, 0.004)
    found = nonlinear_features(thing, deformation_m=steps, heights=[8])
    vertex = int(np.argmin(np.linalg.norm(thing.mesh.vertices_m - found.points_m[7, 2], axis=1)))
    plane = PinchPlane(thing, np.pi / 2, one_way=True)
    curve = plane.curve(vertex, deformation_m=steps)
    wanted = np.array(curve_coefficients(curve.first_m, curve.force_N)) * plane.linear(vertex)[0]
    linear = linear_features(thing).values[7, 2, 0]
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


def test_wrong_heights_are_refused() -> None:
    with pytest.raises(InputError, match="1 to 16"):
        nonlinear_features(shipped("cup"), heights=[0, 3])
