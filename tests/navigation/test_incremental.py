"""After any edit, everything equals what a new build gives."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import InputError
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.graph import NavigationMap, footprint_cells, incremental
from visuohaptic.navigation.grid import SpeedLimits

from .random_maps import RADII_M, random_map, real_maps

GRAPH_FIELDS = (
    "node_cells",
    "node_m",
    "edges",
    "edge_cost_s",
    "edge_length_m",
    "edge_clearance_m",
    "path_start",
    "path_cells",
    "component",
    "components",
)


def assert_equals_rebuild(live: NavigationMap, limits: SpeedLimits, **words) -> None:
    """Bit for bit."""
    grid = OccupancyMap(live.map.cells.copy(), live.map.resolution_m, live.map.origin)
    built = NavigationMap(grid, limits, **words)
    for name in ("distance_m", "step", "vertical"):
        np.testing.assert_array_equal(getattr(live.layers, name), getattr(built.layers, name), name)
    for name in GRAPH_FIELDS:
        np.testing.assert_array_equal(getattr(live.graph, name), getattr(built.graph, name), name)
    np.testing.assert_array_equal(live.regions.potential, built.regions.potential)
    np.testing.assert_array_equal(live.regions.seed, built.regions.seed)


def random_polygon(rng: np.random.Generator, centre_m: np.ndarray) -> np.ndarray:
    angles = np.sort(rng.uniform(0, 2 * np.pi, 5))
    return centre_m + rng.uniform(0.05, 0.6) * np.column_stack([np.cos(angles), np.sin(angles)])


def random_edit(rng: np.random.Generator, live: NavigationMap) -> None:
    shape = np.array(live.map.shape)
    polygon_m = random_polygon(rng, live.map.world_from_cell((rng.random(2) * shape).astype(int)))
    kind = rng.integers(4)
    if kind == 0:
        live.set_obstacle(str(rng.integers(3)), polygon_m)
    elif kind == 1 and live.obstacles:
        live.move_obstacle(live.obstacles[0], polygon_m)
    elif kind == 2 and live.obstacles:
        live.remove_obstacle(live.obstacles[-1])
    else:
        cells = (rng.random((int(rng.integers(1, 6)), 2)) * shape).astype(int)
        live.set_cells(cells, rng.choice([-1, 0, 100], len(cells)))


def run_edits(seed: int, maps: int, edits: int = 8) -> int:
    """A campaign: random edits on random maps, each compared; returns how many."""
    rng = np.random.default_rng(seed)
    for _ in range(maps):
        limits = SpeedLimits(float(rng.choice(RADII_M)))
        words = {
            "stub_length_m": [None, 0.0, 0.5][rng.integers(3)],
            "spacing_m": [None, 0.3, 1.0][rng.integers(3)],
            "unknown_is_free": bool(rng.integers(2)),
        }
        live = NavigationMap(random_map(rng, 60), limits, **words)
        for _ in range(edits):
            random_edit(rng, live)
            assert_equals_rebuild(live, limits, **words)
    return maps * edits


def test_random_edits_equal_a_rebuild():
    run_edits(11, 25)


def test_random_edits_equal_a_rebuild_where_much_changes(monkeypatch):
    # What is done from thousands of cells on, on maps small enough to compare.
    for name, value in (("_MANY", 20), ("_FEW", 1), ("_GROW", 1)):
        monkeypatch.setattr(incremental, name, value)
    run_edits(12, 25)


@pytest.mark.data
def test_moving_an_obstacle_through_a_real_map_equals_a_rebuild(data):
    limits = SpeedLimits(0.2)
    live = NavigationMap(real_maps(data)["intel"], limits)
    rng = np.random.default_rng(12)
    places = np.argwhere(live.layers.reachable)
    box_m = np.array([[-0.3, -0.3], [0.3, -0.3], [0.3, 0.3], [-0.3, 0.3]])
    for _ in range(6):
        live.set_obstacle("box", box_m + live.map.world_from_cell(places[rng.integers(len(places))]))
        assert_equals_rebuild(live, limits)


def test_an_obstacle_that_leaves_gives_back_what_was_there():
    grid = random_map(np.random.default_rng(13), 60)
    live = NavigationMap(grid, SpeedLimits(0.1))
    before = live.map.cells.copy()
    centre_m = grid.world_from_cell(np.array(grid.shape) // 2)
    square_m = centre_m + 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    live.set_obstacle("a", square_m)
    live.set_obstacle("b", square_m + 0.2)
    assert (live.map.cells[tuple(footprint_cells(grid, square_m).T)] == 100).all()
    live.remove_obstacle("a")
    assert (live.map.cells[tuple(footprint_cells(grid, square_m + 0.2).T)] == 100).all()
    live.remove_obstacle("b")
    np.testing.assert_array_equal(live.map.cells, before)
    np.testing.assert_array_equal(grid.cells, before)  # the caller's map is never touched


def test_a_footprint_is_every_cell_that_a_polygon_touches():
    from shapely import Polygon, box

    rng = np.random.default_rng(14)
    grid = OccupancyMap(np.zeros((30, 40), np.int8), 0.1, (-1.0, 2.0, 0.7))
    # The same polygon in the frame of the cells, where SciPy's and shapely's squares are upright.
    c, s = np.cos(0.7), np.sin(0.7)
    for _ in range(40):
        polygon_m = random_polygon(rng, grid.world_from_cell((rng.random(2) * [30, 40]).astype(int)))
        upright = Polygon((polygon_m - [-1.0, 2.0]) @ np.array([[c, -s], [s, c]]) / 0.1)
        truth = {
            (row, column)
            for row in range(30)
            for column in range(40)
            # An overlap of no area, a touching corner, is rounding.
            if upright.intersection(box(column, row, column + 1, row + 1)).area > 1e-9
        }
        assert set(map(tuple, footprint_cells(grid, polygon_m).tolist())) == truth


def test_an_obstacle_outside_the_map_changes_nothing():
    live = NavigationMap(OccupancyMap(np.zeros((9, 9), np.int8), 0.1), SpeedLimits(0.1))
    graph = live.graph
    live.set_obstacle("far", np.array([[50.0, 50.0], [51.0, 50.0], [51.0, 51.0]]))
    assert live.graph is graph
    live.remove_obstacle("far")
    with pytest.raises(InputError, match="no obstacle 'far'"):
        live.move_obstacle("far", np.zeros((3, 2)))


@pytest.mark.parametrize(
    ("cells", "values"), [([[0, 99]], 100), ([[0, 0]], 101), ([[-1, 0]], 0), ([[0, 0]], -2)]
)
def test_cells_that_are_not_on_the_map_are_refused(cells, values):
    live = NavigationMap(OccupancyMap(np.zeros((9, 9), np.int8), 0.1), SpeedLimits(0.1))
    with pytest.raises(InputError):
        live.set_cells(np.array(cells), values)


@pytest.mark.parametrize("polygon", [[[0.0, 0.0], [1.0, 1.0]], [[0.0, 0.0], [1.0, np.nan], [1.0, 1.0]]])
def test_polygons_that_are_none_are_refused(polygon):
    grid = OccupancyMap(np.zeros((9, 9), np.int8), 0.1)
    with pytest.raises(InputError, match="footprint_cells"):
        footprint_cells(grid, np.array(polygon))
