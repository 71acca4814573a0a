"""Invariants of local remeshing: a surface remains a surface, its border and shape are preserved."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.io.meshes import (
    boundary_loops,
    collapse_edges,
    flip_edges,
    largest_angles,
    mesh_edges,
    orient_faces,
    split_edges,
)

RADIUS = 1.0


def tube(around: int, along: int, height: float = 3.0) -> tuple[np.ndarray, np.ndarray]:
    """Rings of right-angled triangles round z."""
    k = np.arange(around)
    angle = 2 * np.pi * k / around
    points = [
        np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), np.full(around, z)], axis=1)
        for z in np.linspace(0, height, along + 1)
    ]
    faces = []
    for row in range(along):
        a, b = row * around + k, row * around + (k + 1) % around
        faces += [np.stack([a, b, b + around], axis=1), np.stack([a, b + around, a + around], axis=1)]
    return np.concatenate(points), np.concatenate(faces)


def loops(vertices: np.ndarray, faces: np.ndarray) -> list[np.ndarray]:
    return list(boundary_loops(faces))


def outward(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Cosine of each triangle's normal with the direction away from the axis."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    away = (a + b + c) / 3 * [1, 1, 0]
    return np.einsum("fi,fi->f", normal, away) / np.linalg.norm(normal, axis=1) / np.linalg.norm(away, axis=1)


def test_contracted_edges_leave_a_surface_with_its_border() -> None:
    vertices, faces = tube(200, 120)
    points, kept, moved = collapse_edges(vertices, faces, 0.1, 1e-3)
    # From cells of 0.03 to triangles of 0.1: a tenth or so, here with a margin of two.
    assert len(kept) < len(faces) / 5
    _edges, _opposite, times = mesh_edges(kept)
    assert times.max() == 2
    assert len(points) - len(times) + len(kept) == 0  # Euler's number of a tube
    assert outward(points, kept).min() > 0.5
    borders = loops(points, kept)
    assert sorted(round(float(points[loop, 2].mean()), 2) for loop in borders) == [0.0, 3.0]
    # Distances are root mean squares over the planes replaced: the vertex itself is within three of them.
    assert moved <= 1e-3
    assert np.abs(np.hypot(points[:, 0], points[:, 1]) - RADIUS).max() < 3e-3
    for loop in borders:
        assert np.abs(points[loop, 2] - points[loop, 2].mean()).max() < 3e-3


def test_a_crease_stays_where_it_is() -> None:
    """A box without ends: its four edges are not rounded off."""
    vertices, faces = tube(200, 120)
    square = vertices.copy()
    square[:, :2] /= np.abs(square[:, :2]).max(axis=1, keepdims=True)
    points, kept, _ = collapse_edges(square, faces, 0.2, 1e-3)
    assert len(kept) < len(faces) / 10
    corner, middle = np.abs(points[:, :2]).max(axis=1), points[kept].mean(axis=1)
    assert np.abs(corner - 1).max() < 3e-3
    # A triangle across an edge would have its middle inside the box.
    assert np.abs(np.abs(middle[:, :2]).max(axis=1) - 1).max() < 5e-3


def test_a_surface_that_may_not_move_is_not_contracted() -> None:
    vertices, faces = tube(64, 40)
    rng = np.random.default_rng(2)
    rough = vertices + rng.normal(0, 0.01, vertices.shape)
    points, kept, _ = collapse_edges(rough, faces, 0.3, 1e-6)
    assert len(kept) == len(faces)
    np.testing.assert_allclose(points, rough)


def test_split_edges_follow_the_curve_of_the_normals() -> None:
    vertices, faces = tube(32, 4)
    points, fine = split_edges(vertices, faces, 0.15)
    assert np.linalg.norm(points[fine] - points[np.roll(fine, 1, axis=1)], axis=2).max() <= 0.15
    assert mesh_edges(fine)[2].max() == 2
    assert len(loops(points, fine)) == 2
    # A chord of a 32nd is 4.8e-3 inside the circle. Lopsided halves tilt the normals by up to a third of their angle.
    inside = RADIUS - np.hypot(points[:, 0], points[:, 1])
    assert np.abs(inside).max() < 4.8e-3 / 2.5
    assert np.median(np.abs(inside)) < 4.8e-3 / 10


def test_a_crease_is_divided_along_itself() -> None:
    box = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
    faces = np.array([[0, 1, 5], [0, 5, 4], [1, 3, 7], [1, 7, 5]])  # two sides that meet at right angles
    points, fine = split_edges(box, faces, 0.2)
    used = points[np.unique(fine)]
    assert np.minimum(np.abs(used[:, 1]), np.abs(used[:, 0] - 1)).max() < 1e-12


def test_the_border_of_what_is_still_is_divided_in_its_plane() -> None:
    """A cone of 48 facets on a foot of a fan: all midpoints are on the cone, and the fan is not divided."""
    vertices, faces = tube(48, 5, 0.2)
    vertices[:, :2] *= 1 + 0.4 * vertices[:, 2:]
    ring = np.arange(48)
    vertices = np.concatenate([vertices, np.zeros((1, 3))])
    faces = np.concatenate([faces, np.stack([np.roll(ring, -1), ring, np.full(48, 240 + 48)], axis=1)])
    points, fine = split_edges(vertices, faces, 0.1, vertices[:, 2] == 0)
    away = np.hypot(points[:, 0], points[:, 1]) - RADIUS * (1 + 0.4 * points[:, 2])
    wall = np.hypot(points[:, 0], points[:, 1]) > 0.5
    # A chord of a 48th is 2.1e-3 inside; the arc of the normals is of third order, and the cone's slant is 22 degrees.
    assert np.abs(away[wall]).max() < 2.1e-3 / 20
    assert int((points[:, 2] == 0).sum()) == 97  # a midpoint for each of its 48 sides, and the apex
    assert mesh_edges(fine)[2].max() == 2


def test_flips_remove_obtuse_angles_and_nothing_else() -> None:
    vertices, faces = tube(64, 30)
    sheared = vertices.copy()
    # Turned by two cells a row: the diagonals are the wrong ones.
    angle = np.arctan2(vertices[:, 1], vertices[:, 0]) - 2 * np.pi / 64 * 1.5 * np.round(vertices[:, 2] / 0.1)
    sheared[:, 0], sheared[:, 1] = np.cos(angle), np.sin(angle)
    before = np.percentile(largest_angles(sheared, faces), 98)
    flipped = flip_edges(sheared, faces, 0.02)
    assert np.percentile(largest_angles(sheared, flipped), 98) < min(before, np.radians(115))
    assert len(flipped) == len(faces)
    assert mesh_edges(flipped)[2].max() == 2
    assert outward(sheared, flipped).min() > 0.9


def test_flips_of_a_smooth_surface_approach_it() -> None:
    """Diagonals over one and a half cells of a round wall are inside it by 2.25 times as much as those over half a cell."""
    vertices, faces = tube(64, 30)
    angle = np.arctan2(vertices[:, 1], vertices[:, 0]) + np.pi / 64 * np.round(vertices[:, 2] / 0.1)
    vertices[:, 0], vertices[:, 1] = np.cos(angle), np.sin(angle)
    flipped = flip_edges(vertices, faces, 1e-9)
    inside = [RADIUS - np.hypot(*vertices[some].mean(axis=1)[:, :2].T).mean() for some in (faces, flipped)]
    assert inside[1] < 0.6 * inside[0]
    assert outward(vertices, flipped).min() > 0.99


def test_nothing_is_flipped_across_a_crease() -> None:
    fold = np.array([[0, 0, 0], [1, 0, 0], [0.5, 0.1, 0], [0.5, 0, 0.1]])
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    assert np.degrees(largest_angles(fold, faces)).min() > 150
    assert (flip_edges(fold, faces, 1e-9) == faces).all()


@pytest.mark.parametrize("height", [1e-9, -1e-9])
def test_a_triangle_without_height_is_flipped_away(height: float) -> None:
    """Its normal is noise: it may look against those of its neighbours."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.4, height, 0], [0.5, -1, 0], [0.5, 1, 0]], dtype=float)
    faces = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 4], [2, 1, 4]])
    flipped = flip_edges(vertices, faces, 1e-6)
    assert np.degrees(largest_angles(vertices, flipped)).max() < 120
    a, b, c = (vertices[flipped[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0.1).all()


@pytest.mark.parametrize("fraction", [0.3, 0.7])
def test_sides_are_made_to_agree_with_the_majority(fraction: float) -> None:
    vertices, faces = tube(24, 10)
    turned = faces.copy()
    some = np.random.default_rng(4).random(len(faces)) < fraction
    turned[some] = turned[some][:, ::-1]
    found = outward(vertices, orient_faces(turned))
    assert (np.sign(found) == np.sign(0.5 - fraction)).all()
