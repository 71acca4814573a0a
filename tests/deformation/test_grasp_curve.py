"""Grasp curves of containers: parts against the whole, forces against deformations, other codes' tube."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.shell_nonlinear import PINCH

from visuohaptic.core import InputError
from visuohaptic.deformation.maps import PinchPlane, grasp_curve, object_stiffness, side_vertex
from visuohaptic.deformation.nonlinear import Contents
from visuohaptic.deformation.shapes import ContainerDescription, ShellObject, load_container, mesh_container
from visuohaptic.deformation.shells import IsotropicMaterial, ShellMesh, opposing_points


def shipped(name: str, around: int = 16) -> ShellObject:
    return mesh_container(load_container(name).middle(), around=around)


@pytest.mark.parametrize("contents", [None, Contents(fill=0.6)])
@pytest.mark.parametrize(
    ("name", "side", "copies"), [("elliptic", "y+", 4), ("cleaner", "x-", 2), ("cleaner", "y-", 2)]
)
def test_a_part_gives_the_curve_of_the_whole(
    name: str, side: str, copies: int, contents: Contents | None
) -> None:
    container = shipped(name)
    steps = [0.0005, 0.002, 0.004]
    part = grasp_curve(container, side=side, deformation_m=steps, contents=contents)
    whole = grasp_curve(container, side=side, deformation_m=steps, contents=contents, symmetric=False)
    assert (part.copies, whole.copies) == (copies, 1)
    assert part.complete
    assert whole.complete
    # Both stop at a residual of 1e-5 of the forces.
    np.testing.assert_allclose(part.force_N, whole.force_N, rtol=1e-4)
    np.testing.assert_allclose(part.first_m, whole.first_m, rtol=1e-4)
    np.testing.assert_allclose(part.second_m, whole.second_m, rtol=1e-4)
    np.testing.assert_allclose(part.gauge_Pa, whole.gauge_Pa, rtol=1e-3, atol=1.0)
    np.testing.assert_allclose(0.5 * (part.first_m + part.second_m), steps, rtol=1e-6)


def test_the_tube_of_other_codes() -> None:
    container = mesh_container(
        ContainerDescription.model_validate(
            {
                "base": {"radius": "35 mm"},
                "sections": [{"height": "200 mm"}],
                "wall": "0.5 mm",
            }
        ),
        around=48,
    )
    import dataclasses

    container = dataclasses.replace(container, material=IsotropicMaterial(2.5e9, 0.38))
    found = grasp_curve(container, deformation_m=[0.0005, 0.001, 0.0015, 0.002, 0.003, 0.0045, 0.006])
    assert found.copies == 4
    depth, force = np.r_[0, found.deformation_m], np.r_[0, found.force_N]
    for newton, millimetres in PINCH.items():
        # As for the quarter tube of test_nonlinear: straight lines between seven points.
        assert np.interp(millimetres / 1e3, depth, force) == pytest.approx(newton, rel=0.05)


def test_the_curve_starts_with_the_linear_stiffness() -> None:
    container = shipped("elliptic")
    vertex = side_vertex(container, "y+")
    tips = opposing_points(container.mesh, np.array([vertex]), axis_point_m=container.axis_point_m)
    for contents in (None, Contents(fill=0.5)):
        wanted = float(object_stiffness(container, tips, contents, band=False)[0][0])
        plane = PinchPlane(container, np.pi / 2)
        assert 1 / plane.linear(vertex, contents).mean() == pytest.approx(wanted, rel=1e-6)
        curve = plane.curve(vertex, deformation_m=[1e-6], contents=contents)
        assert curve.force_N[0] / 1e-6 == pytest.approx(wanted, rel=1e-3)
    mesh = container.mesh
    wall = ShellMesh(mesh.vertices_m, mesh.faces, 1.5 * np.asarray(mesh.thickness_m), mesh.fraction)
    thicker = replace(container, mesh=wall, material=container.material.stiffer(2))
    part = PinchPlane(container, np.pi / 2).part.with_wall(thicker, np.pi / 2)
    found = PinchPlane(thicker, np.pi / 2, part=part).linear(vertex)
    np.testing.assert_allclose(found, PinchPlane(thicker, np.pi / 2).linear(vertex), rtol=1e-9)


def test_forces_are_the_inverse_of_deformations() -> None:
    container = shipped("elliptic")
    there = grasp_curve(container, side="y+", deformation_m=[0.001, 0.003, 0.006])
    back = grasp_curve(container, side="y+", force_N=there.force_N.tolist())
    assert back.complete
    np.testing.assert_allclose(back.deformation_m, there.deformation_m, rtol=1e-3)


def test_more_liquid_is_stiffer_and_pressure_rises() -> None:
    container = shipped("elliptic")
    curves = [
        grasp_curve(container, side="y+", deformation_m=[0.003], contents=what)
        for what in (None, Contents(), Contents(fill=0.7), Contents(fill=0.95))
    ]
    force = [float(curve.force_N[0]) for curve in curves]
    assert force == sorted(force)
    assert curves[0].gauge_Pa[0] == 0
    assert 0 < curves[1].gauge_Pa[0] < curves[3].gauge_Pa[0]


def test_a_point_between_the_axes_needs_the_whole_unless_the_object_is_round() -> None:
    points = (0.03, 0.03, 0.1)
    assert grasp_curve(shipped("bottle"), point_m=points, deformation_m=[1e-4]).copies == 4
    assert grasp_curve(shipped("elliptic"), point_m=points, deformation_m=[1e-4]).copies == 1


def test_walls_that_would_touch_end_the_curve() -> None:
    container = mesh_container(
        ContainerDescription.model_validate(
            {
                "base": {"shape": "ellipse", "radius": "40 mm", "radius_y": "6 mm"},
                "sections": [{"height": "80 mm"}],
                "wall": "0.3 mm",
            }
        ),
        around=16,
    )
    found = grasp_curve(container, side="y+", height_m=0.06, deformation_m=[0.002, 0.004, 0.007])
    assert not found.complete
    assert "walls touch" in found.reason
    assert 0 < len(found.force_N) < 3


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"side": "z+"}, "expected one of"),
        ({"height_m": 9.0}, "expected 0 to"),
        ({"height_m": 0.0}, "the wall is clamped"),
        ({"point_m": (0.0, float("nan"), 0.0)}, "found NaN or infinity, expected finite numbers"),
        ({"deformation_m": [0.002, 0.001]}, "ascending"),
        ({"force_N": [-1.0]}, "> 0"),
        ({"deformation_m": []}, "found shape"),
    ],
)
def test_wrong_arguments_are_named(arguments: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        grasp_curve(shipped("bottle"), **arguments)
