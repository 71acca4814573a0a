"""What a mesh is judged by, how thick its wall is, and how much of it is a container.

The meshes are made here, by formulas of their own; stiffness is held against the Fourier series of the Koiter
shell, which shares no element and no mesh with what is tested.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from tests.worlds.shell_meshes import mesh_case

from visuohaptic.core import InputError
from visuohaptic.deformation.maps import object_map
from visuohaptic.deformation.maps.confidence_band import nearest_value
from visuohaptic.deformation.shapes import (
    MeshConvention,
    ShellObject,
    WallProperties,
    clamped_foot,
    import_container,
    why_not_as_it_is,
)
from visuohaptic.deformation.shapes.resample import find_wall
from visuohaptic.deformation.shells import RevolutionShell, dual_tip_map, opposing_points, pinch_stiffness
from visuohaptic.io.meshes import inspect_mesh

trimesh = pytest.importorskip("trimesh")

RADIUS_m, WALL_m = 0.035, 0.0005


def revolved(
    radius: np.ndarray, height: np.ndarray, around: int = 96, *, stagger: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Rings of vertices; staggered ones are turned by half a cell, which makes their triangles isosceles."""
    rows, k = len(radius), np.arange(around)
    angle = 2 * np.pi * (k + 0.5 * (np.arange(rows)[:, None] % 2) * stagger) / around
    level = np.broadcast_to(height[:, None], angle.shape)
    points = np.stack([radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle), level], axis=2)
    faces = []
    for row in range(rows - 1):
        a, b = row * around + k, row * around + (k + 1) % around
        c, d = a + around, b + around
        if stagger and row % 2:
            faces += [np.stack([a, d, c], axis=1), np.stack([a, b, d], axis=1)]
        elif stagger:
            faces += [np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)]
        else:
            faces += [np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)]
    return points.reshape(-1, 3), np.concatenate(faces)


def pot(*, groove_m: float, foot: bool, top: bool) -> trimesh.Trimesh:
    """As CAD revolves it: a foot of long needles and a fan, perhaps a groove and a flat top that is a fan."""
    height = np.linspace(0, 0.11, 45)
    from_groove = np.clip((height - 0.055) / 0.0125, -1, 1)
    points, faces = revolved(RADIUS_m - groove_m * 0.5 * (1 + np.cos(np.pi * from_groove)), height)
    ring = np.arange(96)
    parts = [faces]
    if foot:
        for fraction in (0.5, 0.1):
            inner = len(points) + np.arange(96)
            points = np.concatenate([points, points[:96] * [fraction, fraction, 1]])
            after, beside = np.roll(inner, -1), np.roll(ring, -1)
            parts += [np.stack([ring, inner, after], axis=1), np.stack([ring, after, beside], axis=1)]
            ring = inner
        parts.append(np.stack([np.roll(ring, -1), ring, np.full(96, len(points))], axis=1))
        points = np.concatenate([points, [[0, 0, 0]]])
    if top:
        rim = 44 * 96 + np.arange(96)
        parts.append(np.stack([rim, np.roll(rim, -1), np.full(96, len(points))], axis=1))
        points = np.concatenate([points, [[0, 0, 0.11]]])
    return trimesh.Trimesh(points, np.concatenate(parts), process=False)


def stiffness_at(container: ShellObject, heights_m: tuple[float, ...]) -> np.ndarray:
    """Median of the ring of vertices of the wall nearest to each height [N/m]."""
    points = container.mesh.vertices_m
    outer = np.hypot(points[:, 0], points[:, 1]) > 0.8 * RADIUS_m
    found = []
    for height in heights_m:
        level = points[outer, 2][np.abs(points[outer, 2] - height).argmin()]
        ring = np.flatnonzero(outer & (np.abs(points[:, 2] - level) < 1e-6))[::8]
        tips = opposing_points(container.mesh, ring, axis_point_m=container.axis_point_m)
        found.append(np.median(dual_tip_map(container.model(), tips)))
    return np.array(found)


@pytest.mark.parametrize("remesh", ["auto", "never"])
@pytest.mark.parametrize(("groove_m", "top"), [(0.0, False), (0.0015, False), (0.0015, True)])
def test_a_clamped_foot_of_slivers_changes_nothing(
    groove_m: float, top: bool, remesh: str, tmp_path: Path
) -> None:
    heights = (0.03, 0.055, 0.08)
    meshes = [pot(groove_m=groove_m, foot=foot, top=top) for foot in (True, False)]
    found = []
    for number, mesh in enumerate(meshes):
        mesh.export(tmp_path / f"{number}.ply")
        container = import_container(
            tmp_path / f"{number}.ply",
            wall=WallProperties(thickness_m=WALL_m),
            convention=MeshConvention(remesh=remesh),
        )
        away, _ = cKDTree(container.mesh.vertices_m).query(mesh.vertices)
        # A PLY file has single precision: 4e-9 m at 0.11 m.
        # The fan of a top carries load: its needles, as long as the radius, are divided unless that is forbidden, and the
        # narrow ones about its middle are contracted.
        divided = top and remesh == "auto"
        assert np.count_nonzero(away > 1e-8) <= divided
        assert (len(container.mesh.vertices_m) > len(mesh.vertices)) == divided
        found.append(stiffness_at(container, heights))
    # Triangles with three clamped corners have no stiffness: all that differs is rounding.
    np.testing.assert_allclose(found[0], found[1], rtol=1e-6)


