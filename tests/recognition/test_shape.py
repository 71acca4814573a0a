"""Descriptors are invariant to motion, views contain only visible points, and ICP finds the pose."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

pytest.importorskip("small_gicp")
pytest.importorskip("trimesh")

from benchmarks._prior_world import containers, seen_cloud

from visuohaptic.core import InputError
from visuohaptic.recognition.visual import describe_cloud, fit_shape, shape_views, thinned
from visuohaptic.recognition.visual.shape import _Surface, visible_from


def _box(rng: np.random.Generator, size: tuple[float, float, float], count: int = 3000) -> np.ndarray:
    """Points evenly on the surface of a box around the origin."""
    a, b, c = size
    areas = np.array([b * c, a * c, a * b])
    axis = rng.choice(3, count, p=areas / areas.sum())
    points = rng.uniform(-0.5, 0.5, (count, 3)) * size
    points[np.arange(count), axis] = rng.choice([-0.5, 0.5], count) * np.array(size)[axis]
    return points


def _turn(rng: np.random.Generator) -> np.ndarray:
    turned, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return turned * np.sign(np.linalg.det(turned))


@given(st.integers(0, 10**6))
@settings(max_examples=15, deadline=None)
def test_no_motion_changes_a_description(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cloud = _box(rng, (0.05, 0.08, 0.2))
    moved = cloud @ _turn(rng).T + rng.normal(size=3)
    same = np.linalg.norm(describe_cloud(cloud) - describe_cloud(moved))
    other = np.linalg.norm(describe_cloud(cloud) - describe_cloud(_box(rng, (0.1, 0.1, 0.1))))
    # Thinning by cubes depends on the direction: about 4000 pairs and 300 points, a fraction of 1/32 each.
    assert same < 0.2 < other


def test_size_and_density() -> None:
    rng = np.random.default_rng(0)
    small = _box(rng, (0.05, 0.05, 0.1))
    assert np.linalg.norm(describe_cloud(small) - describe_cloud(1.5 * small)) > 0.3
    uneven = np.concatenate([small, small[small[:, 2] > 0].repeat(4, axis=0)])
    assert np.linalg.norm(describe_cloud(small) - describe_cloud(uneven)) < 0.1
    assert 100 < len(thinned(small, 400)) <= 400


def test_points_that_are_far_apart_are_in_the_last_bin() -> None:
    """Two heaps of 15 points, 3 m apart: half of the pairs of points are in one heap, the others of two."""
    heaps = np.random.default_rng(4).uniform(-5e-4, 5e-4, (30, 3)) + np.repeat(
        [[0, 0, 0], [3.0, 0, 0]], 15, 0
    )
    share = describe_cloud(heaps)[:32] ** 2
    # 4,000 pairs: a standard deviation of .008.
    np.testing.assert_allclose(share[[0, -1]], 0.5, atol=0.03)
    assert share[[0, -1]].sum() == pytest.approx(1.0, abs=1e-6)


def test_a_point_that_is_far_from_the_surface_counts_as_a_tenth_of_the_extent() -> None:
    rng = np.random.default_rng(6)
    box = _box(rng, (0.06, 0.1, 0.22))
    stored = shape_views(box)
    # An object on a string: one voxel in sixty is 10 cm above it, on the axis, so that no pose is better.
    far = np.tile([0.0, 0.0, 0.22], (40, 1)) + rng.uniform(-0.006, 0.006, (40, 3))
    whole, more = (
        fit_shape(stored, cloud, len(stored.directions) - 1) for cloud in (box, np.concatenate([box, far]))
    )
    cloud = thinned(np.concatenate([box, far]), 400)
    share = float(np.mean(cloud[:, 2] > 0.15))
    extent = float(np.linalg.norm(np.ptp(cloud, axis=0)))
    # Three quarters of the mean square are that of the cloud.
    expected = np.sqrt(whole.residual_m**2 + 0.75 * share * (0.1 * extent) ** 2)
    assert more.residual_m == pytest.approx(expected, rel=0.05)


def test_visible_is_the_near_side_of_a_ball() -> None:
    rng = np.random.default_rng(1)
    ball = rng.normal(size=(4000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    direction = np.array([1.0, 2.0, -1.0]) / np.sqrt(6)
    seen = np.zeros(len(ball), bool)
    seen[visible_from(ball, direction)] = True
    height = ball @ direction
    # Cells are 0.06 wide: nothing further behind the outline than a few of them, nothing in front left out.
    assert seen[height > 0.5].mean() > 0.99
    assert not seen[height < -0.4].any()


def test_fit_finds_the_pose() -> None:
    rng = np.random.default_rng(2)
    box = _box(rng, (0.06, 0.1, 0.22))
    stored = shape_views(box)
    turned, shift = _turn(rng), rng.normal(size=3)
    view = int(np.argmax(stored.directions @ np.array([0.5, 0.6, 0.6])))
    side = box[visible_from(box, stored.directions[view].astype(float))]
    fit = fit_shape(stored, side @ turned.T + shift, view)
    moved = box @ fit.T_cloud_object[:3, :3].T + fit.T_cloud_object[:3, 3]
    # A box looks the same after half a turn: compare the point sets, not the points.
    gap = cKDTree(box @ turned.T + shift).query(moved)[0]
    # Points are 5 mm apart on average; a pose that is wrong would show as centimetres.
    assert np.sqrt(np.mean(gap**2)) < 0.005
    assert fit.residual_m < 0.001
    other = fit_shape(shape_views(1.2 * box), side @ turned.T + shift, view)
    assert other.residual_m > 2 * fit.residual_m


def test_a_camera_sees_what_is_stored() -> None:
    """Ray-cast clouds with noise and holes lie on their own surface, closer than on another class's."""
    rng = np.random.default_rng(3)
    meshes = containers(1, classes=("bottle", "cup"))
    stored = {name: shape_views(mesh.sampled(3000, rng)[0]) for name, mesh in meshes.items()}
    for name, mesh in meshes.items():
        cloud = seen_cloud(mesh, rng)
        residual = {}
        for other, shape in stored.items():
            views = np.argsort(np.linalg.norm(shape.descriptors - describe_cloud(cloud), axis=1))[:2]
            residual[other] = min(fit_shape(shape, cloud, int(view)).residual_m for view in views)
        assert min(residual, key=lambda one: residual[one]) == name
        assert residual[name] < 0.002  # noise of 1.5 mm, averaged by thinning


