"""A mesh and a description of the same shape have the same stiffness; the mesh is generated independently."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from visuohaptic.deformation.maps import object_map, object_stiffness
from visuohaptic.deformation.maps.confidence_band import nearest_value
from visuohaptic.deformation.shapes import (
    ContainerDescription,
    WallProperties,
    import_container,
    mesh_container,
)
from visuohaptic.deformation.shells import opposing_points

trimesh = pytest.importorskip("trimesh")


def surface(
    foot: tuple[float, float], mouth: tuple[float, float], height: float, shift: float
) -> trimesh.Trimesh:
    """Vertices at equal angles of the ellipse (a description has them at equal lengths), one diagonal."""
    around, along = 104, 80
    angle, fraction = np.meshgrid(2 * np.pi * np.arange(around) / around, np.linspace(0, 1, along + 1))
    x = (foot[0] + (mouth[0] - foot[0]) * fraction) * np.cos(angle)
    y = (foot[1] + (mouth[1] - foot[1]) * fraction) * np.sin(angle) + shift * fraction
    row, column = (part.ravel() for part in np.mgrid[:along, :around])
    a, b = row * around + column, row * around + (column + 1) % around
    faces = np.concatenate(
        [np.stack([a, b, b + around], axis=1), np.stack([a, b + around, a + around], axis=1)]
    )
    points = np.stack([x, y, height * fraction], axis=2).reshape(-1, 3)
    return trimesh.Trimesh(points, faces, process=False)


@pytest.mark.parametrize(
    ("foot", "mouth", "height", "shift"),
    [
        ((0.040, 0.030), (0.030, 0.026), 0.15, 0.0),
        ((0.035, 0.035), (0.030, 0.030), 0.16, 0.020),
        ((0.040, 0.030), (0.035, 0.028), 0.15, -0.015),
    ],
)
def test_a_mesh_is_as_stiff_as_its_description(
    foot: tuple[float, float], mouth: tuple[float, float], height: float, shift: float, tmp_path: Path
) -> None:
    description = ContainerDescription.model_validate(
        {
            "base": {"shape": "ellipse", "radius": foot[0], "radius_y": foot[1]},
            "sections": [{"height": height, "radius": mouth[0], "radius_y": mouth[1], "shift": shift}],
            "wall": 0.0006,
        }
    )
    surface(foot, mouth, height, shift).export(tmp_path / "same.stl")
    described = object_map(mesh_container(description), band=False)
    container = import_container(tmp_path / "same.stl", wall=WallProperties(thickness_m=0.0006))
    imported = object_map(container, band=False)
    assert container.axis_point_m == pytest.approx((0, 0), abs=1e-5)
    for fraction in (0.25, 0.5, 0.75, 1.0):
        for angle in (0.0, 0.8, np.pi / 2, 3.0, -np.pi / 2):
            place = np.array(
                [
                    (foot[0] + (mouth[0] - foot[0]) * fraction) * np.cos(angle),
                    (foot[1] + (mouth[1] - foot[1]) * fraction) * np.sin(angle) + shift * fraction,
                    height * fraction,
                ]
            )
            one, other = (
                nearest_value(found.vertices_m, found.faces, found.stiffness_N_per_m, place)[0]
                for found in (described, imported)
            )
            assert other == pytest.approx(one, rel=0.015)


def test_a_tip_inside_a_face_is_a_point_as_well() -> None:
    """A round tube whose axis is put a little beside: the tip opposite then falls anywhere into a face."""
    tube = ContainerDescription.model_validate(
        {"base": {"radius": 0.035}, "sections": [{"height": 0.2}], "wall": 0.0005}
    )
    container = mesh_container(tube, around=48)
    z = container.mesh.vertices_m[:, 2]
    ring = np.flatnonzero(np.isclose(z, z[np.argmin(np.abs(z - 0.06))]))
    straight = opposing_points(container.mesh, ring)
    # By 1.1 mm the line through the axis turns by 1.8 degrees, half a cell is 3.75 degrees.
    beside = opposing_points(container.mesh, ring, axis_point_m=(0.0011, 0.0007))
    assert straight.weights.max(axis=1).min() == 1
    assert 0.4 < beside.weights.max(axis=1).min() < 0.7
    on, inside = (object_stiffness(container, tips, band=False)[0] for tips in (straight, beside))
    assert inside == pytest.approx(on, rel=0.02)
