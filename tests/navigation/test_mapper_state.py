"""The mapper's covariance, poses, hits and matches in closed form: odometry by hand, walls whose points are exact."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from visuohaptic.core import LaserScan, Reason
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.mapping.mapper import MapperSettings, OccupancyMapper
from visuohaptic.navigation.mapping.scan_matching import (
    HitGrid,
    MatchSettings,
    _agreement,
    _near_hits,
    _search,
    match_scan,
)

#: Walls of a room of 6 m by 4 m, about its corner.
LOW, HIGH = np.array([1.02, 1.03]), np.array([7.03, 5.01])
CELL_M = 0.05
NOTHING = LaserScan(0.0, np.full(60, np.nan), -1.0, 0.03)


def seen(pose, count=300):
    """Distances to the walls, in steps of equal angles."""
    angle = np.linspace(-math.pi, math.pi, count, endpoint=False)
    beam = np.column_stack([np.cos(angle + pose[2]), np.sin(angle + pose[2])])
    with np.errstate(divide="ignore"):
        ranges = np.where(beam > 0, (HIGH - pose[:2]) / beam, (LOW - pose[:2]) / beam).min(axis=1)
    return LaserScan(0.0, ranges, -math.pi, 2 * math.pi / count)


def walls():
    """A grid whose hits are points of the walls, 2 cm apart: the mean of each cell is on its wall."""
    x, y = np.arange(LOW[0], HIGH[0], 0.02), np.arange(LOW[1], HIGH[1], 0.02)
    points = np.concatenate(
        [[[a, b] for a in x for b in (LOW[1], HIGH[1])], [[a, b] for b in y for a in (LOW[0], HIGH[0])]]
    )
    grid = HitGrid.unknown((130, 170), CELL_M, np.zeros(2))
    places = points / CELL_M
    cells = np.floor(places).astype(int)
    for (column, row), (x, y) in zip(cells, places, strict=True):
        count = grid.count[row, column]
        grid.mean_row[row, column] = (count * grid.mean_row[row, column] + y) / (count + 1)
        grid.mean_column[row, column] = (count * grid.mean_column[row, column] + x) / (count + 1)
        grid.count[row, column] += 1
    inside = np.s_[21:99, 21:140]
    grid.log_odds[inside] = -4.0
    grid.stamp[20:101, 20:141] = 1
    return grid


def test_without_a_scan_the_pose_and_its_variance_are_those_of_the_odometry():
    settings = MapperSettings(
        odometry_sigma_per_m=0.2,
        odometry_sigma_rad_per_rad=0.3,
        odometry_sigma_rad_per_m=0.07,
        odometry_floor=(0.01, 0.02),
    )
    mapper = OccupancyMapper(settings)
    odometry = [(1.0, 2.0, 0.5), (1.3, 2.4, 0.9), (1.3, 2.4, 0.2), (0.9, 2.1, 0.2)]
    variance = np.array([1e-6, 1e-6, 1e-6])
    for k, pose in enumerate(odometry):
        match = mapper.locate(NOTHING, pose)
        assert (match.valid, match.reason) == (False, Reason.LOST)
        if k:
            path = math.hypot(pose[0] - odometry[k - 1][0], pose[1] - odometry[k - 1][1])
            turn = abs(pose[2] - odometry[k - 1][2])
            place = (0.2 * path) ** 2 + 0.01**2
            variance += np.array([place, place, (0.3 * turn + 0.07 * path) ** 2 + 0.02**2])
        np.testing.assert_allclose(match.covariance, np.diag(variance), rtol=1e-9)
        np.testing.assert_allclose(match.pose, pose, atol=1e-12)
    np.testing.assert_allclose(mapper.trajectory, odometry, atol=1e-12)
    assert mapper.pose == match.pose


def test_the_map_frame_is_that_of_the_first_pose_and_steps_are_those_of_another_frame():
    """Odometry that begins elsewhere: each step is turned into the frame of the map's pose."""
    mapper = OccupancyMapper.from_map(
        OccupancyMap(np.zeros((9, 9), np.int8), 0.1), (5.0, 5.0, math.pi / 2), (1.0, 1.0, 0.0)
    )
    match = mapper.locate(NOTHING, (2.0, 1.5, 0.25))
    # A metre ahead is along y now, half a metre to the left along -x.
    np.testing.assert_allclose(match.pose, (4.5, 6.0, math.pi / 2 + 0.25), atol=1e-12)


@pytest.mark.parametrize(
    ("step_m", "turn_rad", "added"), [(0.05, 0.0, 6), (0.16, 0.0, 14), (0.0, 0.02, 8), (0.0, 0.0, 2)]
)
def test_scans_are_added_every_15_cm_or_30_mrad(step_m, turn_rad, added):
    """Two to begin with; of the twelve after these every third, each, every second, none."""
    mapper = OccupancyMapper()
    for k in range(14):
        pose = (2.0 + step_m * k, 3.0, turn_rad * k)
        assert mapper.add(seen(pose), pose).valid
    # Twelve steps of 5 cm are 15 cm, four times, but for rounding.
    assert abs(mapper._added - added) <= (1 if 0.0 < step_m < 0.1 else 0)
    assert int(mapper._grid.stamp.max()) == mapper._added


