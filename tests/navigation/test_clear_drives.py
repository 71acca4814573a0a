"""Drives keep the robot's radius from obstacles, checked with polygons that are independent of the planner."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from benchmarks._plan_child import Planner, described, problem_of
from benchmarks._plan_judge import asked

from tests.worlds.floor_scenes import random_rooms
from tests.worlds.real_floors import room_scene
from visuohaptic.navigation.grid.cost_grid import cell_distance
from visuohaptic.navigation.planning import make_plan
from visuohaptic.navigation.planning.search import SearchLimits, build_search_domain
from visuohaptic.navigation.planning.search._travel_kernels import segment_cost
from visuohaptic.navigation.planning.search.push_states import needed_clearance
from visuohaptic.navigation.planning.search.search_domain import CLEAR_SLACK_M
from visuohaptic.navigation.pushing._outline_kernels import clear_straight, segment_gap


@pytest.mark.parametrize("cell_m", [0.1, 0.05])
def test_a_plan_in_coarse_cells_keeps_clear_of_what_it_pushed_and_states_the_cost_of_its_drives(cell_m):
    planner = Planner(budget_s=60.0)
    try:
        for seed in (0, 2, 4):
            row = asked(planner, random_rooms(seed), cell_m)
            assert row["answer"] == "plan"
            # Coordinates are written in micrometres.
            assert row["fault_m"] < 1e-5, row["fault"]
            # Midpoints an eighth of a radius apart against trapezia of 5 mm: kinks of the distance leave .1 %.
            assert row["cost_s"] == pytest.approx(row["true_cost_s"], rel=2e-3)
    finally:
        planner.close()


def test_a_drive_that_only_the_lattice_has_hides_no_push():
    """An L-shaped object stands in a door after a push; the gap beside it is wide enough for the lattice, not for the map."""
    world = room_scene(22)
    first, *others = world.bodies
    stuck = replace(
        world, bodies=(first.moved(np.array([0.072, -0.057]), -0.105), *others), start_m=(3.4, 1.15)
    )
    plan = make_plan(problem_of(described(stuck, 0.05)), limits=SearchLimits(budget_s=60.0, expansions=100))
    assert [task.object for task in plan.pushes] == [first.id]


def cluttered(rng, share):
    """Cells of which a part is occupied, and these as squares."""
    occupied = rng.random((24, 24)) < share
    squares = [shapely.box(c, r, c + 1, r + 1) for r, c in np.argwhere(occupied)]
    edge = shapely.LinearRing([(0, 0), (24, 0), (24, 24), (0, 24)])
    return occupied, shapely.union_all([*squares, edge])


@pytest.mark.parametrize("radius", [1.0, 1.7, 3.4])
def test_a_segment_that_is_clear_by_interpolation_is_clear(radius):
    rng = np.random.default_rng(2)
    clear = 0
    for _ in range(40):
        occupied, walls = cluttered(rng, 0.04 / radius)
        clearance = cell_distance(occupied, 12.0)
        for a, b in rng.uniform(2.0, 22.0, (60, 2, 2)):
            cost = segment_cost(clearance, needed_clearance(radius), 6.0, *a, *b, False, np.inf)
            if np.isfinite(cost):
                clear += 1
                # The layer is of single precision.
                assert shapely.LineString([a, b]).distance(walls) >= radius - 1e-4
    assert clear > 100


@pytest.mark.parametrize("spacing", [1.0, 3.0, 5.0])
def test_what_a_corner_between_two_samples_hides_is_added(spacing):
    """A corner at the robot's radius, in the middle between two samples, which lie in the middle between two cell centres."""
    for radius in (3.4, 10.0, 40.0):
        centres = np.arange(-10.0, 11.0) + (0.0 if spacing % 4 == 1 else 1.0)
        seen = np.interp(0.5 * spacing, centres, np.hypot(radius, centres))
        needed = needed_clearance(radius, spacing)
        # A curvature of 1 / r between samples at s / 2 from the corner; the next order is of (s / r)^2.
        assert needed > seen - 1e-3 * (spacing / radius) ** 2
        assert needed - radius < (seen - radius) * (1.0 + (0.5 + 0.25 * spacing**2) / radius)


def test_whether_a_disc_passes_is_told_exactly():
    rng = np.random.default_rng(4)
    for _ in range(20):
        occupied, walls = cluttered(rng, 0.02)
        outline = shapely.convex_hull(shapely.multipoints(rng.uniform(6.0, 18.0, (5, 2))))
        corners = np.array(outline.exterior.coords)[:-1]
        begin, ends = rng.uniform(0.0, 24.0, 2), rng.uniform(0.0, 24.0, (40, 2))
        lines = shapely.linestrings(np.stack([np.broadcast_to(begin, ends.shape), ends], axis=1))
        gaps = np.minimum(shapely.distance(lines, walls), shapely.distance(lines, outline))
        for radius in (0.5, 1.7, 3.4):
            found = clear_straight(
                occupied, corners, np.array([0, len(corners)], np.int32), *begin, ends, radius
            )
            decided = np.abs(gaps - radius) > 1e-9
            assert (found == (gaps >= radius))[decided].all()
        for end, gap in zip(ends, shapely.distance(lines, outline), strict=True):
            assert segment_gap(*begin, *end, corners) == pytest.approx(gap, abs=1e-9)


def test_straight_drives_keep_clear_of_every_body_wherever_it_was_moved():
    """A body beside a drive counts on all sides of it, also where it is outside of the box around the drive."""
    domain = build_search_domain(problem_of(described(random_rooms(2), 0.05)))
    rng = np.random.default_rng(7)
    radius = (domain.robot.radius_m - CLEAR_SLACK_M) / domain.map.resolution_m
    beside = 0
    for _ in range(60):
        shifts = rng.uniform(-8.0, 8.0, (len(domain.bodies), 2))
        body = rng.integers(len(domain.bodies))
        middle = domain.bodies[body].outline.mean(axis=0) + shifts[body]
        # Short drives along the axes and across, at about the robot's radius from one body.
        begin = middle + rng.uniform(-3.0, 3.0, 2) * radius
        ends = begin + rng.uniform(0.0, 12.0, (20, 1)) * rng.choice([-1.0, 0.0, 1.0], (20, 2))
        lines = shapely.linestrings(np.stack([np.broadcast_to(begin, ends.shape), ends], axis=1))
        outlines = [
            shapely.Polygon(one.outline + shift) for one, shift in zip(domain.bodies, shifts, strict=True)
        ]
        gaps = np.min([shapely.distance(lines, one) for one in outlines], axis=0)
        among_walls = domain.clear_straight(shifts, begin, ends, np.zeros(len(outlines), dtype=bool))
        found = domain.clear_straight(shifts, begin, ends)
        decided = np.abs(gaps - radius) > 1e-9
        np.testing.assert_array_equal(found[decided], (among_walls & (gaps >= radius))[decided])
        beside += int((among_walls & (gaps < radius) & (gaps > 0.0)).sum())
    assert beside > 100