@pytest.mark.parametrize("seed", [0, 2])
def test_64_edges_around_are_fine_enough_whatever_their_diagonals(seed: int, tmp_path: Path) -> None:
    case = mesh_case("64 edges around", seed)
    trimesh.Trimesh(case.vertices_m, case.faces, process=False).export(tmp_path / "mesh.ply")
    wall = WallProperties(
        thickness_m=case.wall_m, youngs_modulus_Pa=case.youngs_modulus_Pa, poisson_ratio=case.poisson_ratio
    )
    container = import_container(tmp_path / "mesh.ply", wall=wall)
    assert len(container.mesh.faces) == len(case.faces)
    found = object_map(container, band=False)
    surface = found.vertices_m, found.faces, found.stiffness_N_per_m
    stiffness = [nearest_value(*surface, point)[0] for point in case.points_m]
    # With halved diagonals, 1.2 and 1.7 % wrong.
    np.testing.assert_allclose(stiffness, case.stiffness_N_per_m, rtol=0.007)


def test_a_grooved_pot_with_a_foot_of_slivers_is_as_stiff_as_the_series(tmp_path: Path) -> None:
    pot(groove_m=0.0015, foot=True, top=False).export(tmp_path / "pot.ply")
    container = import_container(tmp_path / "pot.ply", wall=WallProperties(thickness_m=WALL_m))
    height = np.linspace(0, 0.11, 441)
    from_groove = np.clip((height - 0.055) / 0.0125, -1, 1)
    shell = RevolutionShell(RADIUS_m - 0.00075 * (1 + np.cos(np.pi * from_groove)), height, WALL_m)
    expected = pinch_stiffness(shell, container.material)[[120, 220, 320]]
    # Cells of 2.3 by 2.5 mm: 2 % on a plain tube, and ten cells across the groove.
    np.testing.assert_allclose(stiffness_at(container, (0.03, 0.055, 0.08)), expected, rtol=0.05)


def test_a_mesh_of_many_triangles_is_simplified_and_keeps_its_groove(tmp_path: Path) -> None:
    """200,000 triangles; rings 2.3 mm apart would lose a tenth of the groove, and all the rim's height."""
    height = np.linspace(0, 0.11, 250)
    dent = 0.001 * np.exp(-(((height - 0.055) / 0.0015) ** 2))
    points, faces = revolved(RADIUS_m - dent, height, 400)
    trimesh.Trimesh(points, faces, process=False).export(tmp_path / "fine.stl")
    container = import_container(tmp_path / "fine.stl", wall=WallProperties(thickness_m=WALL_m))
    assert any("triangles became" in note for note in container.notes)
    assert len(container.mesh.faces) < 50_000
    found = container.mesh.vertices_m
    assert found[:, 2].max() == pytest.approx(0.11, abs=1e-6)
    radius = np.hypot(found[:, 0], found[:, 1])
    # The surface moves by a fortieth of the wall at most, as a root mean square over the planes that were replaced.
    away = radius - np.interp(found[:, 2], height, RADIUS_m - dent)
    assert np.abs(away).max() < 3 * 0.025 * WALL_m
    assert radius.min() == pytest.approx(RADIUS_m - 0.001, abs=3 * 0.025 * WALL_m)
    fine = np.linspace(0, 0.11, 881)
    shell = RevolutionShell(RADIUS_m - 0.001 * np.exp(-(((fine - 0.055) / 0.0015) ** 2)), fine, WALL_m)
    expected = pinch_stiffness(shell, container.material)
    used = (found[:, 2] > 0.02) & (found[:, 2] < 0.09)
    stiffness = dual_tip_map(container.model(), opposing_points(container.mesh, np.flatnonzero(used)))
    # Element sizes of 2 mm: 1 % each, unstructured; the median of all is the mesh's own error.
    error = stiffness / np.interp(found[used, 2], fine, expected) - 1
    assert abs(float(np.median(error))) < 0.02
    assert np.percentile(np.abs(error), 90) < 0.05


@pytest.mark.parametrize("sections", [32, 64])
def test_a_coarse_cylinder_is_as_stiff_as_a_round_one(sections: int, tmp_path: Path) -> None:
    """One row of facets over the whole height, and caps that are fans."""
    mesh = trimesh.creation.cylinder(radius=RADIUS_m, height=0.15, sections=sections)
    mesh.export(tmp_path / "can.stl")
    container = import_container(tmp_path / "can.stl", wall=WallProperties(thickness_m=WALL_m), open_top=True)
    shell = RevolutionShell(np.full(601, RADIUS_m), np.linspace(0, 0.15, 601), WALL_m)
    expected = pinch_stiffness(shell, container.material)[300]
    points = container.mesh.vertices_m
    middle = np.flatnonzero(np.abs(points[:, 2] - (points[:, 2].min() + 0.075)) < 0.003)
    found = np.median(dual_tip_map(container.model(), opposing_points(container.mesh, middle)))
    # Cells of 4 mm: 2 %; the facets themselves, of 7 mm, would be some 10 % too stiff or too soft.
    assert found == pytest.approx(expected, rel=0.03)


