"""Limits of imported meshes from both sides, with the geometry that each stands for."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.deformation import Contents
from visuohaptic.deformation.maps.curve_features import _close_to_an_end
from visuohaptic.deformation.shapes import mesh_repair
from visuohaptic.deformation.shapes.coverage import SAMPLES, _lid_area
from visuohaptic.deformation.shapes.import_mesh import _check_one_shell
from visuohaptic.deformation.shapes.mesh_repair import large_faces, why_not_as_it_is
from visuohaptic.deformation.shapes.resample import _bridged, _thin, _without_spikes
from visuohaptic.deformation.shapes.wall_properties import WallProperties, wall_thickness
from visuohaptic.io.meshes import inspect_mesh


def _tube(around: int, rise: float, rings: int = 40) -> Any:
    """A tube of isosceles triangles whose height is a multiple of their base."""
    base = 2.0 * np.pi * 0.03 / around
    row, column = (part.ravel() for part in np.mgrid[:rings, :around])
    angle = 2.0 * np.pi * (column + 0.5 * (row % 2)) / around
    points = np.column_stack([0.03 * np.cos(angle), 0.03 * np.sin(angle), row * rise * base])
    faces = []
    for k in range(rings - 1):
        for j in range(around):
            a, b = k * around + j, k * around + (j + 1) % around
            c, d = a + around, (k + 1) * around + (j + 1) % around
            faces += [(a, b, d), (a, d, c)] if k % 2 else [(a, b, c), (b, d, c)]
    return inspect_mesh(points, np.array(faces))


@pytest.mark.parametrize(("degrees", "said"), [(145.0, ""), (155.0, "obtuse")])
def test_triangles_of_a_shell_have_angles_up_to_150_degrees(degrees: float, said: str) -> None:
    reason = why_not_as_it_is(_tube(96, 0.5 / np.tan(np.radians(0.5 * degrees))))
    assert reason.startswith(said)
    assert bool(reason) == bool(said)


@pytest.mark.parametrize(("around", "said"), [(70, ""), (58, "too coarse")])
def test_a_wall_has_64_edges_around(around: int, said: str) -> None:
    """Triangles whose two longer sides are 1.1 times their base: the base is 1 / 1.1 of an edge."""
    reason = why_not_as_it_is(_tube(round(1.1 * around), np.sqrt(1.1**2 - 0.25)))
    assert reason.endswith(said)
    assert bool(reason) == bool(said)


@pytest.mark.parametrize(("side", "large"), [(1.35, False), (1.48, True)])
def test_a_single_triangle_is_as_large_as_half_a_square_on_an_edge(side: float, large: bool) -> None:
    """A square with the diagonal of one on an edge of the wall, which has 64 around, has twice its area."""
    edge = np.pi * 0.06 / 64
    corner = [
        [-0.03, -0.03, 0.0],
        [0.03, 0.03, 0.0],
        [0.0, 0.0, 0.1],
        [side * edge, 0.0, 0.1],
        [0.0, side * edge, 0.1],
    ]
    state: Any = SimpleNamespace(vertices=np.array(corner), faces=np.array([[2, 3, 4]]))
    assert large_faces(state) == large


def test_a_wall_that_is_moved_is_stiffer_by_four_thousandths() -> None:
    """Second moment of a strip about the axis from which its wavy middle deviates, by quadrature."""
    x, y = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 401)[:-1], (np.arange(400) + 0.5) / 400 - 0.5)
    moved = np.mean((y + mesh_repair.MOVED_FRACTION * np.sin(x)) ** 2) / np.mean(y**2) - 1.0
    assert moved == pytest.approx(0.004, abs=0.0008)


def test_the_pressure_outside_is_that_of_the_atmosphere() -> None:
    """101,325 Pa at sea level; weather and the first 300 m of height change it by 3 %. Air of one litre, compressed isothermally."""
    assert Contents().bulk_stiffness(1e-3) == pytest.approx(101_325 / 1e-3, rel=0.03)


def test_half_a_surface_is_known_to_half_a_per_cent() -> None:
    assert 0.5 / np.sqrt(SAMPLES) == pytest.approx(0.005, rel=0.08)


@pytest.mark.parametrize(("slope", "roof"), [(55.0, True), (65.0, False)])
def test_a_roof_is_flatter_than_60_degrees(slope: float, roof: bool) -> None:
    """One triangle in the uppermost tenth of the height, 2 cm wide and 8 mm deep."""
    back = 0.008 / np.tan(np.radians(slope))
    points = [
        [0.0, 0.0, 0.1],
        [0.02, 0.0, 0.1],
        [0.0, back, 0.092],
        [0.0, 0.0, 0.0],
        [0.01, 0.0, 0.0],
        [0.0, 0.01, 0.0],
    ]
    state: Any = SimpleNamespace(vertices=np.array(points), faces=np.array([[0, 1, 2], [3, 4, 5]]))
    assert (_lid_area(state, 0.1) > 0.0) == roof


@pytest.mark.parametrize(("ratio", "one_wall"), [(1.23, True), (1.27, False)])
def test_two_surfaces_within_a_quarter_of_the_radius_are_one_wall(ratio: float, one_wall: bool) -> None:
    """Where the second one is seen in half of the directions only."""
    first = np.full((1, 8), 0.03)
    pair = np.where(np.arange(8) < 4, ratio * first, np.inf)
    assert _thin(first, pair)[0, :4].all() == one_wall
    assert not _thin(first, pair)[0, 4:].any()


@pytest.mark.parametrize(("degrees", "closed"), [(56.25, True), (63.75, False)])
def test_a_hole_up_to_a_sixth_of_a_ring_is_bridged(degrees: float, closed: bool) -> None:
    radius = np.full((3, 96), 0.03)
    radius[1, : round(degrees / 360 * 96)] = np.inf
    heights = np.array([0.0, 0.05, 0.1])
    if closed:
        assert _bridged(radius, heights, "a.stl") == pytest.approx(np.full((3, 96), 0.03))
        return
    with pytest.raises(InputError, match="expected at most 60"):
        _bridged(radius, heights, "a.stl")


@pytest.mark.parametrize(("longer", "missed"), [(1.12, False), (1.18, True)])
def test_a_ray_a_sixth_longer_than_its_neighbours_has_missed_the_wall(longer: float, missed: bool) -> None:
    """A level of rays of a tube, 1 mm apart, through a slot of 15 degrees to something behind it."""
    radius, heights = np.full((9, 96), 0.03), np.arange(9) * 1e-3
    radius[4, :4] *= longer
    found, part = _without_spikes(radius, heights)
    assert np.isinf(found[4, :4]).all() == missed
    assert (part > 0.0) == missed


@pytest.mark.parametrize(("wall", "nested"), [(0.095, False), (0.105, True)])
def test_surfaces_a_tenth_of_the_radius_apart_are_two_shells(wall: float, nested: bool) -> None:
    inner = np.array([[-1, -1, 0.1], [1, -1, 0.1], [0, 1, 0.9]]) * [0.02, 0.02, 0.1]
    outer = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 1], [1, 1, 1]]) * [0.03, 0.03, 0.1]
    state: Any = SimpleNamespace(
        vertices=np.vstack([inner, outer]), faces=np.array([[0, 1, 2], [3, 4, 5], [4, 6, 5]])
    )
    found: Any = SimpleNamespace(
        low_m=0.0, high_m=0.1, double=True, wall_m=wall * 0.03,
        radius_m=lambda heights, around: np.full((len(heights), around), 0.03),
    )  # fmt: skip
    if not nested:
        _check_one_shell(state, found, "a.stl")
        return
    with pytest.raises(InputError):
        _check_one_shell(state, found, "a.stl")


def test_the_mesh_decides_within_two_cells_of_a_boundary() -> None:
    """Squares of 2 mm; points on the wall between rings are told, too."""
    n, step = 96, 2.0 * np.pi * 0.03 / 96
    row, column = (part.ravel() for part in np.mgrid[:20, :n])
    angle = 2.0 * np.pi * column / n
    points = np.column_stack([0.03 * np.cos(angle), 0.03 * np.sin(angle), row * step])
    at = np.arange(19 * n).reshape(19, n)
    right = np.roll(at, -1, axis=1)
    faces = np.concatenate(
        [np.stack(part, axis=-1).reshape(-1, 3) for part in ((at, right, at + n), (right, right + n, at + n))]
    )
    points = np.vstack([points, [[0.03, 0.0, 1.8 * step], [0.03, 0.0, 2.2 * step]]])
    body: Any = SimpleNamespace(
        mesh=SimpleNamespace(vertices_m=points), surface_faces=faces, axis_point_m=(0.0, 0.0)
    )
    near, far = _close_to_an_end(body)[-2:]
    assert "within two cells of the foot" in near
    assert far == ""


def test_a_mesh_of_one_surface_has_the_wall_that_the_page_states() -> None:
    page = (Path(__file__).parents[2] / "docs" / "deformation_containers.md").read_text(encoding="utf-8")
    stated = re.search(r"one surface gets ([\d.]+) mm with an uncertainty of (\d+) %", page)
    assert stated is not None
    thickness, spread, _ = wall_thickness(np.empty((0, 2)), np.nan, WallProperties())
    assert thickness[0, 1] == pytest.approx(1e-3 * float(stated[1]))
    assert spread == pytest.approx(1e-2 * float(stated[2]))
