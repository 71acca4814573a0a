"""Solids and MITC4 compared with the shell: errors of the published baseline."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks._shell_problems import grid_mesh, mitc4_tube_stiffness
from benchmarks.peers.solids import quadratic_compliance, solid_stiffness
from benchmarks.peers.tetrahedra import linear_tetrahedra, wall_tetrahedra

from visuohaptic.core import InputError
from visuohaptic.deformation.maps import side_vertex
from visuohaptic.deformation.shapes import ContainerDescription, mesh_container, tube_mesh
from visuohaptic.deformation.shells import IsotropicMaterial, ShellMesh, dual_tip_map, opposing_points

PLASTIC = IsotropicMaterial(2.5e9, 0.38)


def volume(solid):
    edges = solid.points_m[solid.tetrahedra[:, 1:]] - solid.points_m[solid.tetrahedra[:, :1]]
    return np.linalg.det(edges).sum() / 6


@pytest.mark.parametrize("layers", [1, 3])
def test_the_wall_is_filled_without_gaps(layers):
    mesh = grid_mesh(lambda u, v: (u, 2 * v, 0 * u), 5, 4, 0.1)
    solid = wall_tetrahedra(mesh, layers)
    assert volume(solid) == pytest.approx(0.2, rel=1e-12)
    faces = np.sort(solid.tetrahedra[:, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]].reshape(-1, 3), axis=1)
    _, counts = np.unique(faces, axis=0, return_counts=True)
    # Inner faces twice, outer once: top and bottom 40 each, sides two per quad.
    assert set(counts) == {1, 2}
    assert np.count_nonzero(counts == 1) == 2 * 40 + 2 * 18 * layers


@pytest.mark.parametrize("quadratic", [False, True])
def test_a_bent_bar(quadratic):
    """5 x 1 x 0.5, clamped at one end: beam theory with shear, which linear tetrahedra miss."""
    solid = wall_tetrahedra(grid_mesh(lambda u, v: (5 * u, v, 0 * u), 20, 4, 0.5), 2)
    x = solid.points_m[:, 0]
    material = IsotropicMaterial(1e6, 0.0)
    forces = np.zeros_like(solid.points_m)
    end = np.isclose(x, 5)
    forces[end, 2] = 1 / np.count_nonzero(end)
    fixed = np.isclose(x, 0)
    expected = 5**3 / (3 * 1e6 * 0.5**3 / 12) + 1.2 * 5 / (0.5e6 * 0.5)
    if quadratic:
        # Forces on single nodes dent the end a little.
        assert quadratic_compliance(solid, material, fixed, forces) == pytest.approx(expected, rel=0.01)
    else:
        found = forces.ravel() @ linear_tetrahedra(solid, material, fixed).solve(forces.ravel())
        assert found < 0.8 * expected


def test_linear_tetrahedra_are_many_times_too_stiff_on_a_thin_wall():
    around, along = 32, 28
    solid = wall_tetrahedra(tube_mesh(0.035, 0.2, 0.0005, around=around, along=along, crossed=False))
    fixed = np.arange(len(solid.points_m)) < 2 * around
    load = np.zeros((len(solid.points_m), 3))
    first = along // 2 * around
    load[solid.through(first)[-1], 0], load[solid.through(first + around // 2)[-1], 0] = -1, 1
    found = 2 / (load.ravel() @ linear_tetrahedra(solid, PLASTIC, fixed).solve(load.ravel()))
    assert found > 5 * 6164


def test_mitc4_converges_to_the_same_tube():
    """From above, as the anchor's own MITC4: 6515 at 2160 nodes, 6305 at 4824."""
    coarse = mitc4_tube_stiffness(0.035, 0.2, 0.0005, PLASTIC, around=48, along=44)
    fine = mitc4_tube_stiffness(0.035, 0.2, 0.0005, PLASTIC, around=72, along=66)
    assert coarse == pytest.approx(6515, rel=0.002)
    assert fine == pytest.approx(6305, rel=0.002)


def test_what_cannot_be_filled_is_refused():
    with pytest.raises(InputError, match="crossed=False"):
        wall_tetrahedra(tube_mesh(0.03, 0.1, 0.001, around=8, along=4))
    plain = tube_mesh(0.03, 0.1, 0.001, around=8, along=4, crossed=False)
    with pytest.raises(InputError, match="folds over itself"):
        wall_tetrahedra(ShellMesh(plain.vertices_m, plain.faces, 0.08))


def test_a_thick_container_as_a_solid_and_as_a_shell():
    """t / R = 0.13: both are elasticity, and differ by that order."""
    jar = ContainerDescription.model_validate(
        {"base": {"radius": "30 mm"}, "sections": [{"height": "60 mm"}], "wall": "4 mm", "material": "glass"}
    )
    container = mesh_container(jar, around=16)
    chosen = [side_vertex(container, "x+", height) for height in (0.02, 0.03, 0.05)]
    solid = solid_stiffness(container, chosen)
    shell = dual_tip_map(container.model(), opposing_points(container.mesh, np.array(chosen)))
    np.testing.assert_allclose(solid, shell, rtol=0.13)
    assert (np.diff(solid) < 0).all()