def test_the_foot_of_a_coarse_tray_is_as_round_as_its_wall(tmp_path: Path) -> None:
    """48 facets on a flat foot: chords of the foot below arcs of the wall would be waves of half its thickness."""
    height = np.linspace(0, 0.025, 8)
    points, faces = revolved(0.12 + 0.4 * height, height, 48)
    ring = np.arange(48)
    faces = np.concatenate([faces, np.stack([np.roll(ring, -1), ring, np.full(48, len(points))], axis=1)])
    tray = trimesh.Trimesh(np.concatenate([points, [[0.0, 0.0, 0.0]]]), faces, process=False)
    tray.export(tmp_path / "tray.stl")
    container = import_container(tmp_path / "tray.stl", wall=WallProperties(thickness_m=WALL_m))
    found = container.mesh.vertices_m
    reach = np.hypot(found[:, 0], found[:, 1])
    away = (reach - 0.12 - 0.4 * found[:, 2])[reach > 0.06]
    # A chord of a 48th is 0.26 mm inside; waves of 12.5 um make the wall 0.4 % stiffer.
    assert np.abs(away).max() < 0.025 * WALL_m
    assert len(away) > 2 * 48


def test_sampling_anew_is_asked_for_and_priced(tmp_path: Path) -> None:
    pot(groove_m=0.0015, foot=True, top=False).export(tmp_path / "pot.ply")
    wall = WallProperties(thickness_m=WALL_m)
    given = import_container(tmp_path / "pot.ply", wall=wall)
    cast = import_container(tmp_path / "pot.ply", wall=wall, convention=MeshConvention(remesh="cast"))
    assert not any("resampling on rings" in note for note in given.notes)
    note = next(note for note in cast.notes if "resampling on rings" in note)
    price = float(note.split("up to ")[1].split(" %")[0]) / 100
    heights = (0.03, 0.055, 0.08)
    difference = stiffness_at(cast, heights) / stiffness_at(given, heights) - 1
    # Both meshes have errors of about a percent of their own.
    assert np.abs(difference).max() < price + 0.02


def test_what_cannot_be_repaired_names_the_way_out(tmp_path: Path) -> None:
    mesh = pot(groove_m=0.0, foot=False, top=False)
    centre = mesh.triangles_center
    cut = np.abs(centre[:, 2] - 0.06) < 0.004
    trimesh.Trimesh(mesh.vertices, mesh.faces[~cut], process=False).export(tmp_path / "two.ply")
    with pytest.raises(InputError, match=r"2 disconnected parts; repair it, .* with --remesh cast"):
        import_container(tmp_path / "two.ply")
    assert import_container(tmp_path / "two.ply", convention=MeshConvention(remesh="cast")).height_m > 0.1


def test_a_punt_is_joined_to_the_wall_by_the_foot(tmp_path: Path) -> None:
    """Two rings of the foot are clamped: what carries load is the wall and the raised middle, apart from each other."""
    height = np.concatenate([[0, 0.0001, 0.0002], np.linspace(0.003, 0.11, 44)])
    points, faces = revolved(
        np.full(47, RADIUS_m) - 0.004 * (height < 0.0003) * (0.0003 - height) / 3e-4, height
    )
    k = np.arange(96)
    fan = np.stack([np.roll(k, -1), k, np.full(96, len(points))], axis=1)
    points = np.concatenate([points, [[0, 0, 0.006]]])
    trimesh.Trimesh(points, np.concatenate([faces, fan]), process=False).export(tmp_path / "punt.ply")
    wall = WallProperties(thickness_m=WALL_m)
    as_it_is = import_container(tmp_path / "punt.ply", wall=wall, convention=MeshConvention(remesh="never"))
    assert len(as_it_is.mesh.vertices_m) == len(points)
    assert any(note.startswith("96 load-bearing triangles are coarse") for note in as_it_is.notes)
    container = import_container(tmp_path / "punt.ply", wall=wall)
    # Rings .1 mm apart within the foot are contracted where the fan is divided. Cells of 2.4 mm: 2 %.
    np.testing.assert_allclose(
        stiffness_at(container, (0.03, 0.08)), stiffness_at(as_it_is, (0.03, 0.08)), rtol=0.02
    )


def test_a_hole_is_closed_as_round_as_the_wall(tmp_path: Path) -> None:
    mesh = pot(groove_m=0.0, foot=False, top=False)
    away = np.linalg.norm(mesh.triangles_center - [RADIUS_m, 0, 0.07], axis=1)
    trimesh.Trimesh(mesh.vertices, mesh.faces[away > 0.007], process=False).export(tmp_path / "hole.ply")
    container = import_container(tmp_path / "hole.ply", wall=WallProperties(thickness_m=WALL_m))
    assert any("1 holes of up to" in note for note in container.notes)
    points = container.mesh.vertices_m
    filled = np.linalg.norm(points - [RADIUS_m, 0, 0.07], axis=1) < 0.007
    assert np.count_nonzero(filled) > 8
    # The flat chord of this hole is 0.7 mm inside the wall.
    assert np.abs(np.hypot(*points[filled, :2].T) - RADIUS_m).max() < 0.0002


