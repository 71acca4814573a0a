"""Depth steps and the registration of views, in a scene whose steps and poses are known: a tile before a wall."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from visuohaptic.core.camera import Camera
from visuohaptic.reconstruction.fusion import sensor_noise
from visuohaptic.reconstruction.odometry.depth_edges import depth_edges
from visuohaptic.reconstruction.odometry.odometry import _beside
from visuohaptic.reconstruction.odometry.registration import RegisteredViews, _mixture, moved

CAMERA = Camera.simple(160, 120, 140.0)
ROWS, COLUMNS = slice(40, 80), slice(60, 110)  #: of the tile
TILE_M, WALL_M = 1.0, 1.3


def scene() -> np.ndarray:
    depth_m = np.full((CAMERA.height, CAMERA.width), WALL_M, np.float32)
    depth_m[ROWS, COLUMNS] = TILE_M
    return depth_m


def found_in(depth_m: np.ndarray) -> set[tuple[int, int]]:
    """Pixels of the steps: those of distance zero."""
    return {(i, j) for i, j in np.argwhere(depth_edges(depth_m, CAMERA).distance_px == 0.0).tolist()}


def rim() -> set[tuple[int, int]]:
    whole = {(i, j) for i in range(40, 80) for j in range(60, 110)}
    return whole - {(i, j) for i in range(41, 79) for j in range(61, 109)}


def test_steps_are_the_rim_of_what_is_nearer() -> None:
    found = depth_edges(scene(), CAMERA)
    pixels = np.array(sorted(rim()))
    assert found_in(scene()) == rim()
    # Points are on the near side.
    fx, fy, cx, cy = CAMERA.matrix[0, 0], CAMERA.matrix[1, 1], CAMERA.matrix[0, 2], CAMERA.matrix[1, 2]
    expected = np.stack([(pixels[:, 1] - cx) / fx, (pixels[:, 0] - cy) / fy, np.ones(len(pixels))], axis=1)
    np.testing.assert_allclose(found.points_m, TILE_M * expected, atol=1e-6)
    for at in ((10, 10), (60, 85), (100, 62), (41, 150)):
        away = np.hypot(*(pixels - at).T)
        assert found.distance_px[at] == pytest.approx(away.min())
        assert np.hypot(*(found.nearest[:, at[0], at[1]] - at)) == pytest.approx(away.min())
    # Inverse depth rises towards the tile.
    for at, expected_xy in (
        ((60, 60), (1, 0)),
        ((60, 109), (-1, 0)),
        ((40, 85), (0, 1)),
        ((79, 85), (0, -1)),
    ):
        np.testing.assert_allclose(found.across[:, at[0], at[1]], expected_xy, atol=1e-3)


def test_a_step_is_a_twentieth_of_the_depth_beyond_what_a_grazing_wall_rises() -> None:
    """Next to each other a pixel apart: 5 % and 3.3 / 140 of the depth; over a gap without readings as much more per pixel."""
    for gap, share in ((1, 0.05 + 3.3 / 140), (5, 0.05 + 5 * 3.3 / 140)):
        for factor, there in ((0.93, False), (1.07, True)):
            depth_m = scene()
            depth_m[ROWS, COLUMNS] = WALL_M / (1 + factor * share)
            depth_m[:, 60 - gap + 1 : 60] = np.nan
            assert ((60, 60) in found_in(depth_m)) == there
    # A shadow of the second eye may be a twentieth of the image wide, 8 px.
    for gap, there in ((8, True), (9, False)):
        depth_m = scene()
        depth_m[ROWS, COLUMNS] = 0.6
        depth_m[:, 60 - gap + 1 : 60] = np.nan
        assert ((60, 60) in found_in(depth_m)) == there


def test_walls_and_borders_have_no_steps() -> None:
    flat = np.full((CAMERA.height, CAMERA.width), 1.0, np.float32)
    for empty in (flat, np.full_like(flat, np.nan)):
        found = depth_edges(empty, CAMERA)
        assert len(found.points_m) == 0
        assert np.isinf(found.distance_px).all()
        assert found.nearest.shape == found.across.shape == (2, *flat.shape)
    for columns, count in ((3, 120 - 6), (2, 0)):  # the direction across a step is averaged over 2 px
        flat[:] = 1.5
        flat[:, : columns + 1] = 1.0
        assert len(found_in(flat)) == count
    # All of a long rim are there, no more than 400 points are kept, from the first to the last.
    comb = np.full((CAMERA.height, CAMERA.width), 1.5, np.float32)
    comb[:, 10:150:10] = 1.0
    found = depth_edges(comb, CAMERA)
    assert found.points_m.shape == (400, 3)
    assert len(found_in(comb)) == 14 * (120 - 6)


def views(*depths: np.ndarray) -> RegisteredViews:
    return RegisteredViews(np.array(depths), CAMERA, sensor_noise("realsense_d435"))


def test_points_are_taken_a_window_away_from_steps_and_gaps() -> None:
    depth_m = scene()
    depth_m[90:110, 20:40] = np.nan
    found = views(depth_m)
    kept = np.isfinite(found.smooth_m[0])
    # A window of 9 px holds what is up to 4 px away along both axes.
    steps = np.array(sorted(rim()))
    i, j = np.indices(depth_m.shape).reshape(2, -1)
    apart = np.maximum(abs(i[:, None] - steps[:, 0]), abs(j[:, None] - steps[:, 1])).min(axis=1)
    assert (kept == (apart.reshape(depth_m.shape) > 4))[:85].all()
    np.testing.assert_allclose(found.smooth_m[0][kept], depth_m[kept], rtol=1e-5)
    # Seven tenths of a window of 9 px: the gap's border is 1.8 px from the window's middle.
    assert not kept[100, 40]
    assert kept[100, 42]
    # Inverse depth is linear on a plane: the mean over a window is that of its middle.
    j, i = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    slope = (1 / (0.8 + 0.001 * j + 0.0005 * i)).astype(np.float32)
    smooth_m = views(slope).smooth_m[0]
    np.testing.assert_allclose(smooth_m[10:-10, 10:-10], slope[10:-10, 10:-10], rtol=1e-5)
    assert 1000 < len(found.points[0]) <= 2000


def test_a_motion_is_a_turn_about_the_origin_of_the_world_and_a_shift() -> None:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix(), [0.4, 0.1, -0.2]
    step = np.array([0.02, 0.05, -0.03, 0.1, 0.2, 0.3])
    turn = Rotation.from_rotvec(step[:3]).as_matrix()
    found = moved(pose, step)
    np.testing.assert_allclose(found[:3, :3], turn @ pose[:3, :3], atol=1e-12)
    np.testing.assert_allclose(found[:3, 3], turn @ pose[:3, 3] + step[3:], atol=1e-12)
    np.testing.assert_allclose(found[3], [0, 0, 0, 1])


def test_rows_of_steps_are_the_slopes_of_their_distances() -> None:
    """The same view twice: residuals are zero, and after a small motion what the rows predict; information adds up."""
    both, poses = views(scene(), scene()), np.array([np.eye(4)] * 2)
    rows, residuals = both._edge_rows(0, 1, poses, 0.05)
    assert len(rows) == len(rim())
    np.testing.assert_allclose(residuals, 0.0, atol=1e-6)
    for step in 1e-4 * np.eye(6):
        there = np.array([moved(np.eye(4), step), np.eye(4)])
        changed = both._edge_rows(0, 1, there, 0.05)[1]
        # Robust weights differ by less than a thousandth; roundings of pixels do not change at the rim.
        np.testing.assert_allclose(
            changed - residuals, rows @ step, atol=2e-3 * np.abs(rows @ step).max() + 1e-6
        )
    # One pixel aside is as many deviations as the edge's; the readings of a window are one.
    edge_px = sensor_noise("realsense_d435").edge_px(CAMERA.focal_px) / math.sqrt(3)
    window_px = sensor_noise("realsense_d435").window_px(CAMERA.focal_px)
    beside = np.array([np.eye(4)] * 2)
    beside[0, 0, 3] = TILE_M / CAMERA.matrix[0, 0]
    aside = np.abs(both._edge_rows(0, 1, beside, 0.05)[1])
    robust = 1 / (1 + (1 / (3.0 * edge_px)) ** 2)
    assert np.median(aside[aside > 0.3 * aside.max()]) == pytest.approx(
        robust / (edge_px * math.sqrt(window_px)), rel=0.05
    )
    pairs = np.array([[0, 1]])
    planes, _ = both.equations(pairs, poses, 0.05, 1, (1.0, 0.0))
    whole, _ = both.equations(pairs, poses, 0.05, 1, (1.0, 0.5))
    np.testing.assert_allclose(
        whole[0] - planes[0], 0.5 * rows.T @ rows, rtol=1e-6, atol=1e-6 * np.abs(whole).max()
    )
    half, _ = both.equations(pairs, poses, 0.05, 2, (1.0, 0.0))
    double, _ = both.equations(pairs, poses, 0.05, 1, (2.0, 0.0))
    assert half[0][5, 5] == pytest.approx(planes[0][5, 5], rel=0.02)
    np.testing.assert_allclose(double, 2.0 * planes, rtol=1e-9)


def test_a_moved_view_is_brought_back_and_is_likely_there() -> None:
    """Walls fix three directions of the camera, the rim of the tile the other three."""
    both = views(scene(), scene())
    start = np.array([np.eye(4), moved(np.eye(4), np.array([0.004, -0.005, 0.006, 0.006, -0.005, 0.004]))])
    found, information = both.polished(1, [0], start, [(0.05, 1.0, 1.0)] * 12)
    np.testing.assert_allclose(found, np.eye(4), atol=4e-4)
    assert np.linalg.eigvalsh(information)[0] > 0
    right = both.log_ratio(0, 1, np.array([np.eye(4)] * 2))
    assert right > both.log_ratio(0, 1, start) > both.log_ratio(0, 1, start @ start)
    # At the true place each mean is that of no deviation, by the width in which unrelated depths are uniform.
    quadratic, constant, offset, least = both._noise
    z = both.points[0][:, 2]
    sigma_m = math.sqrt(2) * (constant + quadratic * (z - offset) ** 2) + least
    planes = np.mean(np.log(0.9 * 0.2 * z / sigma_m / math.sqrt(2 * math.pi) + 0.1))
    edges = np.log(0.9 * 0.2 * CAMERA.focal_px / both._edge_px / math.sqrt(2 * math.pi) + 0.1)
    assert right == pytest.approx(planes + edges, rel=1e-3)
    assert _mixture(np.array([30.0]), 5.0) == pytest.approx(math.log(0.1))


def test_points_of_another_view_are_those_in_its_picture_and_edges_those_at_its_depth() -> None:
    both = views(scene(), scene())
    fx, fy, cx, cy = both.numbers
    asked = [(-0.45, 3.2), (-0.55, 3.2), (159.45, 3.2), (159.55, 3.2)]
    asked += [(7.6, -0.45), (7.6, -0.55), (7.6, 119.45), (7.6, 119.55)]
    points_m = np.array([((u - cx) / fx * 0.8, (v - cy) / fy * 0.8, 0.8) for u, v in asked])
    points_m = np.concatenate([points_m, [[0.0, 0.0, 0.04], [0.0, 0.0, -1.0]]])
    # The camera is where a pose of the other one brings it: only the difference counts.
    pose = moved(np.eye(4), np.array([0.3, 0.1, -0.4, 0.5, -0.2, 0.1]))
    world, u, v, z, i, j = both._projected(points_m, pose, pose)
    kept = points_m[:8:2]
    np.testing.assert_allclose(world, kept @ pose[:3, :3].T + pose[:3, 3])
    np.testing.assert_allclose(np.stack([u, v], axis=1), asked[::2], atol=1e-9)
    np.testing.assert_allclose(z, 0.8)
    assert list(zip(i.tolist(), j.tolist(), strict=True)) == [(3, 0), (3, 159), (0, 8), (119, 8)]
    # The same rim, 9 cm behind: beyond twice a reach of 4 cm, within twice 5 cm.
    behind = np.array([np.eye(4), moved(np.eye(4), np.array([0, 0, 0, 0, 0, -0.09]))])
    assert len(both._edge_rows(0, 1, behind, 0.04)[0]) == 0
    assert len(both._edge_rows(0, 1, behind, 0.05)[0]) > 100


def test_views_of_one_wall_are_related_and_those_of_two_are_not() -> None:
    """A wall at 1 m seen twice, and seen 5 cm behind itself, which is more than ten of the camera's deviations."""
    wall = np.full((CAMERA.height, CAMERA.width), 1.0, np.float32)
    poses = np.array([np.eye(4)] * 2)
    assert views(wall, wall).log_ratio(0, 1, poses) > 2.0
    # All of the points are outliers, of which there is one in ten.
    apart = views(wall, wall + np.float32(0.05)).log_ratio(0, 1, poses)
    assert apart == pytest.approx(math.log(0.1))


