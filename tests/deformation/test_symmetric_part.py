"""Reduction by symmetry: detected only where the mesh is mirror-symmetric."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from visuohaptic.deformation.shapes import (
    ShellObject,
    is_round,
    load_container,
    mesh_container,
    symmetric_part,
)
from visuohaptic.deformation.shells import ShellMesh


def shipped(name: str) -> ShellObject:
    return mesh_container(load_container(name).middle(), around=16)


@pytest.mark.parametrize(
    ("name", "angle", "copies", "round_"),
    [
        ("bottle", 0.0, 4, True),
        ("bottle", 2 * np.pi * 3 / 16, 4, True),
        ("elliptic", 0.0, 4, False),
        ("elliptic", np.pi / 2, 4, False),
        ("elliptic", 2 * np.pi * 2 / 16, 1, False),
        ("cleaner", 0.0, 2, False),
        ("cleaner", np.pi / 2, 2, False),
    ],
)
def test_the_part_is_as_small_as_the_mirrors_allow(
    name: str, angle: float, copies: int, round_: bool
) -> None:
    container = shipped(name)
    assert is_round(container) == round_
    part = symmetric_part(container, angle_rad=angle)
    assert part.copies == copies
    whole = part.whole.mesh.vertices_m
    np.testing.assert_allclose(part.expand(part.model.mesh.vertices_m), whole, atol=1e-9)

    def wall(mesh: ShellMesh) -> float:
        a, b, c = (mesh.vertices_m[mesh.faces[:, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        return float(np.sum(area * mesh.fraction * mesh.thickness_m))

    assert copies * wall(part.model.mesh) == pytest.approx(wall(part.whole.mesh), rel=1e-9)


def test_any_linear_load_with_the_symmetry_gives_the_displacements_of_the_whole() -> None:
    part = symmetric_part(shipped("elliptic"))
    model = part.whole.model()
    rng = np.random.default_rng(4)
    # A random load, made symmetric: displacements and rotations follow the same rule.
    seed = rng.normal(size=(part.model.nodes, 6))
    seed[part.model.fixed] = 0.0
    turning = part.signs[:, [1, 0, 0]] * part.signs[:, [2, 2, 1]]
    load = seed[part.image] * np.hstack([part.signs, turning])
    whole = model.solve(load)
    mine = part.model.solve(part.gather(load) / part.copies)
    np.testing.assert_allclose(
        mine[part.image] * np.hstack([part.signs, turning]), whole, atol=1e-7 * np.abs(whole).max()
    )


def test_what_differs_a_little_is_no_mirror() -> None:
    container = shipped("bottle")
    thick = np.asarray(container.mesh.thickness_m).copy()
    thick[100] *= 1.05
    patched = replace(
        container,
        mesh=ShellMesh(container.mesh.vertices_m, container.mesh.faces, thick, container.mesh.fraction),
    )
    assert symmetric_part(patched).copies < 4
    moved = container.mesh.vertices_m.copy()
    moved[85, 1] += 1e-4
    dented = replace(
        container,
        mesh=ShellMesh(moved, container.mesh.faces, container.mesh.thickness_m, container.mesh.fraction),
    )
    assert symmetric_part(dented).copies == 1
    held = container.fixed.copy()
    held[85] = True
    assert symmetric_part(replace(container, fixed=held)).copies == 1