def test_right_angled_needles_are_used_and_right(tmp_path: Path) -> None:
    """Needles of 9 degrees: what spoils a triangle is a large angle, not a small one."""
    points, faces = revolved(np.full(140, RADIUS_m), np.linspace(0, 0.05, 140))
    trimesh.Trimesh(points, faces, process=False).export(tmp_path / "needles.ply")
    container = import_container(tmp_path / "needles.ply", wall=WallProperties(thickness_m=WALL_m))
    assert len(container.mesh.vertices_m) == len(points)
    shell = RevolutionShell(np.full(140, RADIUS_m), np.linspace(0, 0.05, 140), WALL_m)
    expected = pinch_stiffness(shell, container.material)[70]
    # Right-angled cells of 96 facets round: 1 to 2 %.
    assert stiffness_at(container, (0.05 * 70 / 139,))[0] == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize(("spacing_m", "coarse"), [(0.0022, True), (0.001, False)])
def test_triangles_that_are_too_long_for_a_shoulder_are_said(
    spacing_m: float, coarse: bool, tmp_path: Path
) -> None:
    """A round bottle, by its Fourier series: 6.6 and 1.7 % wrong."""

    def radius(height: np.ndarray) -> np.ndarray:
        along = np.clip((height - 0.08) / 0.02, 0, 1)
        return np.asarray(0.033 - 0.018 * (3 * along**2 - 2 * along**3))

    height, fine = np.linspace(0, 0.12, round(0.12 / spacing_m) + 1), np.linspace(0, 0.12, 481)
    points, faces = revolved(radius(height), height)
    trimesh.Trimesh(points, faces, process=False).export(tmp_path / "bottle.ply")
    container = import_container(tmp_path / "bottle.ply", wall=WallProperties(thickness_m=0.00041))
    assert len(container.mesh.vertices_m) == len(points)
    vertices = container.mesh.vertices_m
    column = np.flatnonzero((vertices[:, 0] > 0) & (np.abs(vertices[:, 1]) < 1e-9))
    column = column[(vertices[column, 2] > 0.03) & (vertices[column, 2] < 0.11)][::3]
    tips = opposing_points(container.mesh, column, axis_point_m=container.axis_point_m)
    series = pinch_stiffness(RevolutionShell(radius(fine), fine, 0.00041), container.material)
    found = dual_tip_map(container.model(), tips) / np.interp(vertices[column, 2], fine, series)
    assert (np.abs(found - 1).max() > 0.025) == coarse
    assert any("near a shoulder" in note for note in container.notes) == coarse


@pytest.mark.parametrize(("cell", "refused"), [(0.18, False), (0.08, True)])
def test_obtuse_triangles_of_the_wall_are_not_used(cell: float, refused: bool) -> None:
    """Isosceles, 140 and 162 degrees: by the series the second are up to 80 % too stiff."""
    height = cell * 2 * np.pi * RADIUS_m / 64
    points, faces = revolved(np.full(60, RADIUS_m), height * np.arange(60), 64, stagger=True)
    said = why_not_as_it_is(inspect_mesh(points, faces))
    assert ("obtuse triangles" in said) == refused
    assert bool(said) == refused


def two_sided(
    radius: np.ndarray,
    height: np.ndarray,
    normal: tuple[float, float],
    thickness_m: float,
    noise_m: float = 0.0,
) -> trimesh.Trimesh:
    """Both sides of a wall and the ring between them at its mouth; the floor is left out."""
    rng = np.random.default_rng(3)
    sides = []
    for sign in (1, -1):
        r, z = (
            values + sign * 0.5 * thickness_m * part
            for values, part in zip((radius, height), normal, strict=True)
        )
        points, faces = revolved(r, z)
        points[:, :2] *= 1 + rng.normal(0, noise_m, (len(points), 1)) / np.hypot(*points[:, :2].T)[:, None]
        sides.append(trimesh.Trimesh(points, faces[:, ::sign], process=False))
    return trimesh.util.concatenate(sides)


