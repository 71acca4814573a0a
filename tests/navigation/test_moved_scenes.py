"""A scene in the middle of a larger map, turned or mirrored: every window of the planner has to find the same there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

from tests.navigation.plan_scenes import ROBOT, STOOL
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.planning.off_centre_rollouts import fits, has_room, scene_of
from visuohaptic.navigation.planning.place_costs import place_s
from visuohaptic.navigation.planning.planner import escape
from visuohaptic.navigation.planning.search import build_search_domain, world_from_grid
from visuohaptic.navigation.planning.search.drives import (
    changed_drives_cost,
    drive_cost,
    drives_cells,
    drives_cost,
    lattice_cost,
    pull_string,
)
from visuohaptic.navigation.planning.search.push_heuristic import PushHeuristic
from visuohaptic.navigation.planning.search.push_lengths import (
    free_length,
    opening_at,
    push_step,
    replanning_units,
    stand_is_free,
)
from visuohaptic.navigation.problem import MovableObject, PlaceArea, PlanningProblem

CELL_M = 0.05
#: Columns and rows of wall beside the scene: whole nodes of the lattice, and more than any window.
BESIDE = np.array([36, 48])
STILL = np.zeros((3, 2))


def outline(x_m, y_m, turn_rad):
    """A box of 0.5 m by 0.3 m, turned, with its centre at a point."""
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    corners = np.array([[-0.25, -0.15], [0.25, -0.15], [0.25, 0.15], [-0.25, 0.15]])
    return corners @ [[c, s], [-s, c]] + [x_m, y_m]


def problem():
    """Two halls of 3 m by 4 m; a box in the door between them, and one beside it in either hall."""
    cells = np.zeros((80, 120), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    cells[:, 58:60] = 100
    cells[36:52, 58:60] = 0
    cells[20:24, 20:40] = 100
    boxes = [(2.95, 2.2, 1.5), (1.9, 3.0, 0.3), (4.2, 2.3, -0.4)]
    things = tuple(
        MovableObject(f"box {k}", outline(*place), STOOL, pose_sigma=(0.02, 0.02))
        for k, place in enumerate(boxes)
    )
    return PlanningProblem(
        OccupancyMap(cells, CELL_M), ROBOT, np.array([0.8, 1.7]), np.array([5.1, 0.9]), things,
        areas=(PlaceArea("hall", np.array([[3.2, 1.2], [4.4, 1.2], [4.4, 2.6], [3.2, 2.6]]), 30.0),),
    )  # fmt: skip


def in_larger_map(given):
    """The same problem, in the map frame, with walls of many cells on all sides."""
    columns, rows = BESIDE
    cells = np.pad(given.map.cells, ((rows, rows), (columns, columns)), constant_values=100)
    return replace(given, map=OccupancyMap(cells, CELL_M, (*(-BESIDE * CELL_M), 0.0)))


@pytest.fixture(scope="module", params=[0.0, 0.35])
def pair(request):
    """Domains of both, with the bodies where they are mapped, or as if each was moved by part of a cell."""
    near, far = build_search_domain(problem()), build_search_domain(in_larger_map(problem()))
    shifts = request.param * np.array([[3.0, -2.0], [5.0, 4.0], [-7.0, 1.0]])
    return near, far, shifts


def ends_in(near):
    """Places in both halls, apart from everything [cells]."""
    return [near.start, near.goal, np.array([28.4, 70.3]), np.array([100.0, 70.5]), np.array([12.2, 10.1])]


def test_drives_are_the_same(pair):
    near, far, shifts = pair
    gone = shifts.copy()
    gone[0] += 1e6  # the door is open
    among = 0
    for begin in ends_in(near):
        for end in ends_in(near):
            for moved in (shifts, gone):
                path, cost = pull_string(near, moved, begin, end)
                other, same = pull_string(far, moved, begin + BESIDE, end + BESIDE)
                # Of ways that cost the same to a unit, either may be found.
                assert same == pytest.approx(cost, rel=1e-3)
                np.testing.assert_allclose(other[[0, -1][: len(path)]], path[[0, -1][: len(path)]] + BESIDE)
                known = drive_cost(near, moved, begin, end)
                assert drive_cost(far, moved, begin + BESIDE, end + BESIDE) == pytest.approx(known, rel=1e-3)
                if np.isfinite(cost) and len(path) > 1:
                    among += 1
                    straight = np.hypot(*(end - begin))
                    assert straight - 1e-9 <= np.hypot(*np.diff(path, axis=0).T).sum() <= cost + 1e-6
    assert among > 20
    assert np.isinf(drive_cost(near, shifts, near.start, near.goal)) or shifts.any()


def pushes(domain, heuristic, shifts):
    """All pushes by 8 cells whose way to the contact is free."""
    found = []
    for body in range(3):
        for contact in range(len(domain.bodies[body].contacts)):
            step = push_step(heuristic, shifts, body, contact, 8.0)
            if stand_is_free(heuristic, step):
                found.append(step)
    return found


def test_pushes_are_the_same_and_end_before_the_first_obstacle(pair):
    near, far, shifts = pair
    here, there = (PushHeuristic(domain, domain.costs, range(3)) for domain in (near, far))
    steps, others = pushes(near, here, shifts), pushes(far, there, shifts)
    assert [(one.body, one.contact) for one in steps] == [(one.body, one.contact) for one in others]
    assert len(steps) > 6
    everything = np.ones(3, dtype=bool)
    rows, columns = np.nonzero(near.occupied)
    walls = shapely.union_all(shapely.box(columns, rows, columns + 1, rows + 1))
    for step, other in zip(steps, others, strict=True):
        np.testing.assert_allclose(other.touch, step.touch + BESIDE, atol=1e-9)
        free = free_length(here, step, 40.0)
        assert free_length(there, other, 40.0) == pytest.approx(free, abs=1e-9)
        among = everything.copy()
        among[step.body] = False
        ahead = near.bodies[step.body].push(step.contact).direction
        opening = opening_at(near, shifts, step.body, ahead, free, step.approach, among)
        again = opening_at(far, shifts, step.body, ahead, free, other.approach, among)
        np.testing.assert_allclose(again, opening, atol=1e-9)
        # Until then the box and the robot behind it overlap nothing, and a step of half a cell later one of them does.
        obstacles = [
            walls,
            *(shapely.Polygon(b.outline + s) for b, s in zip(near.bodies, shifts, strict=True)),
        ]
        del obstacles[1 + step.body]
        within = shapely.union_all(obstacles)
        box = shapely.Polygon(near.bodies[step.body].outline + shifts[step.body])

        def deep(length, box=box, ahead=ahead, step=step, within=within):
            moved = shapely.affinity.translate(box, *(length * ahead))
            robot = shapely.Point(step.touch + length * ahead)
            return moved.buffer(-0.1).intersects(within) or robot.distance(within) < near.radius - 0.1

        if free > 0.0:
            # Beyond what was ignored because it was in contact from the start.
            assert not any(deep(length) for length in np.arange(0.0, free, 0.5)) or deep(0.0)
        assert free == pytest.approx(40.0) or deep(free + 1.2) or deep(free + 0.6)


def test_plans_cost_the_same(pair):
    near, far, shifts = pair
    here, there = (PushHeuristic(domain, domain.costs, range(3)) for domain in (near, far))
    begin = near.start
    for length in (10.0, 14.0):
        plans = []
        for domain, heuristic, off in ((near, here, np.zeros(2)), (far, there, BESIDE)):
            (step,) = [
                one for one in pushes(domain, heuristic, shifts) if one.body == 0 and
                domain.bodies[0].push(one.contact).direction[0] > 0.9
            ]  # fmt: skip
            steps = (push_step(heuristic, STILL, 0, step.contact, length),)
            longer = (push_step(heuristic, STILL, 0, step.contact, length + 1.0),)
            values = [
                drives_cost(domain, steps, begin + off),
                lattice_cost(domain, steps, begin + off),
                changed_drives_cost(domain, steps, longer, begin + off, np.inf),
                drives_cost(domain, longer, begin + off),
                replanning_units(heuristic, steps, begin + off),
                heuristic.pushes_units(steps),
                heuristic.push_units(0, length),
                *(place_s(domain, body, shift) for body, shift in zip(domain.bodies, shifts, strict=True)),
            ]
            plans.append((values, [cells - off for cells in drives_cells(domain, steps, begin + off)]))
        (values, cells), (others, moved) = plans
        assert others == pytest.approx(values)
        for one, other in zip(cells, moved, strict=True):
            np.testing.assert_allclose(other, one, atol=1e-6)
            assert np.hypot(*np.diff(one, axis=0).T).max() < 3.0  # cell after cell
        drives, lattice, changed, known, *_ = values
        assert lattice == pytest.approx(drives, rel=0.02)
        # Along the drives of the shorter push it costs at least what it costs by itself.
        assert known <= changed * 1.002


def test_bounds_are_the_same(pair):
    near, far, shifts = pair
    here, there = (PushHeuristic(domain, domain.costs, range(3)) for domain in (near, far))
    block = near.block
    assert block > 1
    assert not (BESIDE % block).any()
    left, top = BESIDE // block
    rows, columns = near.lattice.shape

    def inside(field):
        return field.reshape(far.lattice.shape)[top : top + rows, left : left + columns].ravel()

    np.testing.assert_array_equal(inside(there.field(shifts)), here.field(shifts))
    np.testing.assert_array_equal(inside(there.free_field), here.free_field)
    begin, begun = near.seeds(here.base, near.start)[0], far.seeds(there.base, far.start)[0]
    assert there.crossed(begun) == here.crossed(begin) == [0]
    assert there.separating(begun, range(3)) == here.separating(begin, range(3)) == [0]
    for body in range(3):
        assert there.through(begun, body) == here.through(begin, body)
    # The box in the door is on the way of every plan; those beside it cost their push and a detour more.
    assert here.through(begin, 1) > here.through(begin, 0) < here.through(begin, 2)


def test_a_robot_beside_a_wall_escapes_the_same_way(pair):
    near, far, _ = pair
    left = []
    for place in (np.array([2.3, 40.0]), np.array([30.2, 26.5]), np.array([61.6, 20.0]), near.start):
        away, other = escape(near, place), escape(far, place + BESIDE)
        assert away is not None
        np.testing.assert_allclose(other - BESIDE, away)
        left.append(np.hypot(*(away - place)))
        clear = near.clearance[tuple(np.floor(away[::-1]).astype(int))]
        assert clear >= near.radius or left[-1] == pytest.approx(0.0)
    assert left[-1] == pytest.approx(0.0)
    assert 0.0 < max(left) < 2.0 * near.radius


def test_a_body_fits_in_the_same_places(pair):
    near, far, _ = pair
    rng = np.random.default_rng(5)
    poses = np.column_stack([rng.uniform(-2.0, 2.0, (80, 2)), rng.uniform(-3.0, 3.0, 80)])
    for index in range(3):
        one, other = scene_of(near, index), scene_of(far, index)
        here = fits(one, poses)
        np.testing.assert_array_equal(fits(other, poses), here)
        np.testing.assert_array_equal(has_room(other, poses[:, :2]), has_room(one, poses[:, :2]))
        assert 10 < here.sum() < 70


def test_places_on_the_map_are_the_same(pair):
    near, far, _ = pair
    points = np.random.default_rng(1).uniform(0.0, 60.0, (9, 2))
    np.testing.assert_allclose(world_from_grid(far.map, points + BESIDE), world_from_grid(near.map, points))
