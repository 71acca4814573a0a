"""The Fourier series against the anchor, plate theory at the limits, and triangles."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.deformation.shapes import tube_mesh
from visuohaptic.deformation.shells import (
    IsotropicMaterial,
    RevolutionShell,
    ShellMesh,
    ShellModel,
    dual_tip_map,
    pinch_stiffness,
)
from visuohaptic.deformation.shells.fourier_shell import _meridian

PLASTIC = IsotropicMaterial(2.5e9, 0.38)


def test_the_pinched_tube_of_the_anchor():
    height = np.linspace(0, 0.2, 101)
    found = pinch_stiffness(RevolutionShell(np.full(101, 0.035), height, 0.0005), PLASTIC)
    expected = {20: 15547, 50: 10062, 100: 6164, 150: 3486, 200: 1230}
    for z, stiffness in expected.items():
        assert np.interp(z / 1000, height, found) == pytest.approx(stiffness, rel=0.002)
    assert np.isinf(found[0])


def test_the_sum_is_converged():
    height = np.linspace(0, 0.1, 41)
    shell = RevolutionShell(np.full(41, 0.03), height, 0.0006)
    few, many = (pinch_stiffness(shell, PLASTIC, harmonics=count)[3:] for count in (48, 160))
    # The tail n^-3 stands for what is left out; finer harmonics than the mesh are a little stiff.
    assert few == pytest.approx(many, rel=0.004)


def test_a_long_tube_is_the_same_from_both_ends():
    height = np.linspace(0, 0.1, 41)
    free = RevolutionShell(np.full(41, 0.03), height, 0.0006)
    turned = pinch_stiffness(RevolutionShell(np.full(41, 0.03), height[::-1], 0.0006), PLASTIC)
    assert pinch_stiffness(free, PLASTIC) == pytest.approx(turned, rel=1e-9)


@pytest.mark.parametrize("rim_held", [False, True])
def test_a_bottle_like_profile_against_triangles(rim_held):
    """Another discretisation and another theory of the same bottle, wall growing upwards."""
    z = np.linspace(0, 0.15, 61)
    radius = 0.03 + 0.008 * np.sin(z / 0.15 * np.pi) - 0.06 * z**2 / 0.15
    wall = 0.0005 + 0.002 * z
    series = pinch_stiffness(RevolutionShell(radius, z, wall, rim_held=rim_held), PLASTIC)
    around, along = 64, 60
    tube = tube_mesh(1.0, 0.15, 0.001, around=around, along=along)
    rings = tube.vertices_m[:, 2]
    vertices = tube.vertices_m * np.column_stack([np.interp(rings, z, radius)] * 2 + [np.ones(len(rings))])
    middle = vertices[tube.faces, 2].mean(axis=1)
    fixed = np.zeros((len(vertices), 6), dtype=bool)
    fixed[:around] = True
    fixed[-around:, :3] = rim_held
    mesh = ShellMesh(vertices, tube.faces, np.interp(middle, z, wall), tube.fraction)
    found = dual_tip_map(ShellModel(mesh, PLASTIC, fixed)).reshape(along + 1, around).mean(axis=1)
    # 3 mm triangles are within 1.5 % of the series away from the held edges.
    assert found[8:53] == pytest.approx(series[8:53], rel=0.015)


def test_what_cannot_be_is_refused():
    with pytest.raises(InputError, match=r"height_m: found shape \(4,\), expected finite numbers \(3,\)"):
        RevolutionShell(np.ones(3), np.arange(4.0), 0.001)
    with pytest.raises(InputError, match=r"radius_m: found \[1\.0, 0\.0, 1\.0\], expected more than 0"):
        RevolutionShell(np.array([1.0, 0, 1]), np.arange(3.0), 0.001)
    with pytest.raises(InputError, match="are the same"):
        RevolutionShell(np.ones(3), np.array([0.0, 0, 1]), 0.001)
    with pytest.raises(InputError, match="thickness_m"):
        RevolutionShell(np.ones(3), np.arange(3.0), -1.0)


def test_the_tangents_of_a_meridian_are_unit_vectors_along_it():
    """A hemisphere in five elements: the spline's parameter is the chord, which is a little shorter than the arc."""
    angle = np.linspace(0.2, 0.5 * np.pi, 6)
    tangent = _meridian(RevolutionShell(0.05 * np.sin(angle), -0.05 * np.cos(angle), 0.001))[-1]
    np.testing.assert_allclose(np.linalg.norm(tangent, axis=1), 1.0, rtol=1e-12)
    # A cubic spline of 15 degrees per element: the direction of the circle to a hundredth, at the ends to a few.
    np.testing.assert_allclose(tangent, np.column_stack([np.cos(angle), np.sin(angle)]), atol=0.04)