def test_an_uneven_floor_is_no_part_of_the_wall(tmp_path: Path) -> None:
    """A cup of 40 mm on a floor that is tilted by 1.5 mm: rays through it meet the floor on one side and the wall on the other."""
    height, ring = np.linspace(0, 0.08, 60), np.arange(96)
    outer, outside = revolved(np.full(60, 0.04), height)
    inner, inside = revolved(np.full(60, 0.038), height)
    low = 0.003 + 0.0015 * inner[:96, 0] / 0.038
    inner[:, 2] = np.tile(low, 60) + (0.08 - np.tile(low, 60)) * np.repeat(height, 96) / 0.08
    after, top, bottom = np.roll(ring, -1), 59 * 96 + ring, len(outer) + ring
    beside = np.roll(top, -1)
    count = 2 * len(outer)
    faces = [
        outside, inside[:, ::-1] + len(outer), np.stack([after, ring, np.full(96, count)], axis=1),
        np.stack([bottom, np.roll(bottom, -1), np.full(96, count + 1)], axis=1),
        np.stack([top, beside, beside + len(outer)], axis=1), np.stack([top, beside + len(outer), top + len(outer)], axis=1),
    ]  # fmt: skip
    points = np.concatenate([outer, inner, [[0, 0, 0], [0, 0, 0.003]]])
    trimesh.Trimesh(points, np.concatenate(faces), process=False).export(tmp_path / "cup.stl")
    cup = import_container(tmp_path / "cup.stl", wall=WallProperties(material="PP"))
    foot = cup.mesh.vertices_m[cup.mesh.vertices_m[:, 2] < cup.mesh.vertices_m[:, 2].min() + 1e-6]
    # The middle of the wall is at 39 mm; facets of a 96th are 0.02 mm inside.
    np.testing.assert_allclose(np.hypot(foot[:, 0], foot[:, 1]), 0.039, atol=5e-5)
    np.testing.assert_allclose(cup.axis_point_m, 0.0, atol=1e-4)
    assert any(note.startswith("the solid foot, 4.") for note in cup.notes)


def test_a_measured_wall_is_used(tmp_path: Path) -> None:
    two_sided(np.full(60, RADIUS_m), np.linspace(0, 0.15, 60), (1, 0), 0.002).export(tmp_path / "jar.ply")
    container = import_container(tmp_path / "jar.ply")
    # The distance between two facets of 96 is cos(pi / 96) of that between their circles: 0.05 %.
    np.testing.assert_allclose(container.mesh.thickness_m, 0.002, rtol=0.002)
    assert container.wall_spread < 0.01
    assert any("as thick as measured: 2 mm ± 0.0" in note for note in container.notes)
    shell = RevolutionShell(np.full(301, RADIUS_m), np.linspace(0, 0.15, 301), 0.002)
    expected = pinch_stiffness(shell, container.material)[150]
    # Facets 1.5 %, and the nearest ring is within 1.2 mm of half height: 0.5 %. At 0.5 mm it would be a 16th.
    assert stiffness_at(container, (0.075,))[0] == pytest.approx(expected, rel=0.03)


def test_a_slanted_wall_is_measured_along_its_normal(tmp_path: Path) -> None:
    """At 45 degrees the surfaces are 2.8 mm apart along a horizontal ray."""
    radius = np.linspace(0.03, 0.08, 40)
    mesh = two_sided(radius, radius - 0.03, (0.5**0.5, -(0.5**0.5)), 0.002)
    mesh.export(tmp_path / "bowl.ply")
    container = import_container(tmp_path / "bowl.ply", open_top=True)
    # The middle is taken horizontally: on a cone that is exact up to the facets, at the ends one row is cut.
    assert np.median(container.mesh.thickness_m) == pytest.approx(0.002, rel=0.02)


def test_the_noise_of_a_scan_is_the_uncertainty_of_its_wall(tmp_path: Path) -> None:
    mesh = two_sided(np.full(60, RADIUS_m), np.linspace(0, 0.15, 60), (1, 0), 0.002, noise_m=1e-4)
    mesh.export(tmp_path / "scan.ply")
    container = import_container(tmp_path / "scan.ply")
    # Two surfaces: 0.14 of 2 mm, 7 % at a vertex. Between three vertices a facet averages down to 1 / sqrt(3) of it.
    assert 0.07 / 3**0.5 * 0.9 < container.wall_spread < 0.07 * 1.1
    assert np.median(container.mesh.thickness_m) == pytest.approx(0.002, rel=0.01)


def test_a_thickness_given_wins_and_a_contradiction_is_said(tmp_path: Path) -> None:
    two_sided(np.full(60, RADIUS_m), np.linspace(0, 0.15, 60), (1, 0), 0.002).export(tmp_path / "jar.ply")
    for given, contradicts in ((0.0005, True), (0.0021, False)):
        container = import_container(tmp_path / "jar.ply", wall=WallProperties(thickness_m=given))
        np.testing.assert_allclose(container.mesh.thickness_m, given, rtol=1e-12)
        assert any("contradicts the mesh, 2 mm" in note for note in container.notes) == contradicts
        assert container.wall_spread == pytest.approx(0.1)


def with_boards(width: float) -> tuple[trimesh.Trimesh, float]:
    """A tube and a board that stands off it on either side, and the fraction of their area that is the tube's."""
    tube = trimesh.Trimesh(*revolved(np.full(60, RADIUS_m), np.linspace(0, 0.15, 60)), process=False)
    boards = [trimesh.creation.box((width, 0.004, 0.14)) for _ in range(2)]
    for board, sign in zip(boards, (1, -1), strict=True):
        board.apply_translation([sign * (RADIUS_m + 0.008 + width / 2), 0, 0.075])
    whole = trimesh.util.concatenate([tube, *boards])
    return whole, tube.area / whole.area


def test_how_much_of_a_mesh_is_a_container_is_said(tmp_path: Path) -> None:
    mesh, fraction = with_boards(0.02)
    mesh.export(tmp_path / "handle.ply")
    note = next(
        note for note in import_container(tmp_path / "handle.ply").notes if "of the surface of" in note
    )
    assert float(note.split()[0]) == pytest.approx(100 * fraction, abs=2)


