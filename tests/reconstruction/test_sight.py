"""Visibility of a tube: its outside is visible from outside, its inside only through its ends."""

from __future__ import annotations

import numpy as np

from visuohaptic.reconstruction import SurfaceMesh
from visuohaptic.reconstruction.completion import HoleRegion, open_sight


def wall(radius_m, outward, columns=48, rows=20, high_m=0.1):
    """A cylinder's wall with triangles that face outward or inward."""
    theta = 2 * np.pi * np.arange(columns) / columns
    tt, zz = np.meshgrid(theta, np.linspace(0, high_m, rows))
    vertices = np.stack([radius_m * np.cos(tt), radius_m * np.sin(tt), zz], axis=-1).reshape(-1, 3)
    i, j = (part.ravel() for part in np.mgrid[0 : rows - 1, 0:columns])
    a, b = i * columns + j, i * columns + (j + 1) % columns
    faces = np.concatenate(
        [np.column_stack([a, b, b + columns]), np.column_stack([a, b + columns, a + columns])]
    )
    return SurfaceMesh(vertices, faces if outward else faces[:, ::-1])


def test_glass_on_a_tube_closes_its_inside():
    tube = wall(0.04, True).joined(wall(0.036, False))
    cube = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (0, 1)])
    glass = HoleRegion.of_points(cube * [0.04, 0.04, 0.1] + [0, 0, 0.102])
    centres, normals = tube.vertices_m[tube.faces].mean(axis=1), tube.face_normals
    fraction = open_sight(tube, glass, centres, normals)
    outward = (normals[:, :2] * centres[:, :2]).sum(axis=1) > 0
    assert fraction[outward].min() > 0.5
    # What is left to the inside is the open foot of the tube, wide for its lowest parts only.
    assert fraction[~outward & (centres[:, 2] > 0.05)].max() < 0.2
    away = HoleRegion.of_points(cube * [0.04, 0.04, 0.1] + [0.3, 0, 0.102])
    assert open_sight(tube, away, centres, normals)[~outward & (centres[:, 2] > 0.08)].min() > 0.2