@pytest.mark.parametrize(
    "cloud",
    [
        np.zeros((5, 3)),
        np.zeros((100, 2)),
        np.full((100, 3), np.nan),
        np.zeros((100, 3)),
        np.eye(3).repeat(20, 0) * 1e4,
    ],
)
def test_clouds_that_are_none(cloud: np.ndarray) -> None:
    with pytest.raises(InputError, match=r"cloud|points_m"):
        describe_cloud(cloud)
    with pytest.raises(InputError, match=r"cloud|points_m"):
        shape_views(cloud)


def test_distances_are_to_the_plane_on_the_surface_and_to_the_rim_beside_it() -> None:
    """A sheet of points 5 mm apart; the tangent plane goes on for 10 mm beyond its rim."""
    x, y = np.meshgrid(np.arange(0.0, 0.1001, 0.005), np.arange(0.0, 0.1001, 0.005))
    sheet = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    surface = _Surface(cKDTree(sheet), sheet, np.tile([0.0, 0.0, 1.0], (len(sheet), 1)))
    seen = np.array([[0.0525, 0.05, 0.003], [0.109, 0.05, 0.003], [0.111, 0.05, 0.003]])
    assert surface.distances(seen) == pytest.approx([0.003, 0.003, np.hypot(0.011, 0.003)])


def test_a_sheet_is_as_thick_as_it_is_from_two_millimetres_on() -> None:
    """Half of the resolution of pairs, 4 mm, is the least standard deviation across a sheet: noise of a camera is more than less."""
    flat = _box(np.random.default_rng(1), (0.2, 0.15, 1.0), 400)
    found = [describe_cloud(flat * [1.0, 1.0, 1e-3 * t_mm])[-3:] for t_mm in (0.5, 2.0, 12.0, 18.0)]
    assert found[0][0] == pytest.approx(found[1][0], abs=1e-6)  # .2 and 1 mm across: not told apart
    assert found[2][0] > found[1][0] + 0.1
    # The logarithm of the thickness counts, .6 of it.
    assert found[3][0] - found[2][0] == pytest.approx(0.6 * np.log(1.5), rel=0.1)  # of thinned points


def test_a_description_of_a_rod_is_what_its_distances_angles_and_length_are() -> None:
    """Points on a line, against all pairs of them; of three points the first is the middle one in a third of all triples."""
    line = np.zeros((150, 3))
    line[:, 0] = np.linspace(0.0, 0.3, 150)
    found = describe_cloud(line)
    length = np.abs(line[:, :1] - line[:, 0]).ravel()
    # 32 bins whose centres are equally spaced in the logarithm, from 4 mm to 2 m.
    edges = np.log(0.004) + np.arange(32) * np.log(2.0 / 0.004) / 31
    place = np.interp(np.log(np.maximum(length, 1e-9)), edges, np.arange(32.0))
    share = np.maximum(1 - np.abs(place[:, None] - np.arange(32)), 0).mean(axis=0)
    np.testing.assert_allclose(found[:32] ** 2, share, atol=0.03)  # 4,000 pairs: at most .006
    assert np.linalg.norm(found[:32] ** 2 - share) < 0.05
    angles = (found[32:44] / 0.5) ** 2
    np.testing.assert_allclose(angles[[0, -1]], [2 / 3, 1 / 3], atol=0.04)  # 2,000 triples: .011
    np.testing.assert_allclose(angles[1:-1], 0.0, atol=1e-6)
    expected = 0.6 * np.log([0.002, 0.002, np.std(line[:, 0], ddof=1)])
    np.testing.assert_allclose(found[44:], expected, atol=1e-5)
