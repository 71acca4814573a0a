"""The mapper in a synthetic office: kernels compared with plain twins, poses and map with the truth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from benchmarks._nav_walks import agreement, drifted, smooth_way

from visuohaptic.core import InputError, LaserScan, Reason
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.mapping import MapperSettings, OccupancyMapper, match_scan
from visuohaptic.navigation.mapping._mapper_kernels import add_beams, correlate, nearest_lines
from visuohaptic.navigation.mapping.scan_matching import FREE_LOG_ODDS, HitGrid, MatchSettings, _agreement
from visuohaptic.simulation.mobile import LaserConfig, SimulatedLaser, furnished_office

OFFICE = furnished_office()
GRID = OFFICE.map
LOOP = [(1.2, 1.6), (4.2, 1.4), (6.2, 2.9), (7.0, 1.6), (6.0, 2.9), (4.2, 3.0), (2.5, 4.8), (1.2, 1.6)]


def test_points_outside_of_the_map_are_neither_known_nor_near() -> None:
    """Counted point by point, without arrays; the scan reaches far beyond every side of a map whose edge cells are free."""
    rng = np.random.default_rng(4)
    grid = HitGrid.unknown((12, 17), 0.1, np.array([-0.4, 0.7]))
    grid.log_odds[:] = np.where(rng.random((12, 17)) < 0.5, FREE_LOG_ODDS - 1.0, 0.0)
    grid.log_odds[[0, -1]] = grid.log_odds[:, [0, -1]] = FREE_LOG_ODDS - 1.0
    pose, points_m = (0.3, 1.2, 0.4), rng.uniform(-3.0, 3.0, (400, 2))
    known = 0
    for x, y in points_m:
        at_x = pose[0] + math.cos(pose[2]) * x - math.sin(pose[2]) * y
        at_y = pose[1] + math.sin(pose[2]) * x + math.cos(pose[2]) * y
        column, row = math.floor((at_x + 0.4) / 0.1), math.floor((at_y - 0.7) / 0.1)
        known += 0 <= row < 12 and 0 <= column < 17 and grid.log_odds[row, column] < FREE_LOG_ODDS
    assert 0 < known < 100
    assert _agreement(grid, points_m, pose, MatchSettings()) == (known, 0)


def test_beams_against_small_steps() -> None:
    rng = np.random.default_rng(0)
    log_odds = np.zeros((40, 50), np.float32)
    stamp = np.zeros((40, 50), np.int32)
    start = np.array([20.3, 24.6])
    ends = np.column_stack([rng.uniform(-5, 45, 200), rng.uniform(-5, 55, 200)])
    hits = rng.random(200) < 0.7
    add_beams(log_odds, stamp, 1, start[0], start[1], ends, hits, 0.85, -0.4, 5.0)
    plain = np.zeros((40, 50))
    for end in ends:
        cells = np.floor(start + np.linspace(0, 1, 20_000, endpoint=False)[:, None] * (end - start)).astype(
            int
        )
        inside = ((cells >= 0) & (cells < plain.shape)).all(axis=1) & (cells != np.floor(end)).any(axis=1)
        plain[cells[inside, 0], cells[inside, 1]] = -0.4
    for end in ends[hits]:
        i, j = (int(math.floor(v)) for v in end)
        if 0 <= i < 40 and 0 <= j < 50:
            plain[i, j] = 0.85
    # The small steps may pass over a corner of a cell that is shorter than a step.
    assert np.mean(np.isclose(log_odds, plain, atol=1e-6)) > 0.995
    np.testing.assert_allclose(log_odds[plain == np.float64(0.85)], 0.85, atol=1e-6)
    for number in range(2, 30):
        add_beams(log_odds, stamp, number, start[0], start[1], ends, hits, 0.85, -0.4, 5.0)
    assert log_odds.max() == 5.0
    assert log_odds.min() == -5.0


def test_correlation_against_the_definition() -> None:
    rng = np.random.default_rng(1)
    field = rng.random((30, 40)).astype(np.float32)
    points = rng.uniform(-8, 8, (20, 2))
    rows, columns, angles = np.array([14.2, 15.2]), np.array([20.7, 21.7, 22.7]), np.array([-0.1, 0.0, 0.3])
    score = correlate(field, points, rows, columns, np.cos(angles), np.sin(angles))
    for t, angle in enumerate(angles):
        # A point (row, column) = (y, x) turned counter-clockwise.
        x, y = points[:, 1], points[:, 0]
        turned = np.column_stack(
            [np.sin(angle) * x + np.cos(angle) * y, np.cos(angle) * x - np.sin(angle) * y]
        )
        for a, row in enumerate(rows):
            for b, column in enumerate(columns):
                cells = np.floor(turned + np.array([row, column])).astype(int)
                inside = ((cells >= 0) & (cells < field.shape)).all(axis=1)
                total = field[cells[inside, 0], cells[inside, 1]].sum() / len(points)
                assert score[t, a, b] == pytest.approx(total, rel=1e-5)


def test_lines_are_the_walls_that_made_them() -> None:
    # Means along y = 0.5 x + 3 (row over column): the normal of every line is known.
    columns = np.arange(5, 35)
    rows = 0.5 * (columns + 0.5) + 3.0
    mean_row, mean_column, count = (np.zeros((40, 40), np.float32) for _ in range(3))
    for row, column in zip(rows, columns, strict=True):
        cell = (int(row), int(column))
        mean_row[cell], mean_column[cell], count[cell] = row, column + 0.5, 3
    points = np.column_stack([rows[5:25] + 1.0, columns[5:25] + 0.5])
    lines = nearest_lines(mean_row, mean_column, count, points, 3)
    assert (lines[:, 4] > 0.9).all()
    normal = np.array([1.0, -0.5]) / np.hypot(1, 0.5)
    np.testing.assert_allclose(np.abs(lines[:, 2:4] @ normal), 1.0, atol=1e-5)
    distance = np.abs(np.einsum("ij,ij->i", points - lines[:, :2], lines[:, 2:4]))
    # float32 places of about 20 cells.
    np.testing.assert_allclose(distance, 1.0 / np.hypot(1, 0.5), atol=1e-5)
    assert (nearest_lines(mean_row, mean_column, count, points + np.array([12.0, 0]), 3)[:, 4] == 0).all()


def walked(seed: int = 0) -> tuple[OccupancyMapper, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    truth = smooth_way(GRID, LOOP)
    odometry = drifted(truth, rng)
    laser = SimulatedLaser(GRID, LaserConfig(), rng)
    mapper = OccupancyMapper()
    for number, (pose, wheels) in enumerate(zip(truth, odometry, strict=True)):
        mapper.add(laser.scan(tuple(pose), 0.1 * number), tuple(wheels))
    return mapper, truth, odometry


def test_a_walk_through_the_office() -> None:
    mapper, truth, odometry = walked()
    error = np.hypot(*(mapper.trajectory - truth)[:, :2].T)
    wheels = np.hypot(*(odometry - truth)[:, :2].T)
    # A cell is 5 cm; the wheels alone are off by ten times as much.
    assert np.median(error) < 0.05
    assert error.max() < 0.12
    assert wheels.max() > 5 * error.max()
    assert all(match.valid for match in mapper.matches)
    found = agreement(mapper.map(), GRID)
    assert found["free_iou"] > 0.9
    assert found["wall_precision"] > 0.9


def test_bad_scans_are_refused_and_the_pose_goes_on() -> None:
    rng = np.random.default_rng(2)
    truth = smooth_way(GRID, LOOP)[:60]
    laser = SimulatedLaser(GRID, LaserConfig(), rng)
    mapper = OccupancyMapper()
    for number, pose in enumerate(truth):
        scan = laser.scan(tuple(pose), 0.1 * number)
        if number in (30, 31):  # a hand before the scanner: short distances all round
            scan = LaserScan(
                scan.t_s, rng.uniform(0.1, 0.3, len(scan.ranges_m)), scan.angle_min_rad, scan.angle_step_rad
            )
        if number == 33:
            scan = LaserScan(
                scan.t_s, np.full(len(scan.ranges_m), np.nan), scan.angle_min_rad, scan.angle_step_rad
            )
        if number == 35:
            scan = LaserScan(
                scan.t_s,
                scan.ranges_m,
                scan.angle_min_rad,
                scan.angle_step_rad,
                valid=False,
                reason=Reason.STALE,
            )
        mapper.add(scan, tuple(pose))
    refused = [number for number, match in enumerate(mapper.matches) if not match.valid]
    assert refused == [30, 31, 33, 35]
    assert mapper.matches[35].reason is Reason.STALE
    error = np.hypot(*(mapper.trajectory - truth)[:, :2].T)
    assert error.max() < 0.05, "the map was not spoilt"


def test_the_covariance_says_what_a_corridor_cannot_tell() -> None:
    # Two bare walls: the way along them comes from the wheels alone.
    cells = np.zeros((40, 400), np.int8)
    cells[[0, 1, -2, -1]] = 100
    grid = OccupancyMap(cells, 0.05)
    rng = np.random.default_rng(3)
    laser = SimulatedLaser(grid, LaserConfig(range_max_m=4.0), rng)
    mapper = OccupancyMapper(MapperSettings(odometry_floor=(0.03, 0.02)))
    for number in range(30):
        pose = (8.0 + 0.08 * number, 1.0, 0.0)
        match = mapper.add(laser.scan(pose, 0.1 * number), pose)
    along, across, _ = np.sqrt(np.diag(match.covariance))
    assert along > 0.02
    assert across < 0.005


@pytest.mark.parametrize("odometry_scale", [1.0, 1.02])
def test_of_equal_places_the_one_that_the_odometry_expects_is_taken(odometry_scale: float) -> None:
    """Posts every 25 cm on both sides: a scan fits as well one post behind, where more of it is on the map already."""
    cells = np.zeros((40, 160), np.int8)
    cells[[0, 1, -2, -1]] = 100
    cells[np.ix_([2, 3, -4, -3], np.arange(160) % 5 < 2)] = 100
    laser = SimulatedLaser(OccupancyMap(cells, 0.05), LaserConfig(range_max_m=2.0), np.random.default_rng(1))
    mapper = OccupancyMapper()
    for number in range(25):
        true_m = 3.0 + 0.1 * number
        mapper.add(laser.scan((true_m, 1.0, 0.0), 0.1 * number), (odometry_scale * true_m, 1.0, 0.0))
        # Half a period would be a place between posts; what the wheels have gained is less than 5 cm.
        assert mapper.pose[0] - odometry_scale * 3.0 == pytest.approx(0.1 * number, abs=0.1)
    # The prior decides between two places that are both on the map.
    points, sure = laser.scan((4.2, 1.0, 0.0), 2.5).points_m, np.diag([0.04**2, 0.04**2, 0.02**2])
    here = 4.2 + mapper.pose[0] - true_m
    for shift_m in (-0.06, 0.0, 0.06):
        match = match_scan(mapper._grid, points, (here + shift_m, 1.0, 0.0), sure, 2.5)
        assert match.pose[0] == pytest.approx(here, abs=0.06)


def test_settings_and_inputs_are_checked() -> None:
    with pytest.raises(InputError, match="resolution"):
        MapperSettings(resolution_m=0.0)
    mapper = OccupancyMapper()
    with pytest.raises(InputError, match="no scan was added"):
        mapper.map()
    with pytest.raises(InputError, match="finite"):
        mapper.add(LaserScan(0.0, np.ones(100), 0.0, 0.01), (math.nan, 0.0, 0.0))
    for far_m in (9e4, 1e300):  # of the latter, no integer can count the cells
        far = LaserScan(0.0, np.full(100, far_m), 0.0, 0.06, range_max_m=2 * far_m)
        with pytest.raises(InputError, match="would grow"):
            mapper.add(far, (0.0, 0.0, 0.0))


def test_the_covariance_of_a_match_covers_its_errors() -> None:
    rng = np.random.default_rng(5)
    truth = smooth_way(GRID, LOOP)
    laser = SimulatedLaser(GRID, LaserConfig(), rng)
    sure = MapperSettings(
        odometry_floor=(1e-5, 1e-5),
        odometry_sigma_per_m=1e-5,
        odometry_sigma_rad_per_rad=1e-5,
        odometry_sigma_rad_per_m=1e-5,
    )
    mapper = OccupancyMapper(sure)  # with wheels that are never wrong: the map is as good as it gets
    for number, pose in enumerate(truth):
        mapper.add(laser.scan(tuple(pose), 0.1 * number), tuple(pose))
    spread = np.diag([0.05**2, 0.05**2, 0.03**2])
    distances = []
    for _ in range(120):
        pose = truth[rng.integers(len(truth))] + rng.uniform(-0.03, 0.03, 3)
        guess = pose + rng.multivariate_normal(np.zeros(3), spread)
        match = match_scan(mapper._grid, laser.scan(tuple(pose), 0.0).points_m, tuple(guess), spread, 0.0)
        error = np.array(match.pose) - pose
        assert match.valid
        assert np.hypot(*error[:2]) < 0.02
        distances.append(error @ np.linalg.inv(match.covariance) @ error)
    # Three degrees of freedom: a mean of 3. Declared for walls that are not straight (2 cm), so that in this
    # office with its straight ones the covariance may be wide by a factor of two, but not too narrow.
    assert 0.75 < np.mean(distances) < 3.5
    # Wheels that are off by five cells across or along: further than the refinement reaches without the search.
    vague = np.diag([0.2**2, 0.2**2, 0.03**2])
    for shift in ((0.0, -0.25, 0.0), (0.0, 0.25, 0.0), (-0.25, 0.0, 0.0), (0.25, 0.0, 0.0)):
        points = laser.scan(tuple(pose), 0.0).points_m
        match = match_scan(mapper._grid, points, tuple(pose + shift), vague, 0.0)
        assert match.valid
        assert np.hypot(*(np.array(match.pose) - pose)[:2]) < 0.02


def test_a_map_that_grows_keeps_its_hits() -> None:
    """By different numbers of cells on all four sides."""
    mapper = OccupancyMapper()
    laser = SimulatedLaser(GRID, LaserConfig(), np.random.default_rng(0))
    mapper.add(laser.scan((1.2, 1.6, 0.0), 0.0), (1.2, 1.6, 0.0))
    before, size = mapper.mean_hits_m(), mapper._grid.log_odds.shape
    mapper._make_room(np.array([[-40.0, -25.0], [60.0, 30.0]]))
    assert min(np.subtract(mapper._grid.log_odds.shape, size)) > 500
    # Places of some thousand cells of 5 cm in single precision.
    np.testing.assert_allclose(mapper.mean_hits_m(), before, atol=2e-5)


@pytest.mark.parametrize("cells_thick", [1, 4])
def test_walls_of_any_thickness_locate_a_scan(cells_thick: int) -> None:
    """Beams end on the faces of a wall, however much of it is filled in behind them."""
    cells = np.full((100, 140), -1, np.int8)
    cells[10 - cells_thick : 90 + cells_thick, 10 - cells_thick : 130 + cells_thick] = 100
    cells[10:90, 10:130] = 0
    low, high, pose = np.array([0.5, 0.5]), np.array([6.5, 4.5]), (2.0, 1.5, 0.3)
    angle = np.linspace(-2.3, 2.3, 360)
    beam = np.column_stack([np.cos(angle + pose[2]), np.sin(angle + pose[2])])
    ranges = np.where(beam > 0, (high - pose[:2]) / beam, (low - pose[:2]) / beam).min(axis=1)
    ranges += 0.01 * np.random.default_rng(0).standard_normal(len(ranges))
    mapper = OccupancyMapper.from_map(OccupancyMap(cells, 0.05), (2.06, 1.45, 0.33), pose)
    for turn in range(4):
        match = mapper.locate(LaserScan(0.1 * turn, ranges, -2.3, 4.6 / 359), pose)
    assert match.valid
    # The face of a wall is half a cell before the middle of its cells.
    assert np.abs(np.subtract(match.pose[:2], pose[:2])).max() < 0.025
    assert abs(match.pose[2] - pose[2]) < math.radians(0.5)


def test_a_map_kept_with_its_hits_locates_as_finely_as_its_mapper() -> None:
    """Also where the map ends at its outer walls: half a cell (2.5 cm) is lost without the hits, metres without the walls."""
    low, high, rng = np.array([0.5, 0.5]), np.array([6.52, 4.53]), np.random.default_rng(0)
    angle = np.linspace(-2.3, 2.3, 360)

    def scan(pose: tuple[float, float, float], t_s: float) -> LaserScan:
        beam = np.column_stack([np.cos(angle + pose[2]), np.sin(angle + pose[2])])
        ranges = np.where(beam > 0, (high - pose[:2]) / beam, (low - pose[:2]) / beam).min(axis=1)
        return LaserScan(t_s, ranges + 0.01 * rng.standard_normal(len(ranges)), -2.3, 4.6 / 359)

    mapper, poses = OccupancyMapper(), [(2.0 + 0.1 * k, 1.5, 0.2 * k) for k in range(30)]
    for k, pose in enumerate(poses):
        mapper.add(scan(pose, 0.1 * k), pose)
    again = OccupancyMapper.from_map(mapper.map(), poses[0], poses[0], hits_m=mapper.mean_hits_m())
    errors = [
        np.subtract(again.locate(scan(pose, 10.0 + 0.1 * k), pose).pose, pose) for k, pose in enumerate(poses)
    ]
    # A hundred points and more on each wall, with a noise of 1 cm: 1 mm; the map's own errors are as large.
    assert np.sqrt(np.mean(np.square(errors), axis=0))[:2].max() < 0.004


def test_a_map_that_exists_locates_a_platform_whose_wheels_slip() -> None:
    """Ten metres and more in a drawn house: wheels are off by decimetres, scans by less than a cell of 5 cm."""
    from visuohaptic.simulation.houses import GuidedPlatform, random_house

    house = random_house(2)
    corners = np.array(house.tour_m[-2:])
    start = (float(corners[1, 0]), float(corners[1, 1]), house.heading_rad)
    platform = GuidedPlatform(house, start, np.random.default_rng(0), np.random.default_rng(1))
    mapper = OccupancyMapper.from_map(house.grid, start, platform.odometry())
    there = float(np.hypot(*(corners[0] - corners[1])))
    for _ in range(4):  # to and fro
        for k in range(round(there / 0.1)):
            platform.go((0.1, 0.0, 0.0))
            match = mapper.locate(platform.scan(), platform.odometry())
            assert match.valid, k
            assert np.hypot(match.pose[0] - platform.pose[0], match.pose[1] - platform.pose[1]) < 0.05
        for _ in range(12):
            platform.go((0.0, 0.0, np.pi / 12))
            mapper.locate(platform.scan(), platform.odometry())
    turned = OccupancyMap(house.grid.cells, house.grid.resolution_m, (0.0, 0.0, 0.3))
    with pytest.raises(InputError, match=r"found an origin turned by 0.3 rad"):
        OccupancyMapper.from_map(turned, start, platform.odometry())
