"""Robots with a polygonal footprint: plans through narrow doors, checked by polygons; what is refused."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import shapely
from benchmarks._plan_footprints import OUTLINE_M, collisions

from tests.worlds.floor_scenes import doors_in_series
from tests.worlds.maps import World, bar, raster, walled
from visuohaptic.core import Estimate, HapticTag, InputError, to_dict
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.planning import alternatives, exploration_tour, make_plan
from visuohaptic.navigation.planning.footprint import FootprintDrives
from visuohaptic.navigation.planning.footprint import _footprint_kernels as kernels
from visuohaptic.navigation.problem import MovableObject, PlanningProblem, RobotModel, robot_from_data
from visuohaptic.tasks.mobile.travel import FloorExploration

ROBOT = RobotModel.of_footprint(OUTLINE_M)


def _rooms(door_m: float) -> World:
    """Two rooms of 4 x 4 m with a door whose centre is at (3, 2)."""
    low, high = 2.0 - door_m / 2, 2.0 + door_m / 2
    walls = (*walled(6.0, 4.0), bar(2.9, 0.0, 3.1, low), bar(2.9, high, 3.1, 4.0))
    return World("door", (6.0, 4.0), walls, (), (1.0, 1.0), (5.0, 3.0))


def _problem(world: World, robot: RobotModel = ROBOT, cell_m: float = 0.05) -> PlanningProblem:
    tag = HapticTag(static_friction_N=Estimate(5.0, 0.0), fixed=False, falls=False, explored=1)
    objects = tuple(
        MovableObject(body.id, body.outline_m, tag, pose_sigma=(0.0, 0.0)) for body in world.bodies
    )
    ends = np.array(world.start_m), np.array(world.goal_m)
    return PlanningProblem(OccupancyMap(raster(world, cell_m), cell_m), robot, *ends, objects)


def test_a_footprint_passes_a_door_that_the_circle_around_it_does_not() -> None:
    world = _rooms(0.7)
    plan = make_plan(_problem(world))
    assert plan.reachable
    assert collisions(world, 0.05, plan.to_json()["tasks"], OUTLINE_M) == []
    assert make_plan(_problem(world, RobotModel(ROBOT.reach_m))).proved
    assert make_plan(_problem(_rooms(0.4))).proved  # the circle inside does not fit
    # Half a cell narrower than the robot on either side of its path, the check finds the walls.
    assert collisions(_rooms(0.4), 0.05, plan.to_json()["tasks"], OUTLINE_M)


def test_a_drive_through_an_empty_room_is_a_straight_line() -> None:
    """From place to place on the lattice it has corners: all of them are cut, from the start on."""
    world = World("room", (6.0, 4.0), walled(6.0, 4.0), (), (1.0, 1.0), (5.0, 2.3))
    (drive,) = make_plan(_problem(world)).tasks
    np.testing.assert_allclose(drive.path_m, [world.start_m, world.goal_m], atol=1e-9)


def test_the_first_corner_of_a_drive_is_kept_where_the_way_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two halls of 1.2 m at a right angle, searched with one corner: without it, the drive crosses metres of wall."""
    walls = (*walled(5.0, 5.0), bar(1.3, 0.0, 5.0, 3.7))
    world = World("halls", (5.0, 5.0), walls, (), (0.7, 0.7), (4.3, 4.3))
    corner = np.array([[14.0, 14.0], [14.0, 86.0], [86.0, 86.0]])
    monkeypatch.setattr(FootprintDrives, "_searched", lambda *_: corner)
    plan = make_plan(_problem(world))
    (drive,) = plan.tasks
    assert collisions(world, 0.05, plan.to_json()["tasks"], OUTLINE_M) == []
    length_m = float(np.hypot(*np.diff(drive.path_m, axis=0).T).sum())
    assert np.hypot(3.6, 3.6) < length_m <= 7.2 + 1e-9