def test_what_is_mostly_no_container_is_refused(tmp_path: Path) -> None:
    mesh, fraction = with_boards(0.1)
    assert fraction < 0.4
    mesh.export(tmp_path / "drill.ply")
    said = rf"only {100 * fraction:.0f} % of its surface is wall, foot or lid of a container"
    with pytest.raises(InputError, match=said):
        import_container(tmp_path / "drill.ply")


def test_the_nearest_point_may_be_inside_a_large_triangle() -> None:
    """A dozen vertices are nearer than the corners of the triangle that the point is close to."""
    large = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 2, 0]])
    angle = 2 * np.pi * np.arange(12) / 12
    points = np.concatenate(
        [large, np.stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), 0 * angle + 0.1], axis=1)]
    )
    faces = np.array([[0, 1, 2], *([3 + k, 3 + (k + 1) % 12, 3 + (k + 2) % 12] for k in range(12))])
    values = np.concatenate([[5.0, 5.0, 5.0], np.full(12, 9.0)])
    value, place = nearest_value(points, faces, values, np.array([0.0, 0.0, 0.01]))
    assert value == pytest.approx(5.0)
    assert place == pytest.approx([0, 0, 0], abs=1e-12)


@pytest.mark.data
def test_the_walls_of_real_meshes_are_measured(data: Path) -> None:
    folder = data / "deformation" / "meshes"
    glass = import_container(folder / "pr_ordata" / "glass.stl")
    # Drawn as a straight taper, from 3.1 mm above its foot to 0.8 mm at the rim, 0.16 m higher.
    assert any("as thick as measured: 1.95 mm" in note for note in glass.notes)
    assert np.max(glass.mesh.thickness_m) == pytest.approx(0.0031, rel=0.03)
    assert np.min(glass.mesh.thickness_m) == pytest.approx(0.00085, rel=0.05)


def test_an_uneven_wall_is_measured_round_it(tmp_path: Path) -> None:
    """The bore is 0.5 mm off the middle of a tube of 2 mm: 1.5 to 2.5 mm."""
    height = np.linspace(0, 0.15, 60)
    outer, faces = revolved(np.full(60, RADIUS_m + 0.001), height)
    inner, _ = revolved(np.full(60, RADIUS_m - 0.001), height)
    inner[:, 0] += 0.0005
    sides = [
        trimesh.Trimesh(outer, faces, process=False),
        trimesh.Trimesh(inner, faces[:, ::-1], process=False),
    ]
    trimesh.util.concatenate(sides).export(tmp_path / "bored.ply")
    container = import_container(tmp_path / "bored.ply")
    middle = container.mesh.vertices_m[container.mesh.faces].mean(axis=1) - [*container.axis_point_m, 0]
    cosine = middle[:, 0] / np.hypot(middle[:, 0], middle[:, 1])
    # Of first order in the offset; the second is 0.5^2 / 35 / 2 = 4e-3 mm, facets 1e-3.
    np.testing.assert_allclose(container.mesh.thickness_m, 0.002 - 0.0005 * cosine, atol=2e-5)
    assert container.wall_spread < 0.01


def ball_on_a_stem(kind: str) -> trimesh.Trimesh:
    """Bodies of revolution, closed by fans; a bulb, and bottles with a cap, with a small one and with a nozzle, and a pin."""
    profiles = {
        "bulb": [(0.0135, 0.0), (0.0135, 0.045)]
        + [(0.032 * np.sin(t), 0.075 - 0.032 * np.cos(t)) for t in np.linspace(0.45, np.pi - 0.02, 60)],
        "bottle": [(0.03, 0.0), (0.03, 0.12), (0.012, 0.16), (0.012, 0.18)],
        "oil bottle": [(0.03, 0.0), (0.03, 0.12), (0.008, 0.16), (0.008, 0.2)],
        # Of the nozzle's end 50 mm2 are level; a ball as wide as the body would have 190.
        "mustard": [(0.045, 0.0), (0.045, 0.13), (0.012, 0.165), (0.006, 0.19), (0.004, 0.191)],
        "pin": [(0.03, 0.0), (0.03, 0.12), (0.012, 0.16)]
        + [(0.02 * np.sin(t), 0.176 - 0.02 * np.cos(t)) for t in np.linspace(0.65, np.pi - 0.02, 60)],
        "mushroom": [(0.02, 0.0), (0.02, 0.08), (0.05, 0.0802), (0.05, 0.12)],
    }
    corners = np.array(profiles[kind])
    along = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    fine = np.linspace(0, along[-1], 80)
    points, faces = revolved(np.interp(fine, along, corners[:, 0]), np.interp(fine, along, corners[:, 1]), 64)
    ring, last, ends = np.arange(64), len(points) - 64 + np.arange(64), len(points)
    points = np.concatenate([points, [[0, 0, 0]], [[0, 0, points[-1, 2]]]])
    fans = [
        np.stack([np.roll(ring, -1), ring, np.full(64, ends)], axis=1),
        np.stack([last, np.roll(last, -1), np.full(64, ends + 1)], axis=1),
    ]
    return trimesh.Trimesh(points, np.concatenate([faces, *fans]), process=False)


