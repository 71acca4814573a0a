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

from visuohaptic.core import InputError, LaserScan, Primitive, PrimitiveKind
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.mapping import HapticContact, HapticMap, MapperSettings, OccupancyMapper

CELL_M, SIZE_M, RATE, CUT = 0.0625, (2.0, 1.5), 0.5, 0.01
CORNER_M = (-1.0, 0.25)


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
        self.scans: list[tuple[LaserScan, tuple[float, float, float]]] = []
        self.pose = (0.0, 0.0, 0.0)

    @rule(to=st.tuples(st.integers(-160, 160), st.integers(-160, 160)), yaw=st.floats(-math.pi, math.pi))
    def drive(self, to: tuple[int, int], yaw: float) -> None:
        self.pose = (0.25 * to[0] + 0.03, 0.25 * to[1] + 0.07, yaw)

    @rule(
        ranges_m=st.lists(
            st.floats(0.1, 12.0) | st.sampled_from([math.inf, math.nan, 0.0]), min_size=40, max_size=40
        ),
        valid=st.sampled_from([True, True, True, False]),
    )
    def look(self, ranges_m: list[float], valid: bool) -> None:
        scan = LaserScan(0.1 * len(self.scans), np.array(ranges_m), -math.pi, math.pi / 20, valid=valid)
        self.scans.append((scan, self.pose))
        self.mapper.add(*self.scans[-1])

    @precondition(lambda self: self.scans)
    @rule()
    def see_a_place_out_of_reach(self) -> None:
        before = self._made(self.mapper)
        with pytest.raises(InputError, match="the map would grow"):
            self.mapper.add(LaserScan(0.0, np.full(40, 5.0), -math.pi, math.pi / 20), (1e6, 1e6, 0.0))
        assert self._made(self.mapper) == before

    def teardown(self) -> None:
        whole = OccupancyMapper(self.settings)
        whole._make_room(np.array([[-64.0, -64.0], [64.0, 64.0]]))
        for scan, pose in self.scans:
            whole.add(scan, pose)
        assert self._made(self.mapper) == self._made(whole)

    @staticmethod
    def _made(mapper: OccupancyMapper) -> object:
        """The map, and the mean places of hits in single precision of a grid of any size."""
        try:
            found = mapper.map()
        except InputError:
            return None
        hits_m = mapper.mean_hits_m()
        order = np.lexsort(np.floor(hits_m / 0.25).T)
        return found.cells.tobytes(), found.shape, found.origin, np.round(hits_m[order], 3).tolist()


SMALL = settings(
    max_examples=10, stateful_step_count=8, deadline=None, suppress_health_check=list(HealthCheck)
)
TouchedMap.TestCase.settings = DrivenMap.TestCase.settings = SMALL
TestTouchedMap, TestDrivenMap = TouchedMap.TestCase, DrivenMap.TestCase