def test_after_fifteen_scans_that_do_not_fit_the_next_one_begins_anew():
    mapper = OccupancyMapper()
    for k in range(3):
        mapper.add(seen((2.0 + 0.2 * k, 3.0, 0.0)), (2.0 + 0.2 * k, 3.0, 0.0))
    before = mapper._added
    noise = LaserScan(0.0, np.random.default_rng(0).uniform(0.2, 0.7, 300), -math.pi, 2 * math.pi / 300)
    found = [mapper.add(noise, (2.4, 3.0, 0.0)).valid for _ in range(16)]
    assert found == [False] * 15 + [True]
    assert mapper._added == before + 1


def test_hits_are_averaged_by_cell():
    """Every beam of two scans from one place counts once; a cell's mean is that of the points in it."""
    mapper = OccupancyMapper(MapperSettings(well_known=2.0))
    scans = [seen((2.0, 3.0, 0.0)), seen((2.0, 3.0, 0.003), 400)]
    points = []
    for scan, turn in zip(scans, (0.0, 0.003), strict=True):
        mapper.add(scan, (2.0, 3.0, turn))
        angles = scan.angles_rad + turn
        points.append([2.0, 3.0] + scan.ranges_m[:, None] * np.column_stack([np.cos(angles), np.sin(angles)]))
    points = np.concatenate(points)
    corner = mapper._grid.corner_m
    cells = np.floor((points - corner) / CELL_M).astype(int)
    _, number = np.unique(cells, axis=0, return_inverse=True)
    truth = np.array([points[number == k].mean(axis=0) for k in range(number.max() + 1)])
    found = mapper.mean_hits_m()
    # Cells beside the walls that later beams pass lose their hits.
    assert 0.8 * len(truth) < len(found) <= len(truth)
    away = np.hypot(*(found[:, None] - truth[None]).transpose(2, 0, 1)).min(axis=1)
    assert away.max() < 2e-5
    counts = np.bincount(number)
    assert mapper._grid.count.sum() <= counts.sum()
    assert mapper._grid.count.max() <= min(counts.max(), 50)


def test_the_map_has_the_seen_part_at_its_place():
    mapper = OccupancyMapper()
    scan = seen((2.0, 3.0, 0.0))
    for _ in range(3):
        mapper.add(scan, (2.0, 3.0, 0.0))
    grid = mapper.map()
    assert np.abs(np.subtract(grid.shape[::-1], (HIGH - LOW) / CELL_M)).max() <= 2.0
    beams = np.column_stack([np.cos(scan.angles_rad), np.sin(scan.angles_rad)])
    ends, ahead = ([2.0, 3.0] + share * scan.ranges_m[:, None] * beams for share in (1.0, 0.7))
    assert (grid.value_at(ahead) == 0).all()
    assert (grid.value_at(ends) == 100).all()
    assert not grid.inside(grid.cell_from_world(np.array([0.5, 3.0])))


POSE = (3.4, 2.7, 0.4)
SURE = np.diag([0.03**2, 0.03**2, 0.02**2])


def points_of(pose, count=300):
    scan = seen(pose, count)
    return scan.ranges_m[:, None] * np.column_stack([np.cos(scan.angles_rad), np.sin(scan.angles_rad)])


@pytest.mark.parametrize(
    "off", [(0.0, 0.0, 0.0), (0.22, 0.0, 0.0), (0.0, -0.25, 0.0), (-0.15, 0.2, 0.12), (0.0, 0.0, -0.14)]
)
def test_exact_points_have_an_exact_pose_from_anywhere_in_the_window(off):
    wide = np.diag([1.0, 1.0, 1.0])
    guess = tuple(np.add(POSE, off).tolist())
    match = match_scan(walls(), points_of(POSE), guess, wide, 7.0)
    assert match.valid
    assert match.t_s == pytest.approx(7.0)
    np.testing.assert_allclose(match.pose, POSE, atol=2e-4)
    assert match.inliers == pytest.approx(1.0)
    assert match.residual_m < 2e-3  # in the corners, lines are those of two walls
    # Information of all points: their normals, and their levers, with 2 cm each; corners have no line.
    points = points_of(POSE) @ np.array([[math.cos(0.4), math.sin(0.4)], [-math.sin(0.4), math.cos(0.4)]])
    at = points + POSE[:2]
    along_x = np.minimum(np.abs(at[:, 0] - LOW[0]), np.abs(at[:, 0] - HIGH[0])) < 1e-6
    normal = np.where(along_x[:, None], [1.0, 0.0], [0.0, 1.0])
    jacobian = np.column_stack([normal, normal[:, 1] * points[:, 0] - normal[:, 0] * points[:, 1]])
    information = jacobian.T @ jacobian / 0.02**2 + np.linalg.inv(wide)
    np.testing.assert_allclose(
        np.sqrt(np.diag(match.covariance)), np.sqrt(np.diag(np.linalg.inv(information))), rtol=0.06
    )