@pytest.mark.parametrize("fine", [False, True])
def test_a_gable_is_a_lid(fine: bool, tmp_path: Path) -> None:
    """Of a carton of 70 mm with a roof over its upper 30 mm nothing is level; it holds 70 x 70 x (170 + 30 / 2) mm."""
    half, eaves, ridge = 0.035, 0.17, 0.2
    foot = [(-half, -half), (half, -half), (half, half), (-half, half)]
    points = [(*p, 0.0) for p in foot] + [(*p, eaves) for p in foot] + [(-half, 0, ridge), (half, 0, ridge)]
    faces = [(0, 2, 1), (0, 3, 2), (4, 5, 9), (4, 9, 8), (6, 7, 8), (6, 8, 9), (5, 6, 9), (7, 4, 8)]
    for i, j in zip(range(4), (1, 2, 3, 0), strict=True):
        faces += [(i, j, 4 + j), (i, 4 + j, 4 + i)]
    mesh = trimesh.Trimesh(np.array(points), np.array(faces), process=False)
    for _ in range(5 if fine else 0):
        mesh = mesh.subdivide()
    mesh.export(tmp_path / "milk.stl")
    container = import_container(tmp_path / "milk.stl")
    assert container.height_m == pytest.approx(ridge, rel=1e-3)
    volume = 4 * half**2 * 0.5 * (eaves + ridge)
    assert container.volume_m3 == pytest.approx(volume, rel=0.005)


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("bulb", "neither a mouth nor a lid"), ("pin", "neither a mouth nor a lid"), ("mushroom", "overhangs"),
        ("bottle", ""), ("oil bottle", ""), ("mustard", ""),
    ],
)  # fmt: skip
def test_what_is_closed_needs_a_lid_and_no_ledge(kind: str, said: str, tmp_path: Path) -> None:
    ball_on_a_stem(kind).export(tmp_path / "it.ply")
    if not said:
        assert import_container(tmp_path / "it.ply").height_m > 0.15
        return
    with pytest.raises(InputError, match=f"not a thin-walled container: .*{said}"):
        import_container(tmp_path / "it.ply")


def test_a_wall_that_bulges_is_no_handle(tmp_path: Path) -> None:
    """A side that is pressed out by 7 of 35 mm over 30 mm of its height is taken for a side, and its bulge is kept."""
    points, faces = revolved(np.full(60, RADIUS_m), np.linspace(0, 0.12, 60))
    angle = np.arctan2(points[:, 1], points[:, 0])
    out = 0.007 * np.exp(-0.5 * ((points[:, 2] - 0.09) / 0.01) ** 2 - 0.5 * (angle / 0.35) ** 2)
    points[:, :2] *= 1 + out[:, None] / RADIUS_m
    wall = find_wall(points, faces, "bulge")
    assert not any("bridged behind what joins it" in note for note in wall.notes)
    seen = wall.radius_m(np.linspace(0.03, 0.11, 81), 96)
    # Between facets and rings it is a tenth of a millimetre lower.
    assert seen.max() == pytest.approx(np.hypot(*points[:, :2].T).max(), abs=2e-4)


def test_a_thick_wall_is_no_thin_walled_container(tmp_path: Path) -> None:
    height = np.linspace(0, 0.12, 60)
    loop = np.concatenate([np.full(60, 0.037), np.full(60, 0.023)]), np.concatenate([height, height[::-1]])
    trimesh.Trimesh(*revolved(*loop), process=False).export(tmp_path / "vase.ply")
    with pytest.raises(InputError, match=r"its wall is 14 mm, 47 % of its radius: not a thin-walled"):
        import_container(tmp_path / "vase.ply")


def test_a_long_handle_is_no_container(tmp_path: Path) -> None:
    pan = trimesh.Trimesh(*revolved(np.full(40, 0.08), np.linspace(0, 0.06, 40)), process=False)
    handle = trimesh.creation.box((0.14, 0.02, 0.006))
    handle.apply_translation([0.145, 0, 0.05])
    trimesh.util.concatenate([pan, handle]).export(tmp_path / "pan.ply")
    with pytest.raises(InputError, match=r"it reaches 2\d\d mm from its axis, its wall 80 mm"):
        import_container(tmp_path / "pan.ply")


def test_a_pot_on_legs_is_no_container(tmp_path: Path) -> None:
    body = pot(groove_m=0.0, foot=True, top=False)
    legs = []
    for turn in (0, 2.1, 4.2):
        leg = trimesh.creation.box((0.012, 0.012, 0.03))
        leg.apply_translation([0.026 * np.cos(turn), 0.026 * np.sin(turn), -0.015])
        legs.append(leg)
    trimesh.util.concatenate([body, *legs]).export(tmp_path / "stool.ply")
    with pytest.raises(InputError, match=r"it stands on legs: the lowest 2\d %"):
        import_container(tmp_path / "stool.ply")


