"""Mesh diagnosis: duplicate triangles, loose patches, edges with three triangles, flipped faces, rims."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from visuohaptic.core import InputError
from visuohaptic.io.meshes import inspect_mesh


def _box(size_m: float = 1.0, at: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    box = trimesh.creation.box((size_m, size_m, size_m))
    return np.array(box.vertices) + at, np.array(box.faces)


def _joined(*parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    return (
        np.concatenate([vertices for vertices, _ in parts]),
        np.concatenate([faces + start for (_, faces), start in zip(parts, starts, strict=False)]),
    )


def test_a_closed_box_of_loose_triangles_is_whole() -> None:
    vertices, faces = _box()
    found = inspect_mesh(vertices[faces].reshape(-1, 3), np.arange(36).reshape(12, 3))
    assert (len(found.vertices), len(found.faces), found.loops, found.defects) == (8, 12, (), [])


def test_corners_that_differ_by_less_than_the_resolution_are_one() -> None:
    """Wherever they lie: rounding alone separates two that are on both sides of a border between its cells."""
    vertices, faces = _box()
    rng = np.random.default_rng(0)
    loose = (vertices * [1.0, 0.5000003, 0.2500003])[faces].reshape(-1, 3) + rng.uniform(-2e-7, 2e-7, (36, 3))
    found = inspect_mesh(loose, np.arange(36).reshape(12, 3))
    assert (len(found.vertices), len(found.faces), found.loops, found.defects) == (8, 12, (), [])


def test_an_open_box_has_a_rim() -> None:
    vertices, faces = _box()
    side = (vertices[faces][:, :, 2] > 0.4).all(axis=1)
    found = inspect_mesh(vertices, faces[~side])
    (loop,) = found.loops
    rim = found.vertices[loop]
    assert len(loop) == 4
    assert rim[:, 2] == pytest.approx(np.full(4, 0.5))
    # In order: neighbours are an edge of 1 m apart.
    assert np.linalg.norm(rim - np.roll(rim, 1, axis=0), axis=1) == pytest.approx(np.ones(4))
    assert found.defects == []


def test_every_defect_is_counted_and_said() -> None:
    vertices, faces = _box()
    small = _box(0.05, at=2.0)
    vertices, faces = _joined((vertices, faces), small)
    needle, doubled = [0, 1, 1], faces[3][[1, 2, 0]]
    fin = len(vertices)
    vertices = np.vstack([vertices, [3.0, 0.0, 0.0]])
    faces = np.vstack([faces, needle, doubled, [*faces[0][:2], fin]])
    found = inspect_mesh(vertices, faces)
    assert (found.dropped_faces, found.patches, found.loose_faces) == (2, 2, 12)
    assert found.loose_place == pytest.approx((2.0, 2.0, 2.0))
    assert (found.branching_edges, found.turned) == (1, 1)
    assert found.defects == [
        "2 degenerate or doubled triangles dropped",
        "1 loose patches of 12 triangles, the largest at (2, 2, 2)",
        "1 edges with more than two triangles",
        "1 edges where the outside changes sides",
    ]


def test_a_turned_face_disagrees_along_its_three_edges() -> None:
    vertices, faces = _box()
    faces[5] = faces[5][::-1]
    found = inspect_mesh(vertices, faces)
    assert (found.turned, found.branching_edges, found.loops) == (3, 0, ())


def test_halves_of_a_wall_that_a_seam_keeps_apart_both_stay() -> None:
    found = inspect_mesh(*_joined(_box(), _box(at=3.0)))
    assert (found.loose_faces, len(found.faces), found.loose_place) == (0, 24, ())


def test_too_little_is_refused() -> None:
    vertices, faces = _box()
    with pytest.raises(InputError, match=r"wall: mesh: has 3 triangles with an area, expected at least 4"):
        inspect_mesh(vertices, np.vstack([faces[:3], [[0, 0, 1]]]), "wall")