def test_displaced_poses_turn_the_scene_about_its_middle() -> None:
    """Turns about the scene's middle are the least known: points keep their middle, and are moved by the shift at their radius."""
    rng = np.random.default_rng(2)
    points_m = rng.normal(size=(500, 3)) * 0.2 + [0.0, 0.0, 1.5]
    points_m -= np.median(points_m, axis=0) - [0.0, 0.0, 1.5]
    pose = np.eye(4)
    pose[:3, 3] = [0.4, -0.3, 0.2]
    middle, shift_m = np.array([0.4, -0.3, 1.7]), 1e-3
    # A turn by w about the middle m moves the origin by m x w.
    free = np.linalg.inv(
        np.block([[np.eye(3), np.zeros((3, 3))], [np.cross(middle, np.eye(3)).T, np.eye(3)]])
    )
    matrix = free.T @ np.diag([1.0, 2.0, 3.0, 1e4, 1e4, 1e4]) @ free
    found = _beside(points_m, pose, matrix, shift_m)
    radius_m = np.median(np.linalg.norm(points_m - [0.0, 0.0, 1.5], axis=1))
    assert len(found) == 6
    for there in found:
        at_middle = np.array([0.0, 0.0, 1.5]) @ (there[:3, :3] - np.eye(3)).T + there[:3, 3] - pose[:3, 3]
        np.testing.assert_allclose(at_middle, 0.0, atol=1e-2 * shift_m)
        turned = Rotation.from_matrix(there[:3, :3]).magnitude()
        assert turned == pytest.approx(shift_m / radius_m, rel=0.01)
