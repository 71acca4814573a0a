"""Kernels beside plain NumPy or scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from visuohaptic.deformation.shapes import tube_mesh
from visuohaptic.deformation.shells import _corotational_kernels as corotational
from visuohaptic.deformation.shells import _pinch_kernels as pinch
from visuohaptic.deformation.shells import _shell_kernels as shell


def test_rays_across_the_axis_against_every_triangle():
    rng = np.random.default_rng(1)
    mesh = tube_mesh(0.03, 0.1, 0.001, around=13, along=9, crossed=False)
    points = mesh.vertices_m * [1.3, 0.8, 1] + 0.001 * rng.normal(size=mesh.vertices_m.shape)
    axis = np.array([0.002, -0.001])
    first = np.arange(13, 110, 7)
    face, weights, direction = pinch.across(points, mesh.faces, first, np.tile(axis, (len(first), 1)))
    for k, vertex in enumerate(first):
        to_axis = np.r_[axis - points[vertex, :2], 0]
        ray = to_axis / np.linalg.norm(to_axis)
        assert direction[k] == pytest.approx(ray)
        a, b, c = (points[mesh.faces[:, i]] for i in range(3))
        # origin + s ray = a + v (b - a) + w (c - a)
        system = np.stack([np.broadcast_to(-ray, a.shape), b - a, c - a], axis=2)
        s, v, w = np.linalg.solve(system, (points[vertex] - a)[:, :, None])[:, :, 0].T
        hit = (v >= 0) & (w >= 0) & (v + w <= 1) & (s > np.linalg.norm(to_axis))
        found = np.flatnonzero(hit)[np.argmax(s[hit])]
        assert face[k] == found
        assert weights[k] == pytest.approx([1 - v[found] - w[found], v[found], w[found]], abs=1e-9)


def test_rotations_against_scipy():
    rng = np.random.default_rng(2)
    spins = rng.normal(size=(40, 3)) * np.r_[np.full(20, 1e-7), np.full(20, 1.2)][:, None]
    start = Rotation.random(40, random_state=3).as_matrix()
    expected = Rotation.from_rotvec(spins).as_matrix() @ start
    assert corotational.rotate_nodes(start, spins) == pytest.approx(expected, abs=1e-14)
    for matrix in Rotation.from_rotvec(spins).as_matrix():
        found = np.empty(3)
        corotational.rotation_vector(matrix, found)
        assert found == pytest.approx(Rotation.from_matrix(matrix).as_rotvec(), rel=1e-6, abs=1e-13)


@pytest.mark.parametrize("aspect", [1.0, 4.0, 16.0])
def test_the_membrane_bends_in_its_plane_without_locking(aspect):
    """What "optimal" means: a rectangle of triangles in pure bending has a beam's energy.

    Felippa 2003 derives beta_0 so that this holds at any aspect ratio for two triangles and nu = 0.
    """
    length, height = aspect, 1.0
    corners = np.array([[0.0, 0], [length, 0], [length, height], [0, height]]) - [length / 2, height / 2]
    curvature = 0.01
    motion = np.column_stack(
        [
            -curvature * corners[:, 0] * corners[:, 1],
            0.5 * curvature * corners[:, 0] ** 2,
            curvature * corners[:, 0],
        ]
    )
    energy = 0.0
    law = np.diag([1.0, 1.0, 0.5])
    for diagonal in ([[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]):
        for face in diagonal:
            xy = corners[face]
            side = xy - xy[0]
            area = 0.5 * (side[1, 0] * side[2, 1] - side[1, 1] * side[2, 0])
            stiffness = shell.membrane_stiffness(np.ascontiguousarray(xy), area, law, 0.5)
            u = motion[face].ravel()
            energy += 0.25 * u @ stiffness @ u
    assert energy == pytest.approx(0.5 * curvature**2 * length * height**3 / 12, rel=1e-9)