def test_a_heading_at_the_start_counts() -> None:
    # In a corridor of 0.7 m the robot cannot turn: heading away from its open end, it cannot leave.
    walls = (*walled(6.0, 4.0), bar(0.0, 0.1, 3.0, 1.65), bar(0.0, 2.35, 3.0, 4.0))
    world = World("corridor", (6.0, 4.0), walls, (), (1.0, 2.0), (5.0, 3.0))
    problem = _problem(world)
    ahead = make_plan(replace(problem, start_yaw_rad=0.0))
    assert ahead.reachable
    assert collisions(world, 0.05, ahead.to_json()["tasks"], OUTLINE_M) == []
    back = make_plan(replace(problem, start_yaw_rad=np.pi))
    assert not back.reachable
    assert not back.proved


def test_it_pushes_with_its_front_edge_and_turns_clear_of_the_object() -> None:
    world = doors_in_series(0, 1)
    plan = make_plan(_problem(world))
    (push,) = plan.pushes
    assert collisions(world, 0.05, plan.to_json()["tasks"], OUTLINE_M) == []
    stand, contact = np.array(push.path_m[0]), np.array(push.contact_m)
    assert np.hypot(*(contact - stand)) == pytest.approx(0.03 + ROBOT.reach_m, abs=1e-3)
    pointed = RobotModel.of_footprint([[0.5, 0.0], [-0.4, 0.25], [-0.4, -0.25]])
    assert any("no edge in front" in note for note in make_plan(_problem(world, pointed)).notes)


def test_swept_cells_cover_the_turning_polygon() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        hull = shapely.MultiPoint(rng.uniform(-6.0, 6.0, (5, 2))).convex_hull
        outline = shapely.get_coordinates(hull)[:-1]
        x, y, begin, turn = *rng.uniform(8.0, 12.0, 2), rng.uniform(-3, 3), rng.uniform(-0.05, 0.05)
        grow = 1.0 / np.cos(0.5 * turn)
        runs = kernels.hull_runs(
            np.concatenate([kernels.turned(outline, x, y, begin + part * turn, grow) for part in (0.0, 1.0)])
        )
        swept = shapely.union_all([shapely.box(a, row, b, row + 1) for row, a, b in runs.tolist()])
        for part in np.linspace(0.0, 1.0, 7):
            placed = shapely.Polygon(kernels.turned(outline, x, y, begin + part * turn, 1.0))
            assert placed.difference(swept).area < 1e-4
        # No cell is added that the grown outlines do not reach.
        assert swept.area < shapely.union_all([placed.buffer(1.5)]).area


def test_a_footprint_is_read_as_nav2_writes_it() -> None:
    corners = [[0.45, 0.25], [-0.45, 0.25], [-0.45, -0.25], [0.45, -0.25]]
    robot = robot_from_data({"footprint": corners, "v_max_m_s": 0.5})
    assert robot == robot_from_data({"footprint": str(corners), "v_max_m_s": 0.5})
    assert (robot.radius_m, robot.front_m, robot.v_max_m_s) == pytest.approx((0.25, 0.45, 0.5))
    assert robot_from_data(to_dict(robot)) == robot
    assert RobotModel(0.2).stand_off_m == pytest.approx(0.03)
    for data, found in (
        ({"footprint": corners, "radius_m": 0.2}, "radius_m: found a footprint as well"),
        ({"footprint": [[1.0, 1.0], [2.0, 1.0], [2.0, 2.0]]}, r"none around \(0, 0\)"),
        ({"footprint": "[[1, 2"}, "footprint"),
        ({"footprint": [[0.0, 1.0]]}, "distinct corners"),
    ):
        with pytest.raises(InputError, match=found):
            robot_from_data(data)
    with pytest.raises(InputError, match="inscribed circle"):
        replace(robot, radius_m=0.3)
    larger = robot.grown(0.05)
    assert (larger.radius_m, larger.front_m, larger.v_max_m_s) == pytest.approx((0.3, 0.5, 0.5))
    assert larger.reach_m == pytest.approx(np.hypot(0.5, 0.3))
    assert larger.flat_front
    assert RobotModel(0.2).grown(0.05) == RobotModel(0.25)


def test_what_is_planned_for_discs_refuses_a_footprint() -> None:
    problem = _problem(_rooms(0.7))
    for call in (alternatives, *(partial(of, budget_s=60.0) for of in (exploration_tour, FloorExploration))):
        with pytest.raises(InputError, match="for a disc only"):
            call(problem)
