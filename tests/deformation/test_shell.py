"""The shell triangle: patch tests, rigid motion, published problems, and invalid input."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks._shell_problems import COURSE
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from visuohaptic.core import InputError
from visuohaptic.deformation.shapes import tube_mesh
from visuohaptic.deformation.shells import (
    IsotropicMaterial,
    ShellMesh,
    ShellModel,
    enclosed_volume,
    plane_stress,
    volume_gradient,
)

from .assembly import stiffness_matrix

MATERIAL = IsotropicMaterial(1e6, 0.3)
CORNERS = np.array([[0.0, 0], [2, 0], [2, 1], [0, 1]])


def rotation(rng):
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def patch(rng):
    """A plate of irregular triangles somewhere in space; the first four vertices are its corners."""
    inner = np.array([(x, y) for x in (0.5, 1.0, 1.5) for y in (0.33, 0.67)])
    points = np.vstack([CORNERS, inner + rng.uniform(-0.12, 0.12, size=inner.shape)])
    return points, Delaunay(points).simplices, rotation(rng)


def constant_state(points, turn, strain, curvature):
    """Displacements and rotations of a constant strain (xx, yy, 2 xy) and curvature (-w,xx ...)."""
    x, y = points.T
    u = np.zeros((len(points), 6))
    u[:, 0] = strain[0] * x + 0.5 * strain[2] * y
    u[:, 1] = strain[1] * y + 0.5 * strain[2] * x
    u[:, 2] = -0.5 * (curvature[0] * x**2 + curvature[1] * y**2 + curvature[2] * x * y)
    u[:, 3] = -(curvature[1] * y + 0.5 * curvature[2] * x)
    u[:, 4] = curvature[0] * x + 0.5 * curvature[2] * y
    return np.hstack([u[:, :3] @ turn.T, u[:, 3:] @ turn.T])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31))
def test_patch_tests_are_exact(seed):
    """Any mesh, any place in space: constant strain and curvature leave no force inside."""
    rng = np.random.default_rng(seed)
    points, faces, turn = patch(rng)
    thickness = 0.01
    mesh = ShellMesh(np.column_stack([points, 0 * points[:, 0]]) @ turn.T, faces, thickness)
    stiffness = stiffness_matrix(ShellModel(mesh, MATERIAL, [0]))
    law = plane_stress(MATERIAL)
    for strain, curvature in (
        (rng.normal(size=3) * 1e-3, np.zeros(3)),
        (np.zeros(3), rng.normal(size=3)),
    ):
        u = constant_state(points, turn, strain, curvature).ravel()
        forces = (stiffness @ u).reshape(-1, 6)
        inner = np.setdiff1d(np.unique(faces), np.arange(4))
        # Corners carry the boundary's tractions; inner vertices nothing, up to rounding.
        assert np.abs(forces[inner]).max() < 1e-13 * np.abs(stiffness).max() * np.abs(u).max()
        area = 0.5 * np.abs(np.linalg.det(np.diff(points[faces], axis=1))).sum()
        energy = (
            0.5 * area * (thickness * strain @ law @ strain + thickness**3 / 12 * curvature @ law @ curvature)
        )
        assert 0.5 * u @ (stiffness @ u) == pytest.approx(energy, rel=1e-8)


def test_rigid_motions_are_the_only_ones_without_energy():
    rng = np.random.default_rng(3)
    points, faces, turn = patch(rng)
    vertices = np.column_stack([points, 0.2 * np.sin(3 * points[:, 0])]) @ turn.T
    model = ShellModel(ShellMesh(vertices, faces, 0.02), MATERIAL, [0])
    values = np.linalg.eigvalsh(stiffness_matrix(model).toarray())
    assert np.abs(values[:6]).max() < 1e-12 * values[-1]
    assert values[6] > 1e-10 * values[-1]
    for axis in range(3):
        spin = np.eye(3)[axis]
        motion = np.hstack([np.cross(spin, vertices), np.tile(spin, (len(vertices), 1))])
        assert np.abs(stiffness_matrix(model) @ motion.ravel()).max() < 1e-12 * values[-1]


@pytest.mark.parametrize("name", COURSE)
def test_published_problems(name):
    """1.5 % on 32 x 32, the floor of the course."""
    assert COURSE[name](32) == pytest.approx(1.0, abs=0.015)


def test_the_error_falls_with_the_mesh():
    errors = [abs(COURSE["hemisphere with hole"](n) - 0.995) for n in (8, 16, 32)]
    assert errors[0] > 3 * errors[1] > 9 * errors[2]


def test_the_factor_is_the_matrix():
    """Solves through the fronts agree with scipy's solver on the held matrix."""
    from scipy.sparse.linalg import spsolve

    rng = np.random.default_rng(5)
    mesh = tube_mesh(0.03, 0.1, 0.001, around=14, along=11)
    fixed = np.zeros((len(mesh.vertices_m), 6), dtype=bool)
    fixed[:14, :3] = True
    springs = np.zeros(fixed.shape)
    springs[:14, 3:] = 0.3
    model = ShellModel(mesh, MATERIAL, fixed, springs=springs)
    loads = rng.normal(size=(model.nodes, 6, 3))
    found = model.solve(loads)
    free = model.free
    expected = spsolve(stiffness_matrix(model)[free][:, free], loads.reshape(-1, 3)[free])
    assert np.abs(found.reshape(-1, 3)[free] - expected).max() < 1e-8 * np.abs(expected).max()
    assert np.all(found.reshape(-1, 3)[~free] == 0)
    assert model.solve(loads[:, :, 0]).shape == (model.nodes, 6)


