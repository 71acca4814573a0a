"""Squeezes: stress compared with closed formulas, and evaluation of a curve."""

from __future__ import annotations

import inspect
import sys
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from benchmarks._shell_problems import grid_mesh

from visuohaptic.core import InputError
from visuohaptic.deformation.maps import (
    load_thickness_map,
    plot_squeeze,
    save_squeeze,
    squeeze,
    with_thickness_map,
)
from visuohaptic.deformation.shapes import ShellObject, WallProperties, load_object, tube_mesh
from visuohaptic.deformation.shells import IsotropicMaterial, surface_stress

MATERIAL = IsotropicMaterial(2.5e9, 0.38, "PET")


def test_a_tube_that_is_blown_up_has_hoop_stress() -> None:
    mesh = tube_mesh(0.035, 0.1, 0.0005, around=96, along=40, crossed=False)
    found = surface_stress(mesh, MATERIAL, mesh.vertices_m * [1.001, 1.001, 1.0])
    # Plane strain along the axis: s_x = E e / (1 - nu^2), s_z = nu s_x; the curvature adds t / 2R of e.
    stress = 2.5e9 * 1e-3 * (1 + 0.0005 / 2 / 0.035) / (1 - 0.38**2)
    expected = stress * np.sqrt(1 - 0.38 + 0.38**2)
    inner = (mesh.vertices_m[:, 2] > 0.01) & (mesh.vertices_m[:, 2] < 0.09)
    # Second order of the strain: 1e-3 / 2.
    np.testing.assert_allclose(found[inner], expected, rtol=2e-3)


def test_a_sheet_that_is_rolled_up_bends() -> None:
    """A flat sheet of 0.5 mm on a circle of 50 mm: a strain of t / 2R at its faces."""
    mesh = grid_mesh(lambda u, v: (0.05 * u, 0.05 * v, 0 * u), 40, 40, 0.0005)
    x, y, _z = mesh.vertices_m.T
    rolled = np.stack([0.05 * np.sin(x / 0.05), y, 0.05 * np.cos(x / 0.05)], axis=1)
    found = surface_stress(mesh, MATERIAL, rolled)
    stress = 2.5e9 * 0.0005 / 2 / 0.05 / (1 - 0.38**2)
    expected = stress * np.sqrt(1 - 0.38 + 0.38**2)
    inner = (np.abs(x - 0.025) < 0.02) & (np.abs(y - 0.025) < 0.02)
    # Facets of 1.4 degrees: the chord is 1e-4 shorter, which is 2 % of a strain of 5e-3.
    np.testing.assert_allclose(found[inner], expected, rtol=0.04)


def test_what_is_turned_is_not_stressed() -> None:
    mesh = tube_mesh(0.035, 0.1, 0.0005, around=48, along=20, crossed=False)
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    assert surface_stress(mesh, MATERIAL, mesh.vertices_m @ turn.T).max() < 1.0  # Pa, of 2.5e9


@pytest.fixture(scope="module")
def cup() -> ShellObject:
    return load_object("cup", around=24)


def test_a_small_squeeze_is_linear_and_elastic(cup: ShellObject) -> None:
    found = squeeze(cup, deformation_m=1e-4, points=2)
    secant = found.curve.force_N / found.curve.deformation_m
    np.testing.assert_allclose(secant, found.stiffness_N_per_m, rtol=0.05)
    assert found.linear_to_N == found.curve.force_N[-1]
    assert np.isnan(found.buckling_force_N)
    assert np.isnan(found.yield_force_N)
    assert found.stiffness_sigma_N_per_m > 0
    assert any("stays elastic" in remark for remark in found.remarks)


def test_yield_lies_where_the_stress_passes_the_strength() -> None:
    thick = load_object("cup", around=24, wall=WallProperties(thickness_m=0.0015))
    found = squeeze(thick, deformation_m=8e-3, points=6)
    assert found.yield_force_N > 0
    row = int(np.argmax(found.curve.stress_Pa > found.yield_stress_Pa))
    force = np.r_[0.0, found.curve.force_N]
    assert force[row] <= found.yield_force_N <= force[row + 1]


def test_curves_are_written(cup: ShellObject, tmp_path: Path) -> None:
    found = squeeze(cup, force_N=2.0, points=2, side="y+", height_m=0.05)
    np.testing.assert_allclose(found.curve.force_N, [1.0, 2.0], rtol=1e-3)
    save_squeeze(tmp_path / "curve.csv", found)
    table = np.genfromtxt(tmp_path / "curve.csv", delimiter=",", names=True)
    np.testing.assert_allclose(table["force_N"], [0, *found.curve.force_N])
    plot_squeeze(tmp_path / "curve.png", found)
    assert (tmp_path / "curve.png").stat().st_size > 5000


