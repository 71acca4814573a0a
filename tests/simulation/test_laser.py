"""The simulated laser against beams marched in small steps, and its noise against what it declares."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError, LaserScan
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.simulation.mobile import LaserConfig, SimulatedLaser
from visuohaptic.simulation.mobile.laser import with_outlines

QUIET = LaserConfig(beams=181, range_max_m=6.0, sigma_m=1e-9, lost_fraction=0.0)


def marched(grid: OccupancyMap, pose: tuple[float, float, float], angle: float, longest_m: float) -> float:
    """Independent of the kernel: small steps, and the map's own look-up."""
    way = np.arange(0.0, longest_m, 0.0005)
    direction = np.array([np.cos(pose[2] + angle), np.sin(pose[2] + angle)])
    values = grid.value_at(np.array(pose[:2]) + way[:, None] * direction)
    stops = np.flatnonzero((values >= 50) | (values < 0))
    return float(way[stops[0]]) if len(stops) and values[stops[0]] >= 50 else np.inf


@pytest.mark.parametrize("yaw", [0.0, 0.7, 3.14])
def test_ranges_against_small_steps(yaw: float) -> None:
    rng = np.random.default_rng(0)
    cells = np.where(rng.random((80, 90)) < 0.04, 100, 0).astype(np.int8)
    cells[60:70, 20:30] = -1
    grid = OccupancyMap(cells, 0.05, (-1.0, 2.0, yaw))
    for _ in range(5):
        cell = rng.integers(5, 75, 2)
        while cells[tuple(cell)] != 0:
            cell = rng.integers(5, 75, 2)
        x, y = grid.world_from_cell(cell) + rng.uniform(-0.02, 0.02, 2)
        pose = (float(x), float(y), float(rng.uniform(-3, 3)))
        scan = SimulatedLaser(grid, QUIET, rng).scan(pose, 1.0)
        truth = np.array([marched(grid, pose, angle, 6.0) for angle in scan.angles_rad])
        # A step of 0.5 mm; a beam that grazes a corner by less than that may be told differently.
        near = truth < scan.range_min_m + 1e-3
        same = (
            near | np.isclose(scan.ranges_m, truth, atol=6e-4) | (np.isinf(scan.ranges_m) & np.isinf(truth))
        )
        assert same.mean() > 0.97


def test_noise_and_losses_are_those_declared() -> None:
    cells = np.zeros((100, 100), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 100
    grid = OccupancyMap(cells, 0.1)
    laser = SimulatedLaser(
        grid, LaserConfig(beams=1000, sigma_m=0.02, lost_fraction=0.1), np.random.default_rng(1)
    )
    quiet = SimulatedLaser(
        grid, LaserConfig(beams=1000, sigma_m=1e-9, lost_fraction=0), np.random.default_rng(1)
    )
    pose = (5.0, 5.0, 0.3)
    errors = laser.scan(pose, 0.0).ranges_m - quiet.scan(pose, 0.0).ranges_m
    # 1000 beams: 4.5 % is two standard deviations of a standard deviation; 2.9 % three of a share.
    assert np.nanstd(errors) == pytest.approx(0.02, rel=0.07)
    assert np.isnan(errors).mean() == pytest.approx(0.1, abs=0.03)


def test_bad_scans_and_poses() -> None:
    grid = OccupancyMap(np.zeros((10, 10), np.int8), 0.1)
    with pytest.raises(InputError, match="on the map"):
        SimulatedLaser(grid, None, np.random.default_rng(0)).scan((5.0, 0.5, 0.0), 0.0)
    with pytest.raises(InputError, match="expected 1 to"):
        LaserScan(0.0, np.zeros((2, 2)), 0.0, 0.1)
    with pytest.raises(InputError, match=r"range_max_m: found .*, expected more than range_min_m"):
        LaserScan(0.0, np.ones(3), 0.0, 0.1, range_min_m=2.0, range_max_m=1.0)
    scan = LaserScan(0.0, np.array([1.0, np.inf, np.nan, 0.01]), 0.0, np.pi / 2, 0.05, 10.0)
    assert scan.hits.tolist() == [True, False, False, False]
    np.testing.assert_allclose(scan.points_m, [[1.0, 0.0]])


@pytest.mark.parametrize("centre_m", [(1.0, 1.0), (0.0, 1.0), (1.0, 0.0), (3.0, 1.0), (1.0, 2.0), (9.0, 9.0)])
def test_what_of_an_outline_is_outside_of_the_map_is_left_out(centre_m: tuple[float, float]) -> None:
    """Cells of 5 cm whose centre is within 10 cm of the middle of a square, counted on the map alone."""
    grid = OccupancyMap(np.zeros((40, 60), np.int8), 0.05, (0.0, 0.0, 0.0))
    square = 0.1 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    found = with_outlines(grid, [square + centre_m])
    across, along = (0.05 * (np.arange(count) + 0.5) for count in (60, 40))
    inside = (np.abs(along - centre_m[1]) < 0.1)[:, None] & (np.abs(across - centre_m[0]) < 0.1)
    np.testing.assert_array_equal(found.cells > 0, inside)
