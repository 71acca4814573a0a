"""Distances compared with brute force, costs compared with Eq. (4.1)."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.grid import SpeedLimits, grid_layers, window_distance
from visuohaptic.navigation.grid._distance_kernels import SWEPT_REACH
from visuohaptic.navigation.grid.cost_grid import cell_distance

from .random_maps import RADII_M, random_map


def squares_distance(blocked: np.ndarray) -> np.ndarray:
    """Distance of every cell's centre from the border of the nearest blocked cell's square [cells], pair by pair."""
    rows, columns = np.indices(blocked.shape)
    nearest = np.full(blocked.shape, np.inf)
    for row, column in np.argwhere(blocked):
        aside = np.maximum(np.abs(columns - column) - 0.5, 0.0)
        np.minimum(nearest, np.hypot(np.maximum(np.abs(rows - row) - 0.5, 0.0), aside), out=nearest)
    return nearest


def test_distances_and_reachable_cells_are_those_from_the_squares_of_obstacles():
    rng = np.random.default_rng(0)
    for _ in range(300):
        grid = random_map(rng)
        limits = SpeedLimits(float(rng.choice(RADII_M)))
        free = bool(rng.integers(2))
        layers = grid_layers(grid, limits, unknown_is_free=free)
        obstacle = (grid.cells >= 50) | ((grid.cells < 0) & (not free))
        if free and not obstacle.any():
            assert np.isinf(layers.distance_m).all()
            assert layers.reachable.all()
            continue
        # Unknown is what lies outside, too.
        around = np.pad(obstacle, 1, constant_values=not free)
        truth_m = squares_distance(around)[1:-1, 1:-1] * grid.resolution_m
        # Single precision: 2^-24 of up to 7 m.
        np.testing.assert_allclose(layers.distance_m, truth_m, atol=5e-7)
        clear = np.abs(truth_m - limits.radius_m) > 1e-9
        np.testing.assert_array_equal(layers.reachable[clear], (truth_m >= limits.radius_m)[clear])


def test_the_cost_is_equation_4_1():
    limits = SpeedLimits(0.2, v_max_m_s=0.4, v_min_m_s=0.1)
    cost = limits.cost_s_per_m(np.array([0.0, 0.199, 0.2, 0.4, 0.6, 5.0, np.inf]))
    np.testing.assert_allclose(cost, [np.inf, np.inf, 10.0, 6.25, 2.5, 2.5, 2.5])


def test_steps_are_the_cost_in_whole_units():
    grid = random_map(np.random.default_rng(3))
    layers = grid_layers(grid, SpeedLimits(0.2))
    reachable = layers.reachable
    cost = layers.cost_s_per_m
    assert np.isinf(cost[~reachable]).all()
    # Half a unit of 1/4096 of the fastest step.
    np.testing.assert_allclose(
        layers.step[reachable] * layers.unit_s, cost[reachable] * 0.1, atol=0.51 * layers.unit_s
    )


@pytest.mark.parametrize("yaw", [0.0, 0.4])
def test_a_robot_passes_no_hole_that_is_narrower_than_itself(yaw):
    for cells_wide in range(3, 12):
        cells = np.zeros((40, 41), np.int8)
        cells[:, 20] = 100
        cells[14 : 14 + cells_wide, 20] = 0
        grid = OccupancyMap(cells, 0.05, (0.0, 0.0, yaw))
        hole_m = 0.05 * cells_wide
        for radius_m in (0.12, 0.17, 0.2, 0.26):
            open_m = grid_layers(grid, SpeedLimits(radius_m)).reachable[:, 20].any()
            # Not where the robot touches; an even number of cells has no cell in its middle: up to a cell is lost.
            assert not (open_m and hole_m < 2 * radius_m - 1e-9)
            assert open_m or hole_m < 2 * radius_m + 0.05 + 1e-9


def test_a_radius_of_whole_cells_reaches_cells_exactly_as_far():
    cells = np.zeros((1, 30), np.int8)
    cells[0, 0] = 100
    for resolution_m in (0.05, 0.1, 0.02, 0.0504):
        for count in range(1, 12):
            limits = SpeedLimits((count - 0.5) * resolution_m)  # from the border of the cell
            strip = OccupancyMap(cells, resolution_m)  # a single row: its border does not count
            reachable = grid_layers(strip, limits, unknown_is_free=True).reachable[0]
            assert reachable.argmax() == count


def test_a_long_column_without_obstacles_is_far_from_those_of_others():
    cells = np.zeros((70_000, 2), np.int8)
    cells[0, 0] = 100
    layers = grid_layers(OccupancyMap(cells, 0.05), SpeedLimits(0.2), unknown_is_free=True)
    np.testing.assert_allclose(layers.distance_m[60_000], 0.05 * np.hypot(59_999.5, [0, 0.5]), rtol=1e-6)


@pytest.mark.parametrize(
    ("words", "field"),
    [
        ({"radius_m": 0.0}, "radius_m"),
        ({"radius_m": float("nan")}, "radius_m"),
        ({"radius_m": 0.2, "v_min_m_s": -1.0}, "v_min_m_s"),
        ({"radius_m": 0.2, "v_max_m_s": 0.01}, "v_max_m_s"),
    ],
)
def test_limits_that_mean_nothing_are_refused(words, field):
    with pytest.raises(InputError, match=field):
        SpeedLimits(**words)


def test_a_radius_of_thousands_of_cells_is_refused():
    with pytest.raises(InputError, match="at most 666 cells"):
        grid_layers(OccupancyMap(np.zeros((2, 2), np.int8), 0.001), SpeedLimits(5.0))


def test_windows_measure_as_the_whole_map_does():
    rng = np.random.default_rng(5)
    for _ in range(100):
        grid = random_map(rng)
        free = bool(rng.integers(2))
        whole = grid_layers(grid, SpeedLimits(0.2), unknown_is_free=free).distance_m / np.float32(0.1)
        blocked = (grid.cells >= 50) | ((grid.cells < 0) & (not free))
        rows, columns = (slice(*sorted(int(i) for i in rng.integers(0, n + 1, 2))) for n in grid.shape)
        if rows.start == rows.stop or columns.start == columns.stop:
            continue
        part = window_distance(blocked[rows, columns], (rows, columns), grid.shape, outside_blocks=not free)
        # A window may not know of what lies beyond it, but never tells of more than is there.
        assert (part >= whole[rows, columns] - 1e-4).all()
        every = (slice(0, grid.shape[0]), slice(0, grid.shape[1]))
        np.testing.assert_allclose(
            window_distance(blocked, every, grid.shape, outside_blocks=not free), whole, rtol=1e-5
        )


def test_a_robot_keeps_off_the_border_as_off_an_unknown_cell_beyond_it():
    room = OccupancyMap(np.zeros((9, 9), np.int8), 0.1)
    inside = np.zeros((9, 9), bool)
    inside[3:6, 3:6] = True  # cells of the border are half a cell from the outside
    np.testing.assert_array_equal(grid_layers(room, SpeedLimits(0.3)).reachable, inside)
    assert grid_layers(room, SpeedLimits(0.3), unknown_is_free=True).reachable.all()


@pytest.mark.parametrize("reach", [3.5, 3.6, SWEPT_REACH, SWEPT_REACH + 0.5])
@pytest.mark.parametrize("outside_blocks", [True, False])
def test_a_limited_reach_clips_the_distances(reach: float, outside_blocks: bool) -> None:
    blocked = np.random.default_rng(0).random((600, 210)) < 3e-5  # more rows than are swept at a time
    # Cells whose distance matters four rows on, and one that does up to the reach, on both sides of what is swept at a time.
    blocked[[252, 259, 511 - 4, 512 + 3], [40, 90, 140, 190]] = True
    whole = cell_distance(blocked, outside_blocks=outside_blocks)
    near = cell_distance(blocked, reach, outside_blocks=outside_blocks)
    assert blocked.any()
    np.testing.assert_array_equal(near, np.minimum(whole, np.float32(reach)))


@pytest.mark.parametrize("v_max_m_s", [0.3, 2.0])
def test_speeds_whose_costs_have_no_common_unit_are_refused(v_max_m_s):
    """Costs are integers of 16 bits: at a ratio of 1000 the cost at full speed is still a number of two digits."""
    table, unit_s = SpeedLimits(0.2, v_max_m_s, 1.001e-3 * v_max_m_s).step_table(0.05)
    assert table[-1] * unit_s == pytest.approx(0.05 / v_max_m_s, rel=0.5 / 65)
    with pytest.raises(InputError, match=r"v_min_m_s: found .*, expected at least v_max_m_s / 1000"):
        SpeedLimits(0.2, v_max_m_s, 0.999e-3 * v_max_m_s)
