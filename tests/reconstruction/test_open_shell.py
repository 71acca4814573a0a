"""The hidden inner side of a bowl lies at the thickness of its wall, which is seen at the rim and at the floor."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.reconstruction import SurfaceMesh
from visuohaptic.reconstruction.completion import Completion, HoleRegion, between
from visuohaptic.reconstruction.completion.hole import boundary_loops

HIGH_M, LOW_M, TOP_M = 0.08, 0.022, 0.058


def wall(radius_m, z_m, outward):
    """A surface of revolution of a profile with triangles that face outward or inward."""
    theta = np.linspace(0, 2 * np.pi, 73)[:-1]
    points = np.stack(
        [
            radius_m[:, None] * np.cos(theta),
            radius_m[:, None] * np.sin(theta),
            z_m[:, None] * np.ones(len(theta)),
        ],
        axis=-1,
    )
    i, j = (part.ravel() for part in np.mgrid[0 : len(z_m) - 1, 0 : len(theta)])
    a, b = i * len(theta) + j, i * len(theta) + (j + 1) % len(theta)
    faces = np.concatenate(
        [np.column_stack([a, b, b + len(theta)]), np.column_stack([a, b + len(theta), a + len(theta)])]
    )
    return SurfaceMesh(points.reshape(-1, 3), faces if outward else faces[:, ::-1])


def sides(thick_m):
    """Outer and inner side of a bowl whose wall leans by 0.4: visible parts, hidden inner points."""
    z_m = np.linspace(0.0, HIGH_M, 41)
    outer_m = 0.045 + 0.4 * z_m
    # The thickness is measured across the wall, the radius along the horizontal.
    inner_m = outer_m - thick_m(z_m) * np.hypot(1.0, 0.4)
    visible, hidden = [], []
    for radius_m, outward in ((outer_m, True), (inner_m, False)):
        for part in (z_m <= LOW_M, z_m >= TOP_M):
            visible.append(wall(radius_m[part], z_m[part], outward))
        middle = (z_m >= LOW_M) & (z_m <= TOP_M)
        hidden.append(wall(radius_m[middle], z_m[middle], outward).vertices_m)
    mesh = visible[0]
    for part in visible[1:]:
        mesh = mesh.joined(part)
    return mesh, np.vstack(hidden), hidden[1]


@pytest.mark.parametrize("thick_m", [lambda z_m: 0.005 + 0 * z_m, lambda z_m: 0.010 - 0.075 * z_m])
def test_the_inner_side_is_at_the_thickness_of_the_wall(thick_m):
    from scipy.spatial import cKDTree

    visible, hidden_m, inner_m = sides(thick_m)
    middle = hidden_m.mean(axis=0)
    completion = Completion(visible, HoleRegion.of_points(middle + 0.9 * (hidden_m - middle)))
    shell = completion.shell
    assert shell is not None
    assert shell.evidence > 10
    at_m = np.column_stack([0.045 + 0.4 * np.array([0.03, 0.05]), np.zeros(2), [0.03, 0.05]])
    found_m, spread = shell.thickness(at_m)
    truth_m = thick_m(at_m[:, 2])
    assert (np.abs(np.log(found_m / truth_m)) < 0.1 + 2 * spread).all()
    assert np.abs(found_m - truth_m).max() < 0.001
    points_m = completion.completed().vertices_m
    # Between vertices of the completed surface and of the truth is a part of a cell, 2 mm.
    gaps_m = cKDTree(points_m).query(inner_m)[0]
    assert np.sqrt(np.mean(gaps_m**2)) < 0.002
    # It has the variance of the outer side and that of the thickness.
    rho_m = np.hypot(*points_m[:, :2].T)
    hidden = np.abs(points_m[:, 2] - 0.04) < 0.01
    inside = rho_m < 0.045 + 0.4 * points_m[:, 2] - 0.002
    sigma_m = completion.sigma_m(points_m[hidden])
    assert np.median(sigma_m[inside[hidden]]) > np.median(sigma_m[~inside[hidden]])


def test_a_wall_of_closed_parts_is_read_at_many_places():
    """No rim curls where the surfaces of both sides are joined: the thickness is that of the wall, wherever it is read."""
    z_m = np.linspace(0.0, HIGH_M, 41)
    outer_m = 0.045 + 0.4 * z_m
    inner_m = outer_m - 0.005 * np.hypot(1.0, 0.4)
    parts = []
    for part in (z_m <= LOW_M, z_m >= TOP_M):
        radius_m = np.concatenate([outer_m[part], inner_m[part][::-1], outer_m[part][:1]])
        parts.append(wall(radius_m, np.concatenate([z_m[part], z_m[part][::-1], z_m[part][:1]]), True))
    visible = parts[0].joined(parts[1])
    assert not boundary_loops(visible.welded())
    _, hidden_m, _ = sides(lambda z_m: 0.005 + 0 * z_m)
    middle = hidden_m.mean(axis=0)
    shell = Completion(visible, HoleRegion.of_points(middle + 0.9 * (hidden_m - middle))).shell
    assert shell is not None
    # Places are 0.08 sizes of the region apart, on a strip of 14 cm by 7 cm less the region.
    assert len(np.unique(shell.places_m, axis=0)) == len(shell.logs) > 20
    # Circles of 72 sides lie inside by a thousandth of the radius at most, 0.08 mm.
    np.testing.assert_allclose(np.exp(shell.logs), 0.005, atol=8e-5)


def test_a_solid_and_a_body_without_a_rim_have_no_inner_side():
    visible, hidden_m, _ = sides(lambda z_m: 0.005 + 0 * z_m)
    middle = hidden_m.mean(axis=0)
    region = HoleRegion.of_points(middle + 0.9 * (hidden_m - middle))
    outwards = (visible.face_normals[:, :2] * visible.vertices_m[visible.faces].mean(axis=1)[:, :2]).sum(
        1
    ) > 0
    assert Completion(visible.submesh(np.flatnonzero(outwards)), region).shell is None
    # Where glass is the top, what is seen inside was seen through it.
    lower = visible.submesh(
        np.flatnonzero(visible.vertices_m[visible.faces][..., 2].max(axis=1) < TOP_M - 1e-6)
    )
    assert Completion(lower, region).shell is None


def test_a_shell_of_which_nothing_is_hidden_adds_no_points():
    known_m = np.eye(3)
    assert between(known_m, np.ones(3), np.zeros((0, 3))).shape == (0,)
    assert between(known_m[:1], np.ones(1), np.zeros((2, 3))).tolist() == [1.0, 1.0]