def test_the_plot_shows_the_curve_and_one_sigma_of_the_wall(
    cup: ShellObject, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, drawn = squeeze(cup, force_N=2.0, points=3), []
    monkeypatch.setattr(
        sys.modules[inspect.unwrap(squeeze).__module__],
        "save_figure",
        lambda path, figure: drawn.append(figure),
    )
    plot_squeeze("never written", found, "cup")
    (axes,) = drawn[0].axes
    force, linear = (line.get_xydata() for line in axes.lines[:2])
    np.testing.assert_allclose(
        force[1:], np.column_stack([1e3 * found.curve.deformation_m, found.curve.force_N])
    )
    np.testing.assert_allclose(force[0], 0.0)
    np.testing.assert_allclose(linear[:, 1], 1e-3 * found.stiffness_N_per_m * linear[:, 0])
    # The band at the last point: the force and one standard deviation of the wall's stiffness on both sides.
    (band,) = axes.collections
    corners = band.get_paths()[0].vertices
    last = np.sort(np.unique(corners[np.isclose(corners[:, 0], force[-1, 0]), 1]))
    spread = found.stiffness_sigma_N_per_m / found.stiffness_N_per_m
    np.testing.assert_allclose([last[0], last[-1]], force[-1, 1] * np.array([1 - spread, 1 + spread]))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"force_N": 1.0, "deformation_m": 1e-3}, "expected one of them"),
        ({"force_N": -1.0}, "more than 0"),
        ({"points": 1}, "2 to 100"),
        ({"height_m": 9.0}, "expected 0 to"),
        ({"point_m": [0, 0, float("nan")]}, "finite"),
    ],
)
def test_squeezes_that_make_no_sense_are_refused(
    words: dict[str, object], said: str, cup: ShellObject
) -> None:
    with pytest.raises(InputError, match=said):
        squeeze(cup, **words)


def test_a_profile_and_places_give_the_same_wall(cup: ShellObject, tmp_path: Path) -> None:
    height = np.linspace(0, cup.height_m, 60)
    (tmp_path / "z.csv").write_text(
        "z_m,thickness_m\n" + "\n".join(f"{z},{3e-4 + 2e-3 * z}" for z in height) + "\n"
    )
    points = cup.mesh.vertices_m
    (tmp_path / "xyz.csv").write_text(
        "x_m,y_m,z_m,thickness_m\n" + "\n".join(f"{x},{y},{z},{3e-4 + 2e-3 * z}" for x, y, z in points) + "\n"
    )
    middle = points[cup.mesh.faces].mean(axis=1)[:, 2]
    for name in ("z.csv", "xyz.csv"):
        found = with_thickness_map(cup, load_thickness_map(tmp_path / name), name)
        # Between places 8 mm apart the nearest three are within 4 mm of the middle: 8 um.
        np.testing.assert_allclose(found.mesh.thickness_m, 3e-4 + 2e-3 * middle, atol=8e-6)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        ("z,t\n0,1\n", "found columns z, t, expected z_m, thickness_m or"),
        ("z_m,thickness_m\n0,0.001\n1,x\n", "line 3, thickness_m: found 'x'"),
        ("z_m,thickness_m\n0,-1\n", "line 2"),
        ("z_m,thickness_m\n", "no rows"),
    ],
)
def test_broken_thickness_maps_are_refused(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "wall.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        load_thickness_map(path)


def test_a_map_in_another_unit_is_refused(cup: ShellObject) -> None:
    with pytest.raises(InputError, match=r"mm from the wall, which is"):
        with_thickness_map(cup, np.array([[0.0, 5e-4], [100.0, 4e-4]]), "wall.csv")


def test_a_face_takes_its_three_nearest_measurements_weighted_by_distance() -> None:
    cup = load_object("cup", around=16)
    middle = cup.mesh.vertices_m[cup.mesh.faces].mean(axis=1)
    out = np.array([0.0, 0.0, 1e-3])
    places = [middle[0] + step * out for step in (1.0, 2.0, 4.0, 8.0)]
    values = np.column_stack([places, [1e-3, 2e-3, 3e-3, 9e-3]])
    found = with_thickness_map(cup, values, "map")
    expected = np.dot([4.0, 2.0, 1.0], [1e-3, 2e-3, 3e-3]) / 7.0
    assert np.asarray(found.mesh.thickness_m)[0] == pytest.approx(expected)


@pytest.mark.parametrize(("part", "accepted"), [(0.23, True), (0.27, False)])
def test_a_measurement_is_within_a_quarter_of_the_height(part: float, accepted: bool) -> None:
    cup = load_object("cup", around=16)
    top_m = float(cup.mesh.vertices_m[cup.mesh.faces].mean(axis=1)[:, 2].max())
    values = np.array([[0.0, 1e-3], [top_m + part * cup.height_m, 1e-3]])
    with nullcontext() if accepted else pytest.raises(InputError, match="from the wall"):
        with_thickness_map(cup, values, "map")
