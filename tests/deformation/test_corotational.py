"""Forces are the gradient of the energy, the tangent is their derivative, rigid motion costs nothing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from visuohaptic.deformation.shells import CorotationalShell, IsotropicMaterial, ShellMesh, ShellModel
from visuohaptic.deformation.shells import _corotational_kernels as kernels

from .assembly import stiffness_matrix

MATERIAL = IsotropicMaterial(1e6, 0.3)


def octahedron():
    """A closed shell that stands on one corner."""
    vertices = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1.1, 0], [0, -1, 0], [0, 0, 0.9], [0, 0, -1]])
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    return ShellModel(ShellMesh(vertices, faces, 0.1), MATERIAL, [5])


def deformed(shell, rng, size=0.15):
    """Somewhere far away and bent."""
    nodes = shell.model.nodes
    turn = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    rest = shell.rest
    start = type(rest)(rest.points_m @ turn.T, np.tile(turn, (nodes, 1, 1)))
    return start.moved(size * rng.normal(size=(nodes, 6)))


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31))
def test_forces_are_the_gradient_of_the_energy(seed):
    rng = np.random.default_rng(seed)
    shell = CorotationalShell(octahedron())
    state = deformed(shell, rng)
    step = 1e-6 * rng.normal(size=(6, 6))
    change = shell.energy(state.moved(step)) - shell.energy(state.moved(-step))
    force = shell.internal_force(state)
    # Central difference: rounding 1e-16 E / 1e-6 and a third-order rest of 1e-12.
    assert change == pytest.approx(2 * np.sum(force * step), rel=1e-6, abs=1e-9 * np.abs(force).max() * 1e-3)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31), st.booleans())
def test_the_tangent_is_the_derivative_of_the_forces(seed, closed):
    """Through the factored solver, gas included: K^-1 of a change of force is the step."""
    rng = np.random.default_rng(seed)

    def law(volume):
        return 2e3 * (1.3 / volume - 1), -2e3 * 1.3 / volume**2

    model = octahedron()
    shell = CorotationalShell(model, pressure=law if closed else None)
    state = deformed(shell, rng, 1e-4)
    step = rng.normal(size=(6, 6))
    step[model.fixed] = 0
    scale = 1e-6
    change = shell.internal_force(state.moved(scale * step)) - shell.internal_force(
        state.moved(-scale * step)
    )
    change = np.where(model.fixed, 0, change) / (2 * scale)
    _, tangent = shell.linearised(state)
    found = tangent.solve(change.reshape(-1, 1)).reshape(6, 6)
    # The solver takes the symmetric part: out of equilibrium that drops a share like the strain (1e-4),
    # times the ratio of stiff to soft motions.
    assert np.abs(found - step).max() < 0.01 * np.abs(step).max()


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**31))
def test_the_unsymmetric_element_tangent_is_exact(seed):
    rng = np.random.default_rng(seed)
    shell = CorotationalShell(octahedron())
    mesh, elements = shell.model.mesh, shell._elements
    state = deformed(shell, rng)

    def forces(at, tangent):
        out = np.empty((8, 18))
        matrices = np.empty((8 if tangent else 0, 18, 18))
        kernels.forces_and_tangent(at.points_m, at.rotations, mesh.faces, *elements, False, out, matrices)
        return out, matrices

    found = forces(state, True)[1]
    step = 1e-6 * rng.normal(size=(6, 6))
    numeric = forces(state.moved(step), False)[0] - forces(state.moved(-step), False)[0]
    exact = 2 * np.einsum("eij,ej->ei", found, step[mesh.faces].reshape(8, 18))
    assert np.abs(numeric - exact).max() < 1e-7 * np.abs(exact).max()


def test_rigid_motion_costs_nothing_and_forces_turn_with_the_shell():
    rng = np.random.default_rng(2)
    shell = CorotationalShell(octahedron())
    far = deformed(shell, rng, 0.0)
    assert shell.energy(far) < 1e-20
    bent = shell.rest.moved(0.1 * rng.normal(size=(6, 6)))
    turn = Rotation.from_rotvec([0.4, -1.0, 2.0]).as_matrix()
    turned = type(bent)(bent.points_m @ turn.T + 3, np.einsum("ij,njk->nik", turn, bent.rotations))
    force = shell.internal_force(bent)
    rotated = np.hstack([force[:, :3] @ turn.T, force[:, 3:] @ turn.T])
    assert shell.internal_force(turned) == pytest.approx(rotated, rel=1e-9, abs=1e-9 * np.abs(force).max())
    # In equilibrium with itself.
    assert np.abs(force[:, :3].sum(axis=0)).max() < 1e-12 * np.abs(force).max()
    arm = np.cross(bent.points_m, force[:, :3]) + force[:, 3:]
    assert np.abs(arm.sum(axis=0)).max() < 1e-12 * np.abs(force).max()


def test_small_displacements_are_the_linear_shell():
    model = octahedron()
    shell = CorotationalShell(model)
    step = 1e-7 * np.random.default_rng(4).normal(size=(6, 6))
    linear = (stiffness_matrix(model) @ step.ravel()).reshape(6, 6)
    assert shell.internal_force(shell.rest.moved(step)) == pytest.approx(
        linear, abs=1e-5 * np.abs(linear).max()
    )


def test_steps_between_states_are_undone():
    rng = np.random.default_rng(6)
    shell = CorotationalShell(octahedron())
    one, other = deformed(shell, rng), deformed(shell, rng)
    there = one.moved(one.step_to(other))
    assert there.points_m == pytest.approx(other.points_m)
    assert there.rotations == pytest.approx(other.rotations, abs=1e-9)
    expected = Rotation.from_matrix(np.einsum("vij,vkj->vik", other.rotations, one.rotations)).as_rotvec()
    assert one.step_to(other)[:, 3:] == pytest.approx(expected, abs=1e-9)