def test_thickness_counts_face_by_face():
    """Three times the wall: 27 times the bending stiffness of a plate."""
    deflections = []
    for wall in (0.01, 0.03):
        mesh = ShellMesh(
            np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), [[0, 1, 2], [0, 2, 3]], [wall] * 2
        )
        load = np.zeros((4, 6))
        load[1:3, 2] = 1.0
        deflections.append(ShellModel(mesh, MATERIAL, [0, 3]).solve(load)[1, 2])
    assert deflections[0] / deflections[1] == pytest.approx(27, rel=1e-9)


def box():
    vertices = np.array([[x, y, z] for z in (0.0, 1) for y in (0.0, 1) for x in (0.0, 1)])
    quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    faces = np.array([[q[0], q[1], q[2]] for q in quads] + [[q[0], q[2], q[3]] for q in quads])
    return vertices, faces


def test_volume_and_its_gradient():
    vertices, faces = box()
    assert enclosed_volume(vertices, faces) == pytest.approx(1.0)
    gradient = volume_gradient(vertices, faces)
    rng = np.random.default_rng(0)
    move = 1e-6 * rng.normal(size=vertices.shape)
    change = enclosed_volume(vertices + move, faces) - enclosed_volume(vertices - move, faces)
    assert change == pytest.approx(2 * np.sum(gradient * move), rel=1e-8)
    assert np.abs(gradient.sum(axis=0)).max() < 1e-15
    model = ShellModel(ShellMesh(vertices, faces, 0.01), MATERIAL, [0, 1, 2, 3])
    assert np.all(model.volume_gradient()[:4] == 0)
    assert np.allclose(model.volume_gradient()[4:, :3], gradient[4:])


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"vertices_m": np.full((3, 3), np.nan)}, "expected finite numbers"),
        ({"faces": np.array([[0, 1, 3]])}, "found indices 0 to 3, expected 0 to 2"),
        ({"faces": np.array([[0, 1, 1]])}, "1 triangles without area, the first is face 0 at"),
        ({"thickness_m": 0.0}, r"thickness_m: found \[0.0.*\], expected more than 0"),
        ({"faces": np.zeros((0, 3), dtype=int)}, "expected \\(f, 3\\), f > 0"),
        ({"fraction": 2.0}, "at most 1"),
    ],
)
def test_meshes_that_cannot_be_are_refused(change, text):
    given = {"vertices_m": np.eye(3), "faces": np.array([[0, 1, 2]]), "thickness_m": 0.001, **change}
    with pytest.raises(InputError, match=text):
        ShellMesh(**given)


def test_supports_that_cannot_be_are_refused():
    mesh = ShellMesh(np.eye(3), np.array([[0, 1, 2]]), 0.001)
    with pytest.raises(InputError, match="no vertex is clamped"):
        ShellModel(mesh, MATERIAL, [])
    with pytest.raises(InputError, match="found vertex 3"):
        ShellModel(mesh, MATERIAL, [3])
    with pytest.raises(InputError, match="expected vertex numbers or a mask"):
        ShellModel(mesh, MATERIAL, np.zeros((2, 2), dtype=bool))
    loose = ShellMesh(np.vstack([np.eye(3), np.eye(3) + 5]), np.array([[0, 1, 2], [3, 4, 5]]), 0.001)
    with pytest.raises(InputError, match=r"not positive definite at vertex [345]"):
        ShellModel(loose, MATERIAL, [0, 1, 2]).factor()
    with pytest.raises(InputError, match="expected \\(3, 6\\)"):
        ShellModel(mesh, MATERIAL, [0]).solve(np.zeros((2, 6)))


def test_vertices_that_no_face_uses_stay_where_they_are():
    mesh = ShellMesh(np.vstack([np.eye(3), [[9.0, 9, 9]]]), np.array([[0, 1, 2]]), 0.001)
    load = np.zeros((4, 6))
    load[2, 2] = 1.0
    assert np.all(ShellModel(mesh, MATERIAL, [0, 1]).solve(load)[3] == 0)
