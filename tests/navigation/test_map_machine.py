"""Edits of a live map in any order: what it shows is the floor with the obstacles that are on it, by shapely."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import shapely
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.graph import NavigationMap
from visuohaptic.navigation.grid import SpeedLimits

ROWS, COLUMNS, CELL_M = 24, 30, 0.1
NAMES = st.sampled_from(["crate", "chair", "door"])
#: Corners lie a third of a cell from all borders of cells: whether one is touched is no question of rounding.
PLACES = st.integers(0, COLUMNS - 1).map(lambda number: (number + 1 / 3) * CELL_M)
SIZES = st.integers(0, 7).map(lambda number: (number + 1 / 4) * CELL_M)


class Edits(RuleBasedStateMachine):
    """A map with obstacles, and a model of it: the cells of the floor, and polygons."""

    def __init__(self) -> None:
        super().__init__()
        self.floor = np.zeros((ROWS, COLUMNS), np.int8)
        self.floor[0] = self.floor[-1] = self.floor[:, 0] = self.floor[:, -1] = 100
        grid = OccupancyMap(self.floor.copy(), CELL_M, (0.0, 0.0, 0.0))
        self.live = NavigationMap(grid, SpeedLimits(0.12))
        self.polygons: dict[str, shapely.Polygon] = {}
        rows, columns = np.mgrid[:ROWS, :COLUMNS]
        # Row 0 is at the origin, as in a map of ROS.
        self.boxes = shapely.box(columns * CELL_M, rows * CELL_M, (columns + 1) * CELL_M, (rows + 1) * CELL_M)

    @rule(name=NAMES, x=PLACES, y=PLACES, width=SIZES, height=SIZES)
    def set_obstacle(self, name: str, x: float, y: float, width: float, height: float) -> None:
        corners = np.array([[x, y], [x + width, y], [x + width, y + height], [x, y + height]])
        self.live.set_obstacle(name, corners)
        self.polygons[name] = shapely.Polygon(corners)

    @rule(name=NAMES)
    def remove_obstacle(self, name: str) -> None:
        if name in self.polygons:
            self.live.remove_obstacle(name)
            del self.polygons[name]

    @rule(
        row=st.integers(0, ROWS - 1), column=st.integers(0, COLUMNS - 1), value=st.sampled_from([-1, 0, 100])
    )
    def set_cell(self, row: int, column: int, value: int) -> None:
        self.live.set_cells(np.array([[row, column]]), value)
        self.floor[row, column] = value

    @rule()
    def save_and_load(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            self.live.map.save(Path(folder, "map.yaml"))
            read = OccupancyMap.load(Path(folder, "map.yaml"))
        np.testing.assert_array_equal(read.cells, self.live.map.cells)

    @invariant()
    def shows_the_floor_with_its_obstacles(self) -> None:
        expected = self.floor.copy()
        for polygon in self.polygons.values():
            expected[shapely.intersects(self.boxes, polygon)] = 100
        np.testing.assert_array_equal(self.live.map.cells, expected)
        assert set(self.live.obstacles) == set(self.polygons)


Edits.TestCase.settings = settings(
    max_examples=15, stateful_step_count=15, deadline=None, suppress_health_check=list(HealthCheck)
)
TestEdits = Edits.TestCase