def test_only_the_foot_is_clamped_and_not_its_chamfer(tmp_path: Path) -> None:
    """A ring within the lowest hundredth of the height carries load: that of the series from the foot up."""
    height = np.concatenate([[0, 0.0009, 0.002, 0.004], np.linspace(0.0065, 0.1, 40)])
    radius = np.minimum(RADIUS_m, RADIUS_m - 0.008 + 2 * height)
    points, faces = revolved(radius, height)
    trimesh.Trimesh(points, faces, process=False).export(tmp_path / "tub.ply")
    container = import_container(tmp_path / "tub.ply", wall=WallProperties(thickness_m=WALL_m))
    assert np.count_nonzero(container.fixed) == 96
    fine = np.linspace(0, 0.1, 801)
    shell = RevolutionShell(np.minimum(RADIUS_m, RADIUS_m - 0.008 + 2 * fine), fine, WALL_m)
    expected = pinch_stiffness(shell, container.material)[[320, 640]]
    # Cells of 2.4 mm: 2 %; with the second ring clamped it is a tenth more.
    np.testing.assert_allclose(stiffness_at(container, (0.04, 0.08)), expected, rtol=0.04)


def test_an_uneven_foot_is_clamped_all_round() -> None:
    points, _faces = revolved(np.full(60, RADIUS_m), np.linspace(0, 0.1, 60))
    points[:, 2] += np.where(
        points[:, 2] < 1e-9, 4e-4 * (1 + np.cos(np.arctan2(points[:, 1], points[:, 0]))), 0
    )
    assert clamped_foot(points).sum() >= 96


def box_with_a_lid(rings: int) -> trimesh.Trimesh:
    """A box of 95 by 63 by 180 mm on 160 columns, whose lid is one fan, or rings about its middle."""
    corner = 0.5 * np.array([[0.095, -0.063], [0.095, 0.063], [-0.095, 0.063], [-0.095, -0.063]])
    along = np.interp(np.arange(160) / 160, [0, 0.2, 0.5, 0.7, 1], [0, 1, 2, 3, 4])
    section = np.column_stack([np.interp(along, range(5), [*corner[:, k], corner[0, k]]) for k in range(2)])
    height = np.linspace(0, 0.18, 91)
    _, faces = revolved(np.ones(91), height, 160)
    points = [np.column_stack([section, np.full(160, z)]) for z in height]
    ring, parts = 90 * 160 + np.arange(160), [faces]
    for scale in np.linspace(1, 0, rings + 1)[1:-1]:
        inner, points = ring + 160, [*points, np.column_stack([scale * section, np.full(160, 0.18)])]
        after, beside = np.roll(inner, -1), np.roll(ring, -1)
        parts += [np.stack([ring, beside, after], axis=1), np.stack([ring, after, inner], axis=1)]
        ring = inner
    count = sum(map(len, points))
    parts.append(np.stack([ring, np.roll(ring, -1), np.full(160, count)], axis=1))
    return trimesh.Trimesh(np.concatenate([*points, [[0, 0, 0.18]]]), np.concatenate(parts), process=False)


def test_the_fan_of_a_lid_holds_the_rim_as_a_fine_one_does(tmp_path: Path) -> None:
    """As it is, the fan makes the box 6 % too soft at nine tenths of its height."""
    found = []
    for rings, remesh in ((16, "auto"), (1, "auto"), (1, "never")):
        box_with_a_lid(rings).export(tmp_path / "box.ply")
        box = import_container(
            tmp_path / "box.ply",
            wall=WallProperties(thickness_m=WALL_m),
            convention=MeshConvention(remesh=remesh),
        )
        middle = np.argmin(np.linalg.norm(box.mesh.vertices_m - [0.0475, 0, 0.162], axis=1))
        tips = opposing_points(box.mesh, np.array([middle]), axis_point_m=box.axis_point_m)
        found.append(float(dual_tip_map(box.model(), tips)[0]))
    assert found[1] == pytest.approx(found[0], rel=0.01)
    assert found[2] < 0.97 * found[0]


def test_a_shallow_box_is_divided_by_its_height(tmp_path: Path) -> None:
    """Below its lid the dents are short: twelve triangles give the stiffness of a mesh with edges of up to 2.5 mm."""
    coarse = trimesh.creation.box((0.2, 0.15, 0.05))
    fine = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(coarse.vertices, coarse.faces, 2.5e-3))
    found, place = [], np.array([0.1, 0.0, 0.045])
    for name, mesh in (("coarse", coarse), ("fine", fine)):
        mesh.apply_translation([0, 0, 0.025])
        mesh.merge_vertices()
        mesh.export(tmp_path / f"{name}.stl")
        box = import_container(tmp_path / f"{name}.stl", wall=WallProperties(thickness_m=WALL_m))
        points = box.mesh.vertices_m
        near = np.flatnonzero(np.linalg.norm(points - place, axis=1) < 0.006)
        stiffness = np.full(len(points), np.nan)
        tips = opposing_points(box.mesh, near, axis_point_m=box.axis_point_m)
        stiffness[near] = dual_tip_map(box.model(), tips)
        value, at_m = nearest_value(points, box.surface_faces, stiffness, place)
        assert np.linalg.norm(at_m - place) < 1e-5
        found.append(float(value))
    assert found[0] == pytest.approx(found[1], rel=0.03)
