"""Objects that are pushed about at random, in the map of a plan and in the memory of a drive: always the map made anew.

The model has the walls and every outline, turned by complex numbers, and asks shapely which cells an outline covers.
What an object has covered is free when it has left; a wall under an outline
remains only where its face continues beside it, never where there was none.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from tests.navigation.plan_scenes import ROBOT
from visuohaptic.core import HapticTag
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.planning import after_push
from visuohaptic.navigation.planning.search.domain_builder import build_search_domain
from visuohaptic.navigation.problem import MovableObject, PlanningProblem
from visuohaptic.tasks.mobile.travel.travel_memory import TravelMemory

CELL_M, SHAPE = 0.125, (24, 32)
#: Outlines about their centroids, as complex numbers [m].
SHAPES = {
    "box": np.array([-0.25 - 0.2j, 0.25 - 0.2j, 0.25 + 0.2j, -0.25 + 0.2j]),
    "bar": np.array([-0.4 - 0.1j, 0.4 - 0.1j, 0.4 + 0.1j, -0.4 + 0.1j]),
    "wedge": np.array([-0.2 - 0.2j, 0.4 - 0.2j, -0.2 + 0.4j]),
}
NAMES = st.sampled_from(list(SHAPES))
#: Where objects are pushed to, and how far beside it [m]: they come to touch and to overlap each other, and walls.
SPOTS = st.sampled_from([0.7 + 0.7j, 1.1 + 0.8j, 0.8 + 1.2j, 1.9 + 0.6j, 2.9 + 1.6j, 0.1 + 2.0j, 3.2 + 2.8j])
BESIDE = st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)).map(lambda xy: complex(*xy))
TURNS = st.sampled_from([0.0, 0.5 * math.pi]) | st.floats(-math.pi, math.pi)


def outline(name: str, at: complex, turned: float) -> np.ndarray:
    """Corners of a shape whose centroid is at a place."""
    body = shapely.Polygon(np.column_stack([SHAPES[name].real, SHAPES[name].imag]))
    corners = at + (SHAPES[name] - complex(body.centroid.x, body.centroid.y)) * np.exp(1j * turned)
    return np.column_stack([corners.real, corners.imag])


@lru_cache(maxsize=1000)
def covered(name: str, at: complex, turned: float) -> np.ndarray:
    """Cells whose square overlaps a shape."""
    body = shapely.Polygon(outline(name, at, turned) / CELL_M).buffer(-1e-6)
    rows, columns = np.indices(SHAPE)
    shapely.prepare(body)
    return np.asarray(shapely.intersects(body, shapely.box(columns, rows, columns + 1, rows + 1)))


class PushedObjects(RuleBasedStateMachine):
    """Three objects in a room; they may touch each other, walls, and lie beyond the border."""

    @initialize(gap=st.integers(0, 2))
    def begin(self, gap: int) -> None:
        cells = np.zeros(SHAPE, np.int8)
        cells[[0, 1, -2, -1]] = cells[:, [0, 1, -2, -1]] = 100
        cells[2:9, 15:17] = 100
        cells[12:15, 2:5] = -1
        self.bare = cells.copy()
        self.walls = cells == 100
        x_m = 1.0 + CELL_M * gap
        self.at = {"box": 0.7 + 0.7j, "bar": x_m + 1.9j, "wedge": 2.9 + 1.6j}
        self.turned = dict.fromkeys(SHAPES, 0.0)
        self.pushes = dict.fromkeys(SHAPES, 0)
        self.left: list[shapely.Polygon] = []  #: outlines that an object has left
        objects = tuple(
            MovableObject(name, self._corners(name), HapticTag(fixed=False), friction_offset_m=(0.03, 0.01))
            for name in SHAPES
        )
        cells[self._full(self.at, self.turned)] = 100
        self.start = OccupancyMap(cells, CELL_M)
        self.before = cells.copy()
        robot_m = np.array([2.5, 2.4])
        self.problem = PlanningProblem(self.start, ROBOT, robot_m, np.array([3.4, 0.6]), objects)
        self.memory = TravelMemory(self.problem)
        self.seen = dict(self.at), dict(self.turned)
        self.hidden = self.walls & self._full(self.at, self.turned)

    def _corners(self, name: str) -> np.ndarray:
        return outline(name, self.at[name], self.turned[name])

    def _full(self, at: dict[str, complex], turned: dict[str, float]) -> np.ndarray:
        return np.any([covered(name, at[name], turned[name]) for name in SHAPES], axis=0)

    @rule(name=NAMES, spot=SPOTS, beside=BESIDE, turn=TURNS)
    def push(self, name: str, spot: complex, beside: complex, turn: float) -> None:
        way = spot + beside - self.at[name]
        self.left.append(shapely.Polygon(self._corners(name)))
        robot_m = np.array([2.0, 2.0])
        self.problem = after_push(self.problem, name, np.array([way.real, way.imag]), robot_m, turn_rad=turn)
        stays = ~covered(name, self.at[name], self.turned[name]) | (self.problem.map.cells == 100)
        self.walls &= stays
        self.at[name] += way
        self.turned[name] += turn
        self.pushes[name] += 1

    @rule(name=NAMES, spot=SPOTS, beside=BESIDE, turn=TURNS)
    def see(self, name: str, spot: complex, beside: complex, turn: float) -> None:
        at, turned = self.seen
        place = spot + beside
        if self.memory.seen(name, np.array([place.real, place.imag, turn])):
            at[name], turned[name] = place, turn
        else:
            assert abs(place - at[name]) < 0.021
            assert abs(math.remainder(turn - turned[name], 2 * math.pi)) < 0.051

    @invariant()
    def objects_are_where_they_were_pushed(self) -> None:
        for item in self.problem.objects:
            assert item.footprint_m == pytest.approx(self._corners(item.id), abs=1e-9)
            tag = item.tag or HapticTag()
            assert tag.explored == self.pushes[item.id]
            offset = (0.03 + 0.01j) * np.exp(1j * self.turned[item.id])
            assert complex(*item.friction_offset_m) == pytest.approx(offset, abs=1e-9)
        assert (self.start.cells == self.before).all(), "the map of the first plan has changed"

    @invariant()
    def the_map_is_that_of_walls_and_outlines(self) -> None:
        full = self._full(self.at, self.turned)
        found = self.problem.map.cells == 100
        assert not (found & ~full & (self.bare == 0)).any(), "an object is left where it is no more"
        assert not (full & ~found).any(), "an object has lost cells"
        assert self._crumbs()[self.walls & ~found].all()

    @invariant()
    def a_search_has_the_same_walls(self) -> None:
        """Whichever way the objects came to their places."""
        full = self._full(self.at, self.turned)
        cells = np.where(full | self.walls, np.int8(100), np.where(self.bare < 0, self.bare, np.int8(0)))
        anew = replace(self.problem, map=OccupancyMap(cells, CELL_M))
        walls = [build_search_domain(problem).occupied for problem in (self.problem, anew)]
        assert (walls[0] <= walls[1]).all()
        assert (walls[0] == walls[1])[~self._crumbs()].all()

    def _crumbs(self) -> np.ndarray:
        """Cells beside an outline that an object has left: what remains alone there belongs to it."""
        rows, columns = np.indices(SHAPE)
        points = shapely.points((columns + 0.5) * CELL_M, (rows + 0.5) * CELL_M)
        near = [body.distance(points) <= 1.25 * CELL_M + 1e-9 for body in self.left]
        return np.any([*near, np.zeros(SHAPE, dtype=bool)], axis=0)

    @invariant()
    def a_memory_has_the_same_map(self) -> None:
        full = self._full(*self.seen)
        found = self.memory.problem(np.array([2.0, 2.0, 0.0])).map.cells == 100
        first = (self.bare == 100) & ~self.hidden
        assert (full <= found).all()
        assert not (found & ~full & (self.bare == 0)).any()
        assert not (first & ~found).any()


PushedObjects.TestCase.settings = settings(
    max_examples=8, stateful_step_count=8, deadline=None, suppress_health_check=list(HealthCheck)
)
TestPushedObjects = PushedObjects.TestCase
