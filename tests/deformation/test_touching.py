from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.deformation.nonlinear import SelfContactGuard
from visuohaptic.deformation.nonlinear import _touch_kernels as kernels
from visuohaptic.deformation.shapes import (
    ContainerDescription,
    ShellObject,
    class_names,
    load_container,
    mesh_container,
)


def tube(around: int = 24, **more: object) -> ShellObject:
    return mesh_container(
        ContainerDescription.model_validate(
            {"base": {"radius": "35 mm"}, "sections": [{"height": "150 mm"}], "wall": "0.5 mm", **more}
        ),
        around=around,
    )


def nearest_by_sampling(p: np.ndarray, corners: np.ndarray, n: int = 200) -> float:
    u, v = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1))
    inside = u + v <= 1 + 1e-12
    u, v = u[inside], v[inside]
    points = corners[0] + u[:, None] * (corners[1] - corners[0]) + v[:, None] * (corners[2] - corners[0])
    return float(np.linalg.norm(points - p, axis=1).min())


def test_the_distance_to_a_triangle_is_that_to_its_nearest_point() -> None:
    rng = np.random.default_rng(4)
    for _ in range(200):
        corners, p = rng.normal(size=(3, 3)), 2 * rng.normal(size=3)
        found = kernels.distance_to_triangle(p, *corners)
        sampled = nearest_by_sampling(p, corners)
        # Samples are at most a grid's width off, and never nearer.
        assert found <= sampled + 1e-12
        assert sampled - found < 2 * np.abs(corners - corners[0]).max() / 200


def test_a_line_goes_through_a_triangle_where_the_determinant_says_so() -> None:
    rng = np.random.default_rng(5)

    def volume(*four: np.ndarray) -> float:
        return float(np.linalg.det(np.stack(four[1:]) - four[0]))

    hits = 0
    for _ in range(500):
        a, b, c, p, q = rng.normal(size=(5, 3))
        sides = np.sign([volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)])
        wanted = volume(p, a, b, c) * volume(q, a, b, c) < 0 and abs(sides.sum()) == 3
        assert kernels.goes_through(p, q, a, b, c) == wanted
        hits += wanted
    assert hits > 20


@pytest.mark.parametrize("name", class_names())
def test_nothing_touches_at_rest_or_moved_as_a_whole(name: str) -> None:
    container = mesh_container(load_container(name).middle(), around=32)
    guard = SelfContactGuard(container)
    assert guard.vertex(container.mesh.vertices_m) is None
    assert guard.vertex(container.mesh.vertices_m * 1.02 + 0.1) is None


def test_flanks_of_a_groove_that_close_are_noticed_with_their_place() -> None:
    """The wall above a groove comes down onto the wall below; across the axis nothing gets nearer."""
    groove = [{"z": "75 mm", "depth": "-12 mm", "width": "24 mm"}]
    container = tube(around=48, rings=groove)
    guard = SelfContactGuard(container)
    points = container.mesh.vertices_m.copy()
    z = points[:, 2]
    # Everything above the groove's bottom sinks; the flank above folds down onto the one below.
    for sink, met in ((0.004, False), (0.0135, True)):
        moved = points.copy()
        moved[:, 2] -= sink * np.clip((z - 0.075) / 0.006, 0, 1)
        found = guard.vertex(moved)
        assert (found is not None) == met
    assert found is not None
    assert abs(z[found] - 0.075) < 0.0125
    gap = np.ptp(points[:, :2]) - np.ptp(moved[:, :2])
    assert gap == 0


def test_a_finger_of_wall_through_the_wall_beside_it_is_noticed() -> None:
    """A dent deeper than the steps of a path: no vertex is near, but an edge goes through."""
    container = tube(around=32, top={"kind": "closed"})
    guard = SelfContactGuard(container)
    points = container.mesh.vertices_m.copy()
    cap = np.argmin(np.linalg.norm(points - [0, 0, 0.15], axis=1))
    points[cap] += [0.06, 0.0, -0.03]
    assert guard.vertex(points) is not None


def test_what_meets_at_rest_does_not_count_for_ever() -> None:
    container = tube()
    mesh = container.mesh
    # One vertex pulled through the far wall before anything is loaded.
    rest = mesh.vertices_m.copy()
    from dataclasses import replace

    from visuohaptic.deformation.shells import ShellMesh

    vertex = int(np.argmin(np.linalg.norm(rest - [0.035, 0, 0.075], axis=1)))
    rest[vertex, 0] = -0.04
    odd = replace(container, mesh=ShellMesh(rest, mesh.faces, mesh.thickness_m, mesh.fraction))
    guard = SelfContactGuard(odd)
    assert guard._meetings(rest)[2].min() == 0
    assert guard.vertex(rest) is None
