"""Laminated walls: lamination theory compared with an independent implementation, and its user interface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from benchmarks._shell_problems import grid_mesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay
from tests.worlds.laminate_plates import Layer, centre_deflection_m, wall_stiffness

from visuohaptic.core import InputError
from visuohaptic.deformation.maps import object_map, squeeze
from visuohaptic.deformation.shapes import (
    WallProperties,
    load_object,
    mesh_rings,
    symmetric_part,
)
from visuohaptic.deformation.shapes.wall_properties import load_laminate
from visuohaptic.deformation.shells import Laminate, Ply, ShellMesh, ShellModel, material_constants
from visuohaptic.grasping import object_load

from .assembly import stiffness_matrix

#: Paperboard [Pa], and one that is five times stiffer along its grain.
BOARD = Layer(6e9, 2.5e9, 0.4, 1.5e9, 0.0, 1e-3)
FIBRE = Layer(10e9, 2e9, 0.25, 1e9, 0.0, 1e-3)


def wall(layers) -> Laminate:
    return Laminate(
        tuple(Ply(one.thickness, one.along, one.poisson, one.across, one.shear, one.angle) for one in layers)
    )


def at(layer: Layer, degrees: float, thickness=1e-3) -> Layer:
    return replace(layer, angle=np.radians(degrees), thickness=thickness)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31))
def test_constant_strain_and_curvature_have_the_energy_of_the_theory(seed):
    """Patch test with all couplings, on any upright or leaning plate: exact up to rounding."""
    rng = np.random.default_rng(seed)
    layers = [
        at(rng.choice([BOARD, FIBRE]), rng.uniform(-90, 90), rng.uniform(0.2, 1) * 1e-3) for _ in range(3)
    ]
    a, b, d = wall_stiffness(layers)
    inner = np.array([(x, y) for x in (0.5, 1.0, 1.5) for y in (0.33, 0.67)])
    flat = np.vstack([[[0.0, 0], [2, 0], [2, 1], [0, 1]], inner + rng.uniform(-0.12, 0.12, size=inner.shape)])
    faces = Delaunay(flat).simplices
    # Columns: along the height, to the left as seen from outside, outwards. Then leaning, and round the height.
    lean, turn = rng.uniform(-1.2, 1.2), rng.uniform(-3, 3)
    along = np.array([-np.sin(lean), 0, np.cos(lean)])
    outward = np.array([np.cos(lean), 0, np.sin(lean)])
    axes = np.stack([along, np.cross(outward, along), outward], axis=1)
    c, s = np.cos(turn), np.sin(turn)
    axes = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ axes
    mesh = ShellMesh(
        np.column_stack([flat, 0 * flat[:, 0]]) @ axes.T, faces, sum(one.thickness for one in layers)
    )
    strain, curvature = rng.normal(size=3), 1e3 * rng.normal(size=3)
    x, y = flat.T
    u = np.zeros((len(flat), 6))
    u[:, 0] = strain[0] * x + 0.5 * strain[2] * y
    u[:, 1] = strain[1] * y + 0.5 * strain[2] * x
    u[:, 2] = -0.5 * (curvature[0] * x**2 + curvature[1] * y**2 + curvature[2] * x * y)
    u[:, 3] = -(curvature[1] * y + 0.5 * curvature[2] * x)
    u[:, 4] = curvature[0] * x + 0.5 * curvature[2] * y
    u = np.hstack([u[:, :3] @ axes.T, u[:, 3:] @ axes.T]).ravel()
    stiffness = stiffness_matrix(ShellModel(mesh, wall(layers), [0]))
    energy = (
        strain @ a @ strain + 2 * strain @ b @ curvature + curvature @ d @ curvature
    )  # area 2, half of it
    assert 0.5 * u @ (stiffness @ u) == pytest.approx(energy, rel=1e-7)
    forces = (stiffness @ u).reshape(-1, 6)
    assert np.abs(forces[4:]).max() < 1e-11 * np.abs(stiffness).max() * np.abs(u).max()


@pytest.mark.parametrize(
    "layers",
    [
        [at(BOARD, 0)],
        [at(BOARD, 90)],
        [at(BOARD, 0, 5e-4), at(BOARD, 90, 1e-3), at(BOARD, 0, 5e-4)],
        [at(FIBRE, 0), at(FIBRE, 90)],
        [at(FIBRE, 45), at(FIBRE, -45)],
        [at(FIBRE, 30), at(FIBRE, -30)],
    ],
    ids=["along", "round", "cross-ply", "coupled cross-ply", "angle-ply 45", "angle-ply 30"],
)
def test_simply_supported_plates(layers):
    """Deflection under pressure against Navier's series; the coupled ones bend 1.4 to 1.5 times as much as D says."""
    size, count = (0.3, 0.2), 24
    mesh = grid_mesh(
        lambda v, u: (size[1] * v, 0 * u, size[0] * u), count, count, sum(one.thickness for one in layers)
    )
    points, faces = mesh.vertices_m, mesh.faces
    normal = np.cross(points[faces[0, 1]] - points[faces[0, 0]], points[faces[0, 2]] - points[faces[0, 0]])
    if normal[1] < 0:
        mesh = ShellMesh(points, faces[:, ::-1], mesh.thickness_m, mesh.fraction)
    x, _, z = points.T
    slanted = len(layers) == 2 and layers[0].angle + layers[1].angle == 0
    fixed = np.zeros((len(points), 6), dtype=bool)
    for ends, across, along in ((z, 2, 0), (x, 0, 2)):
        edge = np.isclose(ends, 0) | np.isclose(ends, ends.max())
        fixed[edge, 1] = True
        fixed[edge, across if slanted else along] = True
    load = np.zeros((len(points), 6))
    corners = points[mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    np.add.at(load[:, 1], mesh.faces.ravel(), np.repeat(area * np.asarray(mesh.fraction) * 100.0 / 3, 3))
    middle = int(np.argmin(np.linalg.norm(points - points.mean(axis=0), axis=1)))
    found = ShellModel(mesh, wall(layers), fixed).solve(load)[middle, 1]
    # 0.8 %: of 24 x 24 cells, where the isotropic plate is 0.2 % off; it falls with their square.
    assert found == pytest.approx(centre_deflection_m(layers, size, 100.0), rel=0.008)


def test_a_wound_wall_twists_as_it_is_stretched():
    """Grain to the left as seen from outside: by theory the top turns by a_16 N h / R, in the middle of a free tube."""
    radius, height, count = 0.03, 0.2, 48
    angle = 2 * np.pi * np.arange(count) / count
    ring = radius * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    rings = [ring + np.array([0, 0, z]) for z in np.linspace(0, height, 41)]
    layers = [at(FIBRE, 30, 5e-4)]
    mesh, _ = mesh_rings(rings, np.full(40, 5e-4))
    load = np.zeros((len(mesh.vertices_m), 6))
    load[-count:, 2] = 10.0 / count
    u = ShellModel(mesh, wall(layers), range(count)).solve(load)
    x, y, z = mesh.vertices_m.T
    round_ = (x * u[:, 1] - y * u[:, 0]) / radius
    low, high = (round_[np.isclose(z, at_z)].mean() for at_z in (0.25 * height, 0.75 * height))
    a = np.linalg.inv(wall_stiffness(layers)[0])
    # Direction 2 is to the left as seen from outside: against the angle round the axis. 1 %: 48 sides for a circle are 0.1 %, the ends the rest.
    expected = -a[2, 0] * 10.0 / (2 * np.pi * radius) * 0.5 * height
    assert high - low == pytest.approx(expected, rel=0.005)


def test_plies_of_one_material_are_that_material():
    constants, _ = material_constants("PP")
    plies = tuple(
        Ply(t, constants.youngs_modulus_Pa, constants.poisson_ratio, angle_rad=turn)
        for t, turn in ((1e-4, 0.3), (3e-4, -1.0))
    )
    cup = load_object("cup", around=16, wall=WallProperties("PP", 4e-4))
    plain = object_map(cup).stiffness_N_per_m
    layered = object_map(replace(cup, material=Laminate(plies))).stiffness_N_per_m
    some = np.isfinite(plain)
    # The coupling of equal plies cancels up to rounding.
    np.testing.assert_allclose(layered[some], plain[some], rtol=1e-7)


def test_a_level_face_has_no_direction():
    """A cap has the mean over all directions: its energy doesn't depend on that of the strain."""
    mesh = ShellMesh(np.array([[0.0, 0, 0], [1, 0, 0], [0.3, 1, 0]]), [[0, 1, 2]], 1e-3)
    model = ShellModel(mesh, wall([at(FIBRE, 0), at(BOARD, 50)]), [0])
    for law in (*model.sections[:2], model.sections[3]):
        xx, yy, shear = law[0, 0, 0], law[0, 1, 1], law[0, 2, 2]
        assert yy == pytest.approx(xx, rel=1e-9, abs=1e-12 * abs(xx))
        assert shear == pytest.approx(0.5 * (xx - law[0, 0, 1]), rel=1e-9)


def test_a_wound_wall_is_not_mirrored():
    """Half of it is not the whole: curves of such walls are of the whole object."""
    tube = load_object("cup", around=16)
    straight = replace(tube, material=wall([at(FIBRE, 0), at(FIBRE, 90)]))
    wound = replace(tube, material=wall([at(FIBRE, 40)]))
    assert [symmetric_part(one).copies for one in (straight, wound)] == [4, 1]
    found = squeeze(straight, deformation_m=1e-5, points=2)
    assert found.curve.force_N[0] == pytest.approx(5e-6 * found.stiffness_N_per_m, rel=0.02)


def test_what_scales():
    """Twice the moduli, twice the stiffness; another thickness keeps the proportions of the plies."""
    one = wall([at(BOARD, 0, 1e-4), at(FIBRE, 90, 3e-4)])
    cup = replace(load_object("cup", around=16), material=one)
    some = object_map(cup, band=False).stiffness_N_per_m
    double = object_map(replace(cup, material=one.stiffer(2.0)), band=False).stiffness_N_per_m
    np.testing.assert_allclose(double[np.isfinite(some)], 2 * some[np.isfinite(some)], rtol=1e-9)
    for mine, theirs, power in zip(
        one.sections, wall_stiffness([at(BOARD, 0, 1e-4), at(FIBRE, 90, 3e-4)]), (1, 2, 3), strict=True
    ):
        np.testing.assert_allclose(mine * 4e-4**power, theirs, atol=1e-9 * np.abs(theirs).max())


CARTON = """\
plies:
  - {material: LDPE, thickness: 50 um}
  - {along: [5.5 GPa, 6.5 GPa], across: 2.5 GPa, poisson: 0.4, density: 750, angle: 90 deg, thickness: 0.4 mm}
"""


def test_a_file_of_plies(tmp_path):
    path = tmp_path / "carton.yaml"
    path.write_text(CARTON)
    found, spread = load_laminate(path)
    assert found.name == "carton"
    assert found.thickness_m == pytest.approx(4.5e-4)
    assert found.plies[1].angle_rad == pytest.approx(np.pi / 2)
    # The board is nearly all of the plate's stiffness, and known to 0.5 / 2 of 6 GPa.
    assert spread == pytest.approx(0.25 / 6, rel=0.05)
    cup = load_object("cup", around=16, wall=WallProperties(str(path)))
    assert np.asarray(cup.mesh.thickness_m) == pytest.approx(4.5e-4)
    density = (920 * 0.05 + 750 * 0.4) / 0.45
    plain = load_object("cup", around=16, wall=WallProperties("PET", 4.5e-4))
    assert object_load(cup).mass_kg == pytest.approx(
        object_load(plain, wall_kg_per_m3=density).mass_kg, rel=1e-9
    )
    thick = load_object("cup", around=16, wall=WallProperties(str(path), 9e-4))
    assert np.asarray(thick.mesh.thickness_m) == pytest.approx(9e-4)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("plies: []\n", "at least 1"),
        ("plies:\n  - {thickness: 1 mm}\n", "either material or along"),
        ("plies:\n  - {material: butter, thickness: 1 mm}\n", "expected one of"),
        ("plies:\n  - {material: PET, thickness: 0 mm}\n", "thickness_m: found 0.0, expected more than 0"),
        ("plies:\n  - {along: 1 GPa, across: 9 GPa, poisson: 0.4, thickness: 1 mm}\n", "sqrt(E_1 / E_2)"),
    ],
)
def test_files_that_are_refused(tmp_path, text, said):
    path = tmp_path / "wall.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as refused:
        load_laminate(path)
    assert said in str(refused.value)


def test_a_modulus_beside_plies_is_refused(tmp_path):
    path = tmp_path / "carton.yaml"
    path.write_text(CARTON)
    with pytest.raises(InputError, match="together with plies"):
        load_object("cup", around=16, wall=WallProperties(str(path), youngs_modulus_Pa=1e9))
