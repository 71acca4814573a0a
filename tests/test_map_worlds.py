"""The worlds that judge plans are right: drawing, checking, costs, optimum, proofs and physics against known values."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from tests.worlds.buildings import building
from tests.worlds.drive_grid import blocked
from tests.worlds.floor_scenes import (
    blind_corridor,
    campus,
    closed_room,
    doors_in_series,
    idle_objects,
    off_centre,
    random_rooms,
    six_boxes,
    small_room,
)
from tests.worlds.maps import GRAVITY_M_S2, Body, Robot, World, at, bar, box, disc, ell, raster, walled
from tests.worlds.plan_checks import Floor, check_plan, drive_seconds, swept
from tests.worlds.push_oracle import contacts, push_seconds, solve, travel_m
from tests.worlds.push_physics import FloorPhysics
from tests.worlds.push_truth import impossible
from tests.worlds.real_floors import rectangles

ROBOT = Robot()


@pytest.mark.parametrize(("coarse", "fine"), [(0.1, 0.05), (0.1, 0.02), (0.02, 0.01)])
def test_a_finer_map_has_all_the_free_space_of_a_coarser_one(coarse, fine):
    world = random_rooms(0)
    times = round(coarse / fine)
    rough = np.kron(raster(world, coarse, bodies=False), np.ones((times, times), np.int8))
    exact = raster(world, fine, bodies=False)
    assert not (exact[rough == 0] > 0).any()
    assert (exact == 0).sum() > (rough == 0).sum()


def test_cells_that_a_turned_wall_overlaps_are_occupied_and_no_others():
    wall = shapely.Polygon(at(box(1.0, 0.13, 0.4), 1.0, 1.0))
    world = World("", (2.0, 2.0), (wall,), (), (0.2, 0.2), (1.8, 1.8))
    cells = raster(world, 0.05)
    rows, columns = np.indices(cells.shape)
    squares = shapely.box(columns * 0.05, rows * 0.05, (columns + 1) * 0.05, (rows + 1) * 0.05)
    area = shapely.area(shapely.intersection(squares, wall))
    assert (cells[area > 1e-6] == 100).all()
    assert (cells[area < 1e-12] == 0).all()


@pytest.mark.parametrize(
    "make",
    [doors_in_series, lambda s: idle_objects(s, 20), blind_corridor, six_boxes, random_rooms, small_room, off_centre,
     closed_room, lambda s: campus(s, 6, 20)],
)  # fmt: skip
def test_scenes_are_the_same_each_time_and_nothing_overlaps(make):
    world, again = make(2), make(2)
    assert (raster(world, 0.05) == raster(again, 0.05)).all()
    floor = Floor(world.walls, {body.id: body.polygon for body in world.bodies})
    for body in world.bodies:
        assert floor.gap_m(body.polygon, without=body.id)[0] > 0.04
    assert floor.distance_m(np.array([world.start_m]))[0] > world.robot.radius_m


def _corridor(*bodies: Body) -> World:
    return World("", (6.0, 3.0), tuple(walled(6.0, 3.0)), bodies, (0.6, 1.5), (5.4, 1.5))


def _push(body: Body, shift_m: tuple[float, float], robot_m: list[list[float]]) -> dict[str, object]:
    return {
        "kind": "push",
        "object": body.id,
        "displacement_m": list(shift_m),
        "goal_m": list(body.centre_m + np.array(shift_m)),
        "path_m": robot_m,
    }


def test_the_checker_accepts_a_good_plan_and_measures_each_planted_fault():
    body, other = Body("a", at(box(0.4, 0.4), 2.0, 1.5)), Body("b", at(box(0.4, 0.4), 4.0, 1.5))
    world = _corridor(body, other)
    around = [[1.0, 1.5], [1.0, 0.5], [5.4, 0.5], [5.4, 1.5]]

    def tasks(length_m: float, low_m: float = 0.5) -> list[dict[str, object]]:
        touch = 2.0 - 0.2 - ROBOT.radius_m
        return [
            {"kind": "navigate", "path_m": [[0.6, 1.5], [touch - 0.03, 1.5]]},
            _push(body, (length_m, 0.0), [[touch - 0.03, 1.5], [touch + length_m, 1.5], [1.0, 1.5]]),
            {"kind": "navigate", "path_m": [[x, low_m if abs(y - 0.5) < 1e-9 else y] for x, y in around]},
        ]

    def faults(plan: list[dict[str, object]]) -> list[tuple[int, int]]:
        found = check_plan(Floor.of(world), plan, ROBOT, world.start_m, world.goal_m)
        return [(fault.task, round(1e3 * fault.depth_m)) for fault in found]

    assert faults(tasks(1.0)) == []
    assert faults(tasks(1.0, low_m=0.24)) == [(2, 30)]  # 14 cm from a wall that begins at 10 cm
    assert faults(tasks(1.65)) == [(1, 50)]  # into the other box by 5 cm
    broken = tasks(1.0)
    broken[2]["path_m"] = [[1.1, 1.5], *around[1:]]
    assert faults(broken) == [(2, 100)]
    assert faults(tasks(1.0)[:2]) == [(2, 4400)]  # never gets to the goal
    assert Floor.of_cells(raster(world, 0.05), 0.05, {}).gap_m(shapely.Point(1.0, 0.5))[0] == pytest.approx(
        0.4
    )


def test_what_a_push_sweeps_is_more_than_start_and_end_of_a_concave_body():
    body = shapely.Polygon(ell(0.6, 0.6, 0.2))
    covered = swept(body, (1.0, 0.0))
    # Of a shift along x each row sweeps its extent (the L has no gap along x) and the shift.
    assert covered.area == pytest.approx(body.area + 0.6 * 1.0, rel=1e-6)
    assert travel_m(box(0.4, 0.4), at(box(0.2, 2.0), 1.0, 0.0), np.array([1.0, 0.0])) == pytest.approx(0.7)
    assert travel_m(box(0.4, 0.4), at(box(0.2, 2.0), 1.0, 1.3), np.array([1.0, 0.0])) == np.inf


def test_driving_costs_what_the_clearance_says():
    floor = Floor([bar(0.0, 0.0, 4.0, 0.1)], {})
    at_radius = np.array([[0.5, 0.1 + ROBOT.radius_m], [2.5, 0.1 + ROBOT.radius_m]])
    assert drive_seconds(floor, at_radius, ROBOT) == pytest.approx(2.0 / ROBOT.v_min_m_s)
    far = at(at_radius, 0.0, 3 * ROBOT.radius_m)
    assert drive_seconds(floor, far, ROBOT) == pytest.approx(2.0 / ROBOT.v_max_m_s)
    half = at(at_radius, 0.0, ROBOT.radius_m)  # twice the radius: in the middle of the two
    expected = 1.0 / ROBOT.v_min_m_s + 1.0 / ROBOT.v_max_m_s
    assert drive_seconds(floor, half, ROBOT) == pytest.approx(expected)


def test_contacts_of_a_box_are_its_sides_and_of_a_disc_all_around():
    found = contacts(at(box(0.4, 0.2), 3.0, 2.0), ROBOT.radius_m)
    reach = sorted(round(1e3 * float(np.hypot(*robot))) for _, robot in found)
    assert reach == [270, 270, 370, 370]
    assert len(contacts(disc(0.2), ROBOT.radius_m)) == 48


def test_the_oracle_drives_straight_where_nothing_is_near():
    world = World("", (6.0, 6.0), tuple(walled(6.0, 6.0)), (), (1.0, 1.3), (4.7, 4.1))
    found = solve(world, 0.05)
    # String pulling ends at a gain of 1e-4; the straight line is the optimum.
    assert found.cost_s == pytest.approx(np.hypot(3.7, 2.8) / ROBOT.v_max_m_s, rel=1e-3)
    assert found.finished


def test_the_oracle_finds_the_push_that_is_known_by_hand():
    # A corridor so narrow that its clearance is 1 cm above the radius all along; the goal is half a metre beyond
    # the first contact with a box that fills it.
    y, half = 1.025, 0.18
    walls = (
        bar(0.0, 0.0, 6.0, y - half),
        bar(0.0, y + half, 6.0, 2.0),
        bar(0, 0, 0.1, 2),
        bar(5.9, 0, 6.0, 2),
    )
    body = Body("a", at(box(0.3, 0.3), 2.5, y))
    touch = 2.5 - 0.15 - ROBOT.radius_m
    world = World("", (6.0, 2.0), walls, (body,), (0.575, y), (touch + 0.5, y))
    found = solve(world, 0.05)
    assert [push.body for push in found.pushes] == ["a"]
    slow = 1.0 / ROBOT.v_min_m_s
    wide = slow + (half / ROBOT.radius_m - 1) / 2 * (1.0 / ROBOT.v_max_m_s - slow)
    stand_off = 0.6 * 0.05
    driven_s = wide * (touch - stand_off - 0.575) + slow * stand_off
    # Of the stretch near the box the clearance is between the two: 1 cm of 60 at a difference of 2 %.
    assert found.cost_s == pytest.approx(driven_s + push_seconds(0.5, ROBOT), rel=2e-3)
    late = solve(world, 0.05, limit_s=0.0)
    assert not late.finished
    assert not np.isfinite(late.cost_s)


def test_the_oracle_pushes_only_from_where_the_robot_can_stand():
    # A box that fills the corridor can only be pushed from its middle, where another one is 15 cm from the robot's centre.
    y, half, walls = 1.025, 0.4, walled(6.0, 2.0)
    walls += [bar(0.0, 0.0, 6.0, y - half), bar(0.0, y + half, 6.0, 2.0)]
    bodies = [Body("a", at(box(0.3, 0.78), 2.5, y))]
    world = World("", (6.0, 2.0), tuple(walls), tuple(bodies), (0.675, y), (3.5, y))
    assert [push.body for push in solve(world, 0.1, step_m=0.1).pushes] == ["a"]
    bodies.append(Body("b", at(box(0.1, 0.1), 2.5 - 0.15 - ROBOT.radius_m, y + 0.2), fixed=True))
    found = solve(replace(world, bodies=tuple(bodies)), 0.1, step_m=0.1)
    assert found.finished
    assert not found.pushes


def test_what_has_no_plan_is_proved_and_what_has_one_is_not():
    assert impossible(closed_room(0)) is True  # a plug in a blind corridor
    assert impossible(closed_room(4)) is True  # a door too narrow
    assert impossible(closed_room(6)) is True  # a fixed body in the door
    assert impossible(doors_in_series(0, 1), step_m=0.1) is False
    assert blocked(doors_in_series(0, 1))
    assert not blocked(replace(doors_in_series(0, 1), bodies=()))


@pytest.mark.parametrize("friction", [0.2, 0.4])
@pytest.mark.parametrize(
    ("outline", "round_m"), [(box(0.4, 0.3), 0.0), (disc(0.2), 0.2), (ell(0.5, 0.4, 0.15), 0.0)]
)
def test_a_body_slides_as_far_as_coulomb_says(outline, round_m, friction):
    physics = FloorPhysics([], [Body("a", at(outline, 1, 1), 3.0, friction, round_m=round_m)], ROBOT, (0, 0))
    before, _ = physics.pose(0)
    physics.launch(0, (1.0, 0.0))
    physics.run(1.0)
    after, _ = physics.pose(0)
    # Measured 0.2 to 0.4 % short: the feet are springs that let the body nod at first.
    assert after[0] - before[0] == pytest.approx(1.0 / (2 * friction * GRAVITY_M_S2), rel=0.01)
    assert abs(after[1] - before[1]) < 1e-3


def test_a_push_moves_what_is_light_straight_and_stops_at_walls_and_at_what_is_heavy():
    def pushed(body: Body, walls: list[shapely.Polygon]) -> tuple[bool, np.ndarray, float]:
        physics = FloorPhysics(walls, [body], ROBOT, (0.5, 0.0))
        arrived = physics.drive(np.array([[0.5, 0.0], [1.0, 0.0]]), 0.1)
        return (arrived, *physics.pose(0))

    light = Body("a", at(box(0.4, 0.3), 1.0, 0.0))
    arrived, centre, turn = pushed(light, [])
    assert arrived
    # The servo is up to 4 mm behind, and the contact is a spring of a millimetre.
    assert centre == pytest.approx([1.0 + ROBOT.radius_m + 0.2, 0.0], abs=6e-3)
    assert abs(turn) < 1e-3
    arrived, centre, _ = pushed(light, [bar(1.3, -1, 1.4, 1)])
    assert not arrived
    assert centre[0] == pytest.approx(1.1, abs=6e-3)
    heavy = Body("a", light.outline_m, mass_kg=8.0)  # 23.5 N against 20 N
    arrived, centre, _ = pushed(heavy, [])
    assert not arrived
    assert centre[0] == pytest.approx(1.0, abs=2e-3)


def test_a_push_turns_a_body_towards_its_light_side():
    body = Body("a", at(box(0.4, 0.3), 1.0, 0.0), centre_offset_m=(0.0, 0.01))
    physics = FloorPhysics([], [body], ROBOT, (0.5, 0.0))
    assert physics.drive(np.array([[0.5, 0.0], [1.2, 0.0]]), 0.05)
    centre, turn = physics.pose(0)
    # Friction acts to the left of the push: the body turns to the left, and its middle drifts there.
    assert turn > np.deg2rad(1.0)
    assert centre[1] > 1e-3
    assert physics.bodies[0].centre_m == pytest.approx(centre)


def test_rectangles_cover_a_grid_exactly():
    solid = np.random.default_rng(0).random((30, 40)) < 0.4
    shapes = rectangles(solid, 0.1)
    assert shapely.union_all(shapes).area == pytest.approx(0.01 * solid.sum())
    assert sum(shape.area for shape in shapes) == pytest.approx(0.01 * solid.sum())
    rows, columns = np.nonzero(solid)
    centres = shapely.points((columns + 0.5) * 0.1, (rows + 0.5) * 0.1)
    assert shapely.contains(shapely.union_all(shapes), centres).all()


@pytest.mark.parametrize("seed", [0, 2, 4])
def test_a_door_of_a_building_is_free_between_its_jambs_and_wall_beside_them(seed):
    made = building(seed)
    assert (made.cells == building(seed).cells).all()

    def cell(point_m: np.ndarray) -> np.ndarray:
        column, row = (point_m / made.cell_m).astype(int)
        return made.cells[row - 2 : row + 3, column - 2 : column + 3]

    assert len(made.jambs_m) >= 3
    walls_m = 0
    for one, two in made.jambs_m:
        along = (two - one) / np.hypot(*(two - one))
        assert 0.65 < np.hypot(*(two - one)) < 1.85
        assert (cell(0.5 * (one + two)) == 0).any()
        # Beyond its end a wall is met within 15 cm, unless the scanner has seen neither side of it.
        walls_m += sum(bool((cell(end) == 100).any()) for end in (one - 0.15 * along, two + 0.15 * along))
    assert walls_m >= 1.6 * len(made.jambs_m)