def test_the_odometry_is_a_measurement_like_the_points():
    """As many points as there are, or a tenth of a millimetre of odometry: the mean by information."""
    off = np.array([0.004, -0.003, 0.001])
    guess = tuple((np.array(POSE) + off).tolist())
    free = match_scan(walls(), points_of(POSE), guess, np.diag([1.0, 1.0, 1.0]), 0.0)
    points = np.linalg.inv(free.covariance) - np.eye(3)
    for sigma_m in (1e-4, 1e-3, 5e-3):
        prior = np.diag([sigma_m**-2, sigma_m**-2, sigma_m**-2])
        match = match_scan(walls(), points_of(POSE), guess, np.linalg.inv(prior), 0.0)
        expected = np.linalg.solve(points + prior, prior @ off)
        np.testing.assert_allclose(np.subtract(match.pose, POSE), expected, atol=3e-4)
        np.testing.assert_allclose(match.covariance, np.linalg.inv(points + prior), rtol=0.05, atol=1e-9)


@pytest.mark.parametrize(("share", "valid"), [(0.28, False), (0.42, True)])
def test_a_third_of_the_points_has_to_be_near_hits(share, valid):
    """The others are in the middle of the room, which is known to be free."""
    points = points_of(POSE)
    wrong = np.random.default_rng(2).permutation(len(points))[: round((1 - share) * len(points))]
    points[wrong] *= 0.4
    match = match_scan(walls(), points, POSE, 1e-2 * SURE, 0.0)
    assert match.inliers == pytest.approx(share, abs=0.02)
    assert match.valid == valid
    assert match.reason is (Reason.OK if valid else Reason.LOST)
    if not valid:
        assert match.pose == POSE
        np.testing.assert_array_equal(match.covariance, 1e-2 * SURE)


def test_few_points_are_no_scan_and_an_unknown_place_is_taken_from_the_odometry():
    assert not match_scan(walls(), points_of(POSE)[:39], POSE, SURE, 0.0).valid
    assert match_scan(walls(), points_of(POSE, 60), POSE, SURE, 0.0).valid
    away = match_scan(walls(), points_of(POSE), (40.0, -30.0, 0.1), SURE, 0.0)
    assert away.valid
    assert away.pose == pytest.approx((40.0, -30.0, 0.1))
    assert away.inliers == 0.0
    known, near = _agreement(walls(), points_of(POSE), POSE, MatchSettings())
    assert known == near == 300
    known, near = _agreement(walls(), 0.5 * points_of(POSE), POSE, MatchSettings())
    assert near < 40 < 250 < known
    assert _agreement(walls(), 3.0 * points_of(POSE), POSE, MatchSettings()) == (0, 0)


def test_the_search_is_over_shifts_of_cells_and_steps_of_angle():
    off = np.array([0.2, -0.15, 0.09])
    found = _search(
        walls(), points_of(POSE), tuple((np.array(POSE) + off).tolist()), np.eye(3), MatchSettings()
    )
    assert np.abs(np.subtract(found, POSE))[:2].max() <= CELL_M
    assert abs(found[2] - POSE[2]) <= 0.016
    steps = (np.subtract(found, POSE) - off) / [CELL_M, CELL_M, 0.015]
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)
    # A sure odometry holds the pose where it is.
    sure = _search(
        walls(), points_of(POSE), tuple((np.array(POSE) + off).tolist()), 1e-8 * np.eye(3), MatchSettings()
    )
    np.testing.assert_allclose(sure, np.array(POSE) + off, atol=1e-9)
    narrow = replace(MatchSettings(), window_m=0.1, window_rad=0.03)
    held = np.subtract(
        _search(walls(), points_of(POSE), tuple((np.array(POSE) + off).tolist()), np.eye(3), narrow), POSE
    )
    assert np.abs(held - off)[:2].max() <= 0.1 + 1e-9
    assert abs(held[2] - off[2]) <= 0.03 + 1e-9


def test_cells_beside_hits_count_by_their_distance_and_unknown_ones_as_beside_a_hit():
    count, stamp = np.zeros((12, 12), np.float32), np.ones((12, 12), np.int32)
    count[5, 5] = 3
    stamp[:, 10:] = 0
    near = _near_hits(count, stamp)
    assert near[5, 5] == pytest.approx(1.0)
    assert near[5, 6] == near[4, 5] == pytest.approx(math.exp(-0.5), rel=0.1)
    assert near[5, 7] == pytest.approx(math.exp(-2.0), rel=0.2)
    assert near[5, 9] < 1e-3
    np.testing.assert_allclose(near[:, 10:], math.exp(-0.5), rtol=1e-6)
    assert _near_hits(count[:0], stamp[:0]).size == 0
