"""Plans: checked with shapely, compared with the exact oracle, and invariant under irrelevant changes."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from visuohaptic.core import HapticTag, InputError
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.planning import (
    after_push,
    alternatives,
    make_plan,
    without_pushing,
)
from visuohaptic.navigation.planning.search import (
    SearchLimits,
    build_search_domain,
    push_states,
    search_pushes,
)
from visuohaptic.navigation.problem import MovableObject, PlanningProblem, PushCosts, PushMode, plan_from_json

from .plan_check import faults
from .plan_scenes import BIN, ROBOT, STOOL, box, office, random_scene, rooms, with_objects

#: So long that a busy machine changes no answer.
PATIENT = SearchLimits(budget_s=60.0)


def corridor(*tags: HapticTag | None, spacing_m: float = 1.6) -> PlanningProblem:
    """Rooms in a row, the doors between them closed by boxes that can be pushed on into the next room."""
    count = len(tags)
    width = 1.6 + count * spacing_m
    walls = []
    objects = []
    for index, tag in enumerate(tags):
        x = 1.2 + index * spacing_m
        walls += [(x, 0.0, x + 0.1, 0.9), (x, 1.6, x + 0.1, 2.5)]
        objects.append(MovableObject(f"box {index}", box(x + 0.05, 1.25, 0.4), tag))
    grid = with_objects(rooms(width, 2.5, walls), objects)
    return PlanningProblem(grid, ROBOT, np.array([0.5, 1.25]), np.array([width - 0.4, 1.25]), tuple(objects))


def test_figure_4_6_the_push_is_a_third_of_the_detour_and_costs_seven_seconds():
    problem = office()
    plans = alternatives(problem, PushCosts(price_ends=False))  # the text knows the end of a push
    push, detour = plans["cheapest"], plans["no pushing"]
    assert faults(problem, push) == []
    assert faults(problem, detour) == []
    assert [task.object for task in push.pushes] == ["stool"]
    assert push.length_m <= 0.35 * detour.length_m
    assert push.cost_s < detour.cost_s
    # 0.15 m, 4 s of setup, and 0.05 m/s, as in the text.
    pushed_m = float(np.hypot(*push.pushes[0].displacement_m))
    assert pushed_m == pytest.approx(0.15)
    assert push.pushes[0].cost_s == pytest.approx(4.0 + pushed_m / 0.05)
    assert plans["most reliable"].failure_probability == 0.0
    assert any("tower" in note for note in push.notes)


def test_figure_4_6_the_detached_room_is_reached_by_moving_the_table():
    problem = office((5.3, 3.6))
    assert not without_pushing(problem).reachable
    plan = make_plan(problem)
    assert plan.reachable
    assert {task.object for task in plan.pushes} == {"table"}
    assert faults(problem, plan) == []


def test_a_plan_is_the_same_after_json():
    plan = make_plan(office())
    data = json.loads(json.dumps(plan.to_json()))
    again = plan_from_json(data)
    assert again.to_json() == data
    assert data["cost_s"] == pytest.approx(sum(task["cost_s"] for task in data["tasks"]))
    assert data["length_m"] == pytest.approx(sum(task["length_m"] for task in data["tasks"]))
    with pytest.raises(InputError, match="tasks: is missing"):
        plan_from_json({"reachable": True})
    with pytest.raises(InputError, match="kind: found 'fly'"):
        plan_from_json({"reachable": True, "tasks": [{"kind": "fly", "cost_s": 1}]})


def test_a_turned_and_shifted_map_changes_nothing():
    problem = office()
    plan = make_plan(problem)
    yaw, shift = 2.1, np.array([-30.0, 12.0])
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    grid = OccupancyMap(problem.map.cells, problem.map.resolution_m, (shift[0], shift[1], yaw))
    turned = PlanningProblem(
        grid,
        ROBOT,
        turn @ problem.start_m + shift,
        turn @ problem.goal_m + shift,
        tuple(replace(item, footprint_m=item.footprint_m @ turn.T + shift) for item in problem.objects),
    )
    again = make_plan(turned)
    # Rounding decides between paths of equal cost on the lattice; the drives that are pulled tight along them differ by .8 %.
    assert [task.kind for task in again.tasks] == [task.kind for task in plan.tasks]
    for one, other in zip(again.tasks, plan.tasks, strict=True):
        assert one.cost_s == pytest.approx(other.cost_s, rel=0.01)
    assert again.length_m == pytest.approx(plan.length_m, rel=0.02)
    assert faults(turned, again) == []
    assert again.pushes[0].contact_m == pytest.approx(
        tuple(turn @ np.array(plan.pushes[0].contact_m) + shift), abs=1e-6
    )


@pytest.mark.parametrize("tag", [HapticTag(fixed=True), HapticTag(falls=True)])
def test_what_is_fixed_or_falls_is_never_pushed_and_that_there_is_no_way_is_proved(tag):
    problem = corridor(tag)
    plan = make_plan(problem)
    assert not plan.reachable
    assert plan.proved
    assert plan.reason == "walls and what is not pushed separate start and goal"
    assert plan.tasks == ()
    assert make_plan(corridor(STOOL)).reachable


@pytest.mark.parametrize("walled_in", [False, True])
@pytest.mark.parametrize("mode", [PushMode.SIDEWARD, PushMode.OFF_CENTRE])
def test_no_plan_is_proved_only_without_what_is_pushed_in_passing_or_beside_its_centre(mode, walled_in):
    """A block behind the door leaves a box no way out of it: shown by simulation for such pushes, not proved."""
    problem = corridor(STOOL)
    cells = problem.map.cells.copy()
    (low, left), (high, right) = np.rint(np.array([[0.55, 1.7], [1.95, 2.2]]) / problem.map.resolution_m)
    cells[int(low) : int(high), int(left) : int(right)] = 100
    if walled_in:
        cells[:, int(left)] = 100
    problem = replace(
        problem,
        map=OccupancyMap(cells, problem.map.resolution_m),
        objects=tuple(replace(item, push=mode) for item in problem.objects),
    )
    plan = make_plan(problem)
    assert not plan.reachable
    assert plan.proved == walled_in


@pytest.mark.parametrize("doorway", [(), (box(1.25, 1.25, 0.2),)])
def test_a_door_that_fits_the_robot_only_between_the_centres_of_cells_is_driven_through(doorway):
    """A door of 0.3 m is six cells of 5 cm: the centres nearest to its middle are 2.5 cm from it."""
    objects = tuple(MovableObject("box", outline, STOOL) for outline in doorway)
    walls = np.zeros((50, 50), np.int8)
    walls[[0, -1]] = walls[:, [0, -1]] = walls[:, 24:26] = 100
    walls[22:28, 24:26] = 0
    grid = with_objects(OccupancyMap(walls, 0.05), objects)

    def problem(radius_m):
        ends_m = np.array([0.6, 1.25]), np.array([1.9, 1.25])
        return PlanningProblem(grid, replace(ROBOT, radius_m=radius_m), *ends_m, objects)

    for radius_m in (0.14, 0.147):
        plan = make_plan(problem(radius_m), None, PATIENT)
        assert len(plan.pushes) == len(doorway)
        assert faults(problem(radius_m), plan) == []
        free = without_pushing(problem(radius_m), PATIENT)
        assert free.reachable != bool(doorway)
        assert alternatives(problem(radius_m), None, PATIENT)["no pushing"].cost_s == free.cost_s
    # Wider by 0.2 mm, and by 2 cm: cells of 1.5 mm do not decide the first.
    hardly, wide = (make_plan(problem(radius_m), None, PATIENT) for radius_m in (0.1502, 0.17))
    assert (hardly.reachable, hardly.proved, wide.reachable, wide.proved) == (False, False, False, True)


def test_several_doors_are_opened_one_after_the_other():
    problem = corridor(STOOL, BIN, STOOL)
    plan = make_plan(problem, limits=PATIENT)
    assert [task.object for task in plan.pushes] == ["box 0", "box 1", "box 2"]
    assert faults(problem, plan) == []


def test_clearing_one_passage_does_not_block_the_next():
    """The straight push of the first box would end in the second door; it has to stop before or go aside."""
    problem = corridor(STOOL, STOOL, spacing_m=1.0)
    # Limited by expanded configurations, the search gives the same answer on every machine.
    plan = make_plan(problem, limits=replace(PATIENT, expansions=500))
    assert plan.reachable
    assert faults(problem, plan) == []


def test_an_unknown_object_is_explored_first_and_only_when_that_is_expected_to_pay():
    plan = make_plan(corridor(None))
    assert plan.reachable
    kinds = [task.kind for task in plan.tasks]
    assert kinds.index("explore") < kinds.index("push")
    assert plan.expected_s == np.inf  # when it does not move there is no other way
    # With a way round that costs less than to explore and perhaps to fail, nothing is explored.
    problem = office()
    unknown = replace(
        problem, objects=tuple(replace(o, tag=None) if o.id == "stool" else o for o in problem.objects)
    )
    assert [task.kind for task in make_plan(unknown).tasks] == ["navigate"]


def test_replanning_after_a_push_and_with_a_tag_that_says_fixed():
    problem = office()
    plan = make_plan(problem)
    push = plan.pushes[0]
    robot_m = np.array(push.path_m[-1])
    stool, *rest_of_them = problem.objects
    fixed = replace(stool, tag=stool.tag.updated(fixed=True))
    other = make_plan(replace(problem, objects=(fixed, *rest_of_them)))
    assert other.reachable
    assert not other.pushes
    done = after_push(problem, "stool", np.array(push.displacement_m), robot_m)
    rest = make_plan(done)
    assert rest.reachable
    assert not rest.pushes
    assert faults(done, rest) == []
    assert done.objects[0].tag.explored == 2
    under = problem.map.cells.copy()
    row, column = problem.map.cell_from_world(problem.objects[0].centre_m).astype(int)
    under[row, column] = -1  # a scan does not see what is inside an object
    seen = replace(problem, map=OccupancyMap(under, problem.map.resolution_m, problem.map.origin))
    left = after_push(seen, "stool", np.array(push.displacement_m), robot_m)
    assert (left.map.cells == done.map.cells).all()
    with pytest.raises(InputError, match="has no object 'chair', there are: stool, table"):
        after_push(problem, "chair", np.zeros(2), robot_m)


def test_start_or_goal_in_a_wall_is_no_plan_and_off_the_map_an_error():
    problem = office()
    wall = make_plan(replace(problem, goal_m=np.array([1.9, 2.0])))
    assert not wall.reachable
    assert wall.proved
    assert "goal" in wall.reason
    start = make_plan(replace(problem, start_m=np.array([1.9, 2.0])))
    assert not start.reachable
    assert "start" in start.reason
    with pytest.raises(InputError, match=r"goal_m: found .* off the map"):
        replace(problem, goal_m=np.array([100.0, 0.0]))


def test_a_start_in_collision_is_left_straight_or_said_to_be_stuck():
    problem = office()
    # 1 cm from the room's wall, and the robot's radius is 17 cm.
    beside = replace(problem, start_m=np.array([0.06, 0.9]))
    plan = make_plan(beside)
    assert plan.reachable
    assert any("too near" in note for note in plan.notes)
    first = np.array(plan.tasks[0].path_m)
    assert first[0] == pytest.approx(beside.start_m)
    assert first[-1][0] > first[0][0]
    inside = make_plan(replace(problem, start_m=problem.objects[0].centre_m))
    assert not inside.reachable
    assert problem.objects[0].id in inside.reason


def test_a_proof_ends_with_its_memory():
    """Boxes with no way out of a row of narrow rooms: proved with room for all states, given up with room for two.

    With room for eight, for straight pushes only: oblique ones move the boxes to more places.
    """
    problem = corridor(STOOL, STOOL, spacing_m=0.6)
    plans = [
        make_plan(problem, limits=SearchLimits(memory_bytes=size, expansions=20))
        for size in (10**8, 8000, 2000)
    ]
    assert [(plan.reachable, plan.proved) for plan in plans] == [
        (False, True),
        (False, False),
        (False, False),
    ]
    moved = "pushes moves box 0 and box 1 out of the way"
    assert [plan.reason for plan in plans[:2]] == [
        f"no sequence of straight or oblique {moved}",
        f"no sequence of straight {moved}; not proved for oblique pushes",
    ]


def test_the_search_says_when_it_gave_up():
    problem = corridor(STOOL, STOOL, STOOL)
    domain = build_search_domain(problem)
    result = search_pushes(domain, domain.start, SearchLimits(expansions=1))
    assert not result.found
    assert not result.exhausted
    assert "not proved" in result.reason


def beside_a_box(fixed: bool) -> PlanningProblem:
    """Coarse cells: a box under a wall whose outline is larger than what the map draws; a way is left beside it."""
    cells = np.zeros((24, 40), np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    cells[:16, 20] = 100
    outline_m = np.array([[1.9, 1.55], [2.25, 1.55], [2.25, 1.84], [1.9, 1.84]])
    cells[16:18, 19:22] = 100
    return PlanningProblem(
        OccupancyMap(cells, 0.1),
        replace(ROBOT, radius_m=0.2),
        np.array([0.6, 1.2]),
        np.array([3.4, 1.2]),
        (MovableObject("box", outline_m, replace(STOOL, fixed=fixed)),),
    )


def test_an_object_counts_as_its_outline_whether_it_may_move_or_not():
    movable, fixed = beside_a_box(False), beside_a_box(True)
    free = without_pushing(movable)
    assert free.reachable
    assert faults(movable, free) == []
    assert make_plan(fixed).cost_s == free.cost_s
    assert make_plan(movable).cost_s <= free.cost_s


def test_the_cheapest_plan_is_one_and_the_same():
    scenes = [beside_a_box(False), beside_a_box(True), office()]
    scenes += [random_scene(np.random.default_rng(seed), 2, 24) for seed in range(4)]
    for problem in scenes:
        plan, compared = make_plan(problem, limits=PATIENT), alternatives(problem, limits=PATIENT)
        assert compared["cheapest"].to_json() == plan.to_json()
        assert plan.cost_s <= compared["no pushing"].cost_s


def test_a_slow_machine_finds_the_same_plans(monkeypatch):
    scenes = [office(), random_scene(np.random.default_rng(0), 2, 24)]
    plans = [make_plan(problem, limits=PATIENT).to_json() for problem in scenes]
    thread_time = push_states.time.thread_time
    # Each takes a quarter of a second or less; the default budget is two.
    monkeypatch.setattr(push_states.time, "thread_time", lambda: 4.0 * thread_time())
    assert [make_plan(problem).to_json() for problem in scenes] == plans


def test_an_object_wider_than_the_map_is_not_in_metres():
    problem = office()
    with pytest.raises(InputError, match=r"350 m wide on a map of .* expected metres"):
        replace(problem, objects=(MovableObject("stool", 1000 * box(2.0, 1.0, 0.35), STOOL),))
