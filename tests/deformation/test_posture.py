"""Whether a mesh stands, which way up it is, and in which unit: inferred, or told with the price."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from visuohaptic.core import InputError
from visuohaptic.core.geometry import so3_exp
from visuohaptic.deformation.maps import object_map
from visuohaptic.deformation.shapes import (
    MeshConvention,
    ShellObject,
    grid_faces,
    import_container,
    tube_mesh,
)

trimesh = pytest.importorskip("trimesh")

HEIGHT_m = 0.12


def cup(*, floor: bool = True) -> trimesh.Trimesh:
    """A cone from 28 mm at its foot to 44 mm at its open rim."""
    tube = tube_mesh(0.028, HEIGHT_m, 0.0005, around=72, along=48, crossed=False)
    points = tube.vertices_m * (1 + np.outer(tube.vertices_m[:, 2], [4.8, 4.8, 0]))
    faces = tube.faces
    if floor:
        ring = np.arange(72)
        fan = np.stack([np.roll(ring, -1), ring, np.full(72, len(points))], axis=1)
        points, faces = np.concatenate([points, [[0, 0, 0]]]), np.concatenate([faces, fan])
    return trimesh.Trimesh(points, faces, process=False)


def turned(mesh: trimesh.Trimesh, degrees: float, axis: tuple[float, ...] = (1, 0.4, 0)) -> trimesh.Trimesh:
    vector = np.radians(degrees) * np.array(axis) / np.linalg.norm(axis)
    return trimesh.Trimesh(mesh.vertices @ so3_exp(vector).T, mesh.faces, process=False)


def imported(mesh: trimesh.Trimesh, folder: Path, convention: MeshConvention | None = None) -> ShellObject:
    mesh.export(folder / "cup.ply")
    return import_container(folder / "cup.ply", convention=convention)


def leant(container: ShellObject) -> list[str]:
    return [note for note in container.notes if "it leant by" in note]


@pytest.mark.parametrize("floor", [True, False])
@pytest.mark.parametrize("degrees", [0.5, 5.0, 14.0])
def test_a_container_that_leans_is_turned_onto_its_foot(degrees: float, floor: bool, tmp_path: Path) -> None:
    upright = imported(cup(floor=floor), tmp_path)
    found = imported(turned(cup(floor=floor), degrees), tmp_path)
    assert not leant(upright)
    assert f"it leant by {degrees:.2g} degrees" in leant(found)[0]
    # A PLY file has single precision, 4e-9 m at 0.12 m, which the turn adds up twice.
    away, vertex = cKDTree(found.mesh.vertices_m).query(upright.mesh.vertices_m)
    assert away.max() < 4e-8
    np.testing.assert_array_equal(found.fixed[vertex], upright.fixed)


def test_what_stands_is_left_as_it_is(tmp_path: Path) -> None:
    """An oblique cone on a level foot; and a foot that is level within a five-hundredth of the height."""
    oblique = cup()
    oblique.vertices = oblique.vertices + np.outer(oblique.vertices[:, 2], [0.15, 0, 0])
    assert not leant(imported(oblique, tmp_path))
    # Across the foot of 56 mm, 0.2 degrees are 0.2 mm; a five-hundredth of the height is 0.24 mm.
    assert not leant(imported(turned(cup(), 0.2), tmp_path))
    assert leant(imported(turned(cup(), 0.3), tmp_path))


def test_a_ragged_foot_does_not_make_an_upright_wall_lean(tmp_path: Path) -> None:
    """The lowest centimetre is cut off obliquely: it stands on the cut, by which the wall leans 8 degrees."""
    ragged = cup(floor=False)
    cut = ragged.vertices[:, 2] - 0.004 - 0.14 * ragged.vertices[:, 0]
    low = ragged.vertices[:, 2] < 0.01
    ragged.vertices[low, 2] -= np.where(low, cut, 0)[low] * np.clip(1 - ragged.vertices[low, 2] / 0.01, 0, 1)
    assert not leant(imported(ragged, tmp_path))


def test_a_cup_upside_down_is_told_with_its_price(tmp_path: Path) -> None:
    upright, over = cup(), turned(cup(), 180, (1, 0, 0))
    found = imported(over, tmp_path)
    note = next(note for note in found.notes if "its only opening is its foot" in note)
    price = float(re.search(r"is ([+-]\d+) %", note)[1]) / 100
    stiffness = []
    for mesh, up in ((over, "z"), (over, "-z"), (upright, "z")):
        made = object_map(imported(mesh, tmp_path, MeshConvention(up=up)), band=False)
        z = made.vertices_m[:, 2] - made.vertices_m[:, 2].min()
        stiffness.append(np.median(made.stiffness_N_per_m[np.abs(z - HEIGHT_m / 2) < 1e-6]))
    assert stiffness[1] == pytest.approx(stiffness[2], rel=1e-3)
    assert stiffness[1] / stiffness[0] - 1 == pytest.approx(price, abs=0.006)  # a percent is printed
    assert price < -0.2
    for mesh in (upright, cup(floor=False)):
        assert not any("only opening" in note for note in imported(mesh, tmp_path).notes)


@pytest.mark.parametrize(
    ("size_m", "said"),
    [
        (0.0254, "unit taken as cm: the largest extent is 4.724, 47.2 mm; it would be 472 mm with --unit dm, 120 mm with --unit in"),
        (0.001, "unit taken as mm: the largest extent is 120"),
    ],
)  # fmt: skip
def test_all_units_of_a_container_are_told(size_m: float, said: str, tmp_path: Path) -> None:
    assert said in imported(cup().apply_scale(1 / size_m), tmp_path).notes


def test_what_is_a_container_in_no_unit_is_refused(tmp_path: Path) -> None:
    # 4.7 km in metres, 4.7 m in millimetres: the only unit in which it is too small is none.
    with pytest.raises(InputError, match=r"no container in m, mm, cm, dm, in"):
        imported(cup().apply_scale(4e4), tmp_path)


def test_a_leaning_dish_without_a_steep_wall_is_refused(tmp_path: Path) -> None:
    """Its wall of 30 degrees tells no axis, so that it is not turned; its rim is not closed at one height."""
    turn, radius = np.arange(48) * 2 * np.pi / 48, np.linspace(0.03, 0.11, 5)[:, None]
    rings = [
        radius * np.cos(turn),
        radius * np.sin(turn),
        np.broadcast_to((radius - 0.03) / np.sqrt(3), (5, 48)),
    ]
    points = np.vstack([np.stack(rings, axis=-1).reshape(-1, 3), np.zeros(3)])
    fan = [[240, (k + 1) % 48, k] for k in range(48)]
    mesh = trimesh.Trimesh(points, [*grid_faces(48, 4, closed=True), *fan], process=False)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.radians(5.0), [1, 0, 0]))
    mesh.export(tmp_path / "dish.stl")
    with pytest.raises(InputError, match="is not closed around the axis"):
        import_container(tmp_path / "dish.stl")
