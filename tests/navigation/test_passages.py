"""Doors and elevators as lines of a file, as steps of a plan, and driven through in an independent simulation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.worlds.door_world import DoorWorld
from tests.worlds.plan_checks import Floor, drive_seconds
from visuohaptic.core import Estimate, InputError
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.planning import make_plan
from visuohaptic.navigation.problem import (
    Passage,
    PassageKind,
    PlanningProblem,
    RobotModel,
    objects_from_data,
    passages_from_data,
    plan_from_json,
)
from visuohaptic.tasks.mobile.travel import travel

ROBOT = RobotModel(0.17)
DOOR_M = (2.5, 1.0, 2.6, 2.0)
#: Wall with the door, and the wall's other end where a detour leads round.
WALLS_M = [(2.5, 0.0, 2.6, 1.0), (2.5, 2.0, 2.6, 5.0)]


def outline(x0, y0, x1, y1):
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def two_rooms(kind, *, detour=False, open_s=None, cell_m=0.05):
    """5 x 6 m, two rooms and a door that is drawn closed; with a gap at the top of the wall or not."""
    cells = np.zeros((round(6.0 / cell_m), round(5.0 / cell_m)), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    for x0, y0, x1, y1 in [*WALLS_M, DOOR_M, *([] if detour else [(2.5, 5.0, 2.6, 6.0)])]:
        c0, r0, c1, r1 = (round(value / cell_m) for value in (x0, y0, x1, y1))
        cells[r0:r1, c0:c1] = 100
    door = Passage("door", outline(*DOOR_M), kind, open_s)
    ends = np.array([1.0, 1.5]), np.array([4.0, 1.5])
    return PlanningProblem(OccupancyMap(cells, cell_m), ROBOT, *ends, (), (door,))


def test_every_type_is_a_line_of_the_file():
    shape = outline(*DOOR_M).tolist()
    lines = [
        {"id": "wing", "type": "door_push", "footprint_m": shape},
        {
            "id": "slides",
            "type": "door_sliding",
            "footprint_m": shape,
            "open_s": {"value": 3.0, "spread": 0.5},
        },
        {"id": "lift", "type": "elevator", "footprint_m": shape},
        {"id": "pane", "type": "glass", "footprint_m": shape},
        {"id": "box", "footprint_m": shape},
    ]
    passages = passages_from_data({"objects": lines})
    assert [(p.id, str(p.kind)) for p in passages] == [
        ("wing", "door_push"), ("slides", "door_sliding"), ("lift", "elevator"),
    ]  # fmt: skip
    assert passages[1].cost(ROBOT).sigma_s == pytest.approx(0.5)
    pane, box = objects_from_data({"objects": lines})
    assert pane.known_immovable
    assert not box.known_immovable
    # Kept clear of on all sides.
    assert (np.ptp(pane.footprint_m, axis=0) > np.ptp(box.footprint_m, axis=0) + 0.05).all()
    with pytest.raises(
        InputError, match=r"objects\[0\].type.*'gate', expected one of object, glass, door_push"
    ):
        passages_from_data({"objects": [{"id": "a", "type": "gate", "footprint_m": shape}]})


def test_costs_of_passages_against_the_formulas():
    shape = outline(*DOOR_M)
    # A wing of 1 m leaves 1 - cos a free: 2.2 radii of 0.17 m need acos(0.626) of its middle's path, and 4 s setup.
    push_s = 0.5 * math.acos(1.0 - 0.374) / 0.05
    wing = Passage("wing", shape, PassageKind.DOOR_PUSH).cost(ROBOT)
    assert wing.total_s * (1.0 - wing.failure_probability) == pytest.approx(4.0 + push_s)
    lift = Passage("lift", shape, PassageKind.ELEVATOR, Estimate(30.0, spread=30.0)).cost(ROBOT)
    # Arrivals at random: nobody comes in five minutes with exp(-300 / 30).
    assert lift.failure_probability == pytest.approx(math.exp(-10.0))
    assert lift.total_s == pytest.approx(30.0, rel=1e-3)
    assert not np.isfinite(
        Passage("narrow", outline(0, 0, 0.1, 0.35), PassageKind.DOOR_PUSH).cost(ROBOT).total_s
    )


@pytest.mark.parametrize(
    ("kind", "step"),
    [(PassageKind.DOOR_SLIDING, "wait"), (PassageKind.ELEVATOR, "wait"), (PassageKind.DOOR_PUSH, "door")],
)
def test_a_plan_leads_through_a_passage_as_a_step_of_its_own(kind, step):
    problem = two_rooms(kind)
    plan = make_plan(problem)
    assert [task.kind for task in plan.tasks] == ["navigate", step, "navigate"]
    before, through, after = plan.tasks
    cost = problem.passages[0].cost(ROBOT)
    assert (through.object, through.cost_s, through.sigma_s) == ("door", cost.total_s, cost.sigma_s)
    # It stops clear of the wing, and goes on from where it stopped or from behind the wing.
    assert DOOR_M[0] - 0.3 < before.path_m[-1][0] < DOOR_M[0] - ROBOT.radius_m
    begins = through.path_m[-1] if step == "door" else before.path_m[-1]
    assert after.path_m[0] == pytest.approx(begins)
    # Each drive states its own cost: the free room before the door is fast, the doorway slow.
    free = problem.map.cells.copy()
    (low, left), (high, right) = np.rint(np.array([DOOR_M[1::2], DOOR_M[::2]]).T / problem.map.resolution_m)
    free[int(low) : int(high), int(left) : int(right)] = 0
    floor = Floor.of_cells(free, problem.map.resolution_m, {})
    for drive in (before, after):
        assert drive.cost_s == pytest.approx(drive_seconds(floor, np.array(drive.path_m), ROBOT), rel=5e-3)
    driven_m = sum(task.length_m for task in plan.tasks)
    assert driven_m == pytest.approx(3.0, abs=0.05)
    assert plan_from_json(plan.to_json()).tasks[1].sigma_s == pytest.approx(cost.sigma_s, abs=1e-6)


def test_an_object_whose_tag_is_that_of_a_wing_is_a_door():
    from visuohaptic.core import HapticTag, Primitive, PrimitiveKind
    from visuohaptic.navigation.problem import MovableObject

    problem = two_rooms(PassageKind.DOOR_PUSH)
    plane = Primitive(PrimitiveKind.LINE, np.zeros(3), np.eye(3), 0.9)
    wing = HapticTag(rotation_rad_per_m=Estimate(1.6, 0.1), primitive=plane, explored=2)
    leaf = MovableObject("leaf", problem.passages[0].footprint_m, wing)
    plan = make_plan(PlanningProblem(problem.map, ROBOT, problem.start_m, problem.goal_m, (leaf,)))
    assert [(task.kind, task.object) for task in plan.tasks] == [
        ("navigate", ""),
        ("door", "leaf"),
        ("navigate", ""),
    ]


def test_a_detour_is_taken_where_the_wait_is_longer():
    """Round the wall it is 2 * hypot(1.5, 4) m, slower beside the wall: more than 19 s longer than through the door."""
    soon, late = (two_rooms(PassageKind.DOOR_SLIDING, detour=True, open_s=Estimate(s)) for s in (5.0, 120.0))
    assert [task.kind for task in make_plan(soon).tasks] == ["navigate", "wait", "navigate"]
    assert [task.kind for task in make_plan(late).tasks] == ["navigate"]


def test_a_locked_door_is_no_passage_and_said_so():
    problem = two_rooms(PassageKind.DOOR_PUSH)
    from visuohaptic.core import HapticTag

    locked = replace(problem.passages[0], tag=HapticTag(fixed=True))
    plan = make_plan(replace(problem, passages=(locked,)))
    assert not plan.reachable
    assert plan.proved
    assert any("door" in note and "locked" in note for note in plan.notes)


def driven(problem, **door):
    world = DoorWorld(
        [(0, 0, 0.05, 6), (4.95, 0, 5, 6), (0, 0, 5, 0.05), (0, 5.95, 5, 6), *WALLS_M, (2.5, 5.0, 2.6, 6.0)],
        DOOR_M, *problem.start_m.tolist(), **door,
    )  # fmt: skip
    return world, travel(problem, world, world, world.wait, passages=world)


@pytest.mark.parametrize("kind", [PassageKind.DOOR_SLIDING, PassageKind.ELEVATOR])
def test_a_travel_waits_until_it_is_open(kind):
    world, done = driven(two_rooms(kind), opens_after_s=3.2)
    assert done.arrived, done.reason
    assert world.requests == ["door"]
    # It does not drive before it is open, and not longer after than the way takes.
    assert world.requested_s + 3.2 <= world.passed_s < world.requested_s + 3.2 + 0.4 / ROBOT.v_min_m_s
    assert "opened" in [record.event for record in done.records]


def test_a_travel_pushes_a_wing_open():
    world, done = driven(two_rooms(PassageKind.DOOR_PUSH), wing_m=0.3)
    assert done.arrived, done.reason
    assert world.pressed_m >= 0.3
    assert "passed" in [record.event for record in done.records]


def test_a_travel_keeps_its_distance_from_glass():
    """A pane across the straight way, which the map does not have: five centimetres more than the robot needs."""
    problem, pane_m = two_rooms(PassageKind.DOOR_PUSH), (0.65, 3.0, 1.95, 3.04)
    line = {"id": "pane", "type": "glass", "footprint_m": outline(*pane_m).tolist()}
    problem = replace(problem, goal_m=np.array([1.0, 4.5]), objects=objects_from_data({"objects": [line]}))
    world, gaps_m = DoorWorld([pane_m], DOOR_M, *problem.start_m.tolist()), []

    def wait(seconds):
        world.wait(seconds)
        gaps_m.append(world._gap_m(world.x, world.y, pane_m))

    assert travel(problem, world, world, wait).arrived
    # Through 55 or 60 cm beside a wall; 6 mm are of the tracking.
    assert ROBOT.radius_m + 0.05 - 0.006 < min(gaps_m) < 0.6 - ROBOT.radius_m


def test_a_door_that_stays_closed_is_planned_around_or_given_up():
    world, done = driven(two_rooms(PassageKind.DOOR_SLIDING))
    assert not done.arrived
    assert str(done.outcome) == "no plan"
    assert "closed" in [record.event for record in done.records]
    assert world.x < DOOR_M[0]


def test_a_passage_inside_of_a_wall_is_refused():
    """A wall of 50 cm: a door on its side, or all through it, leads somewhere; one that no free cell is beside does not."""
    cells = np.zeros((60, 60), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    cells[:, 20:30] = 100
    floor = OccupancyMap(cells, 0.05)

    def problem(x0, x1):
        door = Passage("door", outline(x0, 1.0, x1, 2.0), PassageKind.DOOR_SLIDING)
        return PlanningProblem(floor, ROBOT, np.array([0.5, 1.5]), np.array([2.2, 1.5]), passages=(door,))

    assert problem(0.95, 1.55).passages
    assert problem(1.0, 1.2).passages
    with pytest.raises(InputError, match=r"Passage: footprint_m: found 'door' with walls all around"):
        problem(1.15, 1.35)
