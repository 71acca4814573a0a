"""Maps that are changed step by step, driven at random: always what they would be if they were made at once.

A haptic map is made again by the printed formula, on all cells and in double precision, without the windows of the
library. A laser map grows as the robot drives; it is made again on a grid that had room for everything from the start.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from scipy.spatial import cKDTree

from visuohaptic.core import InputError, LaserScan, Primitive, PrimitiveKind
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.mapping import HapticContact, HapticMap, MapperSettings, OccupancyMapper

CELL_M, SIZE_M, RATE, CUT = 0.0625, (2.0, 1.5), 0.5, 0.01
CORNER_M = (-1.0, 0.25)
BEAMS = 120
#: No beam of the first scan runs along a line of the grid, where rounding would decide.
HOME = (0.03, 0.07, 0.01)


class TouchedMap(RuleBasedStateMachine):
    """Contacts of a wall and of a bin anywhere in a map, beside it and across its border."""

    def __init__(self) -> None:
        super().__init__()
        self.map = HapticMap.empty(CORNER_M, SIZE_M, CELL_M, rate=RATE)
        self.layers = {False: np.zeros(self.map.static.shape), True: np.zeros(self.map.static.shape)}
        #: Cells at a border of what a contact says: rounding decides there.
        self.open = np.zeros(self.map.static.shape, dtype=bool)

    @rule(
        place_m=st.tuples(st.floats(-2.0, 2.0), st.floats(-1.0, 3.0)),
        yaw=st.floats(-math.pi, math.pi),
        length_m=st.floats(0.01, 0.3),
        confidence=st.floats(0.0, 1.0),
        radius_m=st.none() | st.floats(0.05, 0.4),
        movable=st.booleans(),
    )
    def touch(
        self,
        place_m: tuple[float, float],
        yaw: float,
        length_m: float,
        confidence: float,
        radius_m: float | None,
        movable: bool,
    ) -> None:
        ends_m = np.array([[0.0, -0.5 * length_m], [0.0, 0.5 * length_m]])
        shape = (
            Primitive(PrimitiveKind.LINE, np.array([0.0, 0.0, 0.5 * np.pi]), np.eye(3), 1.0)
            if radius_m is None
            else Primitive(PrimitiveKind.CIRCLE, np.array([radius_m, 0.0, radius_m]), np.eye(3), 1.0)
        )
        self.map.add(HapticContact(shape, ends_m, (*place_m, yaw), confidence, movable))
        rows, columns = np.indices(self.open.shape)
        seen = (CORNER_M[0] - place_m[0] + CELL_M * (columns + 0.5)) + 1j * (
            CORNER_M[1] - place_m[1] + CELL_M * (rows + 0.5)
        )
        seen = seen * np.exp(-1j * yaw)  # x away from the robot, y along the strip
        depth_m = seen.real if radius_m is None else radius_m - np.abs(seen - radius_m)
        near = np.exp(
            -np.minimum(np.abs(seen - ends_m[0, 1] * 1j), np.abs(seen - ends_m[1, 1] * 1j)) / length_m
        )
        self.open |= (np.abs(depth_m) < 1e-6) | (np.abs(near / CUT - 1.0) < 1e-2)
        weight = RATE * confidence * np.where(near >= CUT, near, 0.0)
        says = np.where(depth_m >= 0.0, 1.0, -1.0)
        self._update(movable, says, weight)
        if movable:
            self._update(False, np.minimum(says, 0.0), weight)

    def _update(self, movable: bool, says: np.ndarray, weight: np.ndarray) -> None:
        old = self.layers[movable]
        self.layers[movable] = np.where(says == 0.0, old, (1.0 - weight) * old + weight * says)

    @invariant()
    def it_is_what_the_formula_says(self) -> None:
        for movable, layer in self.layers.items():
            ours = self.map.movable if movable else self.map.static
            # The smallest circle around the contact is found in single precision.
            np.testing.assert_allclose(ours[~self.open], layer[~self.open], atol=1e-3)
            assert (np.abs(ours) <= 1.0).all()

    @rule(min_rate=st.floats(0.02, 0.9))
    def write(self, min_rate: float) -> None:
        cells = self.map.occupancy(min_rate)
        sure = ~self.open & (np.abs(np.abs(list(self.layers.values())) - min_rate) > 2e-3).all(axis=0)
        full = np.maximum(self.layers[False], self.layers[True]) >= min_rate
        unseen = (np.abs(list(self.layers.values())) < min_rate).all(axis=0)
        assert (cells.cells[sure & full] == 100).all()
        assert (cells.cells[sure & unseen] == -1).all()
        assert (cells.cells[sure & ~full & ~unseen] == 0).all()
        with tempfile.TemporaryDirectory() as folder:
            cells.save(Path(folder) / "map.yaml")
            read = OccupancyMap.load(Path(folder) / "map.yaml")
        assert (read.cells == cells.cells).all()
        assert read.origin == pytest.approx(cells.origin)


class DrivenMap(RuleBasedStateMachine):
    """Scans from where the wheels say the robot is; the grid grows on every side."""

    def __init__(self) -> None:
        super().__init__()
        # The wheels are believed: a scan is not matched before so many.
        self.settings = MapperSettings(resolution_m=0.25, warm_up_scans=10**6)
        self.mapper = OccupancyMapper(self.settings)
        self.seen = 0  #: valid scans
        self.scans: list[tuple[LaserScan, tuple[float, float, float]]] = []
        self.pose = HOME

    @rule(to=st.tuples(st.integers(-160, 160), st.integers(-160, 160)), yaw=st.floats(-math.pi, math.pi))
    def drive(self, to: tuple[int, int], yaw: float) -> None:
        self.pose = (0.25 * to[0] + HOME[0], 0.25 * to[1] + HOME[1], yaw)

    @rule(
        seed=st.integers(0, 10**6), limit_m=st.floats(1.0, 12.0), valid=st.sampled_from([True] * 4 + [False])
    )
    def look(self, seed: int, limit_m: float, valid: bool) -> None:
        """Ranges at random; a fifth of the beams have no echo, or none that counts."""
        random = np.random.default_rng(seed)
        ranges_m = random.uniform(0.1, limit_m, BEAMS)
        without = random.random(BEAMS) < 0.2
        ranges_m[without] = random.choice([math.inf, math.nan, 0.0], np.count_nonzero(without))
        self._add(ranges_m, valid)

    def _add(self, ranges_m: np.ndarray, valid: bool = True) -> None:
        scan = LaserScan(0.1 * len(self.scans), ranges_m, -math.pi, 2.0 * math.pi / BEAMS, valid=valid)
        match = self.mapper.add(scan, self.pose)
        assert match.valid == valid
        self.scans.append((scan, self.pose))
        self.seen += valid

    @precondition(lambda self: self.seen)
    @rule()
    def see_a_place_out_of_reach(self) -> None:
        before = self.mapper.map().cells, self.mapper.mean_hits_m()
        self.pose = (1e6, 1e6, 0.0)
        with pytest.raises(InputError, match="the map would grow"):
            self._add(np.full(BEAMS, 5.0))
        self.pose = HOME
        assert (self.mapper.map().cells == before[0]).all()
        assert (self.mapper.mean_hits_m() == before[1]).all()

    def teardown(self) -> None:
        if not self.seen:
            return
        whole = OccupancyMapper(self.settings)
        whole._make_room(np.array([[-64.0, -64.0], [64.0, 64.0]]))
        for scan, pose in self.scans:
            whole.add(scan, pose)
        ours, made = self.mapper.map(), whole.map()
        assert ours.origin == made.origin
        assert (ours.cells == made.cells).all()
        # Means are in single precision, from the corner of either grid.
        hits_m, made_m = self.mapper.mean_hits_m(), whole.mean_hits_m()
        assert len(hits_m) == len(made_m)
        assert cKDTree(made_m).query(hits_m)[0].max(initial=0.0) < 1e-3


SMALL = settings(
    max_examples=10, stateful_step_count=8, deadline=None, suppress_health_check=list(HealthCheck)
)
TouchedMap.TestCase.settings = DrivenMap.TestCase.settings = SMALL
TestTouchedMap, TestDrivenMap = TouchedMap.TestCase, DrivenMap.TestCase
