"""Sideward pushes release the object before the end, each failure is named, and plans with them hold."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from visuohaptic.core import HapticTag, InputError
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.planning import (
    SidewardOutcome,
    evaluate_push,
    make_plan,
    sideward_candidates,
    sideward_pushes,
)
from visuohaptic.navigation.planning.off_centre_rollouts import scene_of
from visuohaptic.navigation.planning.search import build_search_domain
from visuohaptic.navigation.planning.search.push_states import Deadline
from visuohaptic.navigation.problem import (
    MovableObject,
    PlanningProblem,
    PushMode,
    RobotModel,
    objects_from_data,
    plan_from_json,
)
from visuohaptic.navigation.pushing import line_path

ROBOT = RobotModel(0.17)
BOX = 0.15 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
PLACE = np.array([3.0, 2.0])
ENDS = np.array([-1.5, 0.0]), np.array([1.5, 0.0])  #: about the box


def hall(origin=(0.0, 0.0, 0.0)):
    cells = np.zeros((80, 120), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 100
    return OccupancyMap(cells, 0.05, origin)


def corridor(bay):
    """0.7 m wide, with a bay on one side behind the box, or 0.6 m without."""
    cells = np.full((80, 120), 100, np.int8)
    cells[33 : 47 if bay else 45, 1:119] = 0
    if bay:
        cells[33:60, 62:80] = 0
    return OccupancyMap(cells, 0.05)


def problem_in(map, tag=None, push=PushMode.SIDEWARD, goal=(4.5, 2.0)):
    thing = MovableObject("box", BOX + PLACE, tag or HapticTag(explored=3), push=push)
    return PlanningProblem(map, ROBOT, np.array([1.2, 2.0]), np.array(goal), (thing,))


def scene_in(map):
    domain = build_search_domain(problem_in(map))
    return scene_of(domain, 0)


def walls_of(map):
    rows, columns = np.nonzero(map.cells == 100)
    left, low = columns * 0.05 - PLACE[0], rows * 0.05 - PLACE[1]
    return shapely.union_all(shapely.box(left, low, left + 0.05, low + 0.05))


def placed(pose):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return shapely.Polygon(BOX @ np.array([[c, s], [-s, c]]) + pose[:2])


@pytest.mark.parametrize("map", [hall(), corridor(True)], ids=["hall", "bay"])
def test_a_box_is_brushed_aside(map):
    pushes = sideward_pushes(scene_in(map), *ENDS)
    assert pushes
    walls = walls_of(map)
    for push in pushes:
        # Clearance is interpolated between cells: a twentieth of one may be lost.
        assert shapely.LineString(push.path_m[:, :2]).distance(walls) > ROBOT.radius_m - 0.05 * 0.05
        assert all(placed(pose).distance(walls) > 0 for pose in push.trace.object_m)
        # Past the object: the platform at the end does not touch it any more.
        end = shapely.Point(push.path_m[-1, :2])
        assert placed(push.trace.object_m[-1]).distance(end) > ROBOT.radius_m - 1e-3
        assert push.path_m[0, 0] < 0.0 < push.path_m[-1, 0]
        assert push.cost_s > ROBOT.setup_time_s + 0.5 / ROBOT.v_push_m_s
    assert [push.cost_s for push in pushes] == sorted(push.cost_s for push in pushes)


def test_where_box_and_robot_are_wider_than_the_corridor_there_is_none():
    # 0.6 m; box 0.3 m and platform 0.34 m wide.
    assert sideward_pushes(scene_in(corridor(False)), *ENDS) == ()


def test_a_drive_of_which_nothing_could_be_simulated_is_no_safe_one(monkeypatch):
    """Every sampled object stands in the platform: that says nothing of the drive, and surely not that it succeeds."""
    from visuohaptic.navigation.planning import sideward_push
    from visuohaptic.navigation.pushing import quasi_static

    def simulated(model, place, path_m, radius_m):
        if tuple(place) != (0.0, 0.0, 0.0):
            raise InputError("object_m", "the platform starts inside the object")
        return quasi_static.simulate_push(model, place, path_m, radius_m)

    monkeypatch.setattr(sideward_push, "simulate_push", simulated)
    pushes = sideward_pushes(scene_in(hall()), *ENDS)
    assert pushes
    assert all(push.failure_probability == 1.0 and push.end_covariance is None for push in pushes)


def test_a_budget_that_is_spent_leaves_no_drive_to_simulate(monkeypatch):
    simulated = []
    monkeypatch.setattr(
        "visuohaptic.navigation.planning.sideward_push.evaluate_push",
        lambda scene, path: (simulated.append(path), evaluate_push(scene, path))[1],
    )
    assert sideward_pushes(scene_in(hall()), *ENDS, deadline=Deadline.after(-1.0)) == ()
    assert not simulated


def test_each_failure_has_its_name():
    scene = scene_in(hall())

    def outcome(start, end):
        return evaluate_push(scene, line_path(np.array(start), np.array(end)))[0]

    assert outcome((-0.5, 0.0), (0.5, 0.0)) is SidewardOutcome.CONTACT
    assert outcome((-0.5, 0.6), (0.5, 0.6)) is SidewardOutcome.UNTOUCHED
    assert outcome((-0.5, 0.25), (0.9, 0.25)) is SidewardOutcome.RELEASED
    assert outcome((0.0, 0.5), (0.0, -1.6)) is SidewardOutcome.COLLISION
    assert outcome((-0.5, 1.9), (0.5, 1.9)) is SidewardOutcome.BLOCKED


def test_the_way_has_to_lead_somewhere():
    with pytest.raises(InputError, match="expected two places"):
        sideward_candidates(scene_in(hall()), ENDS[0], ENDS[0])


@pytest.mark.parametrize("yaw", [0.0, 0.6])
def test_a_plan_drives_to_the_box_past_it_and_on(yaw):
    """On a turned map everything turns: start, goal and box are placed in its frame."""
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, s], [-s, c]])
    bay = corridor(True)
    map = OccupancyMap(bay.cells, 0.05, (0.4, -0.3, yaw))
    shift = np.array([0.4, -0.3])
    thing = MovableObject("box", (BOX + PLACE) @ turn + shift, HapticTag(explored=3), push=PushMode.SIDEWARD)
    ends = np.array([1.2, 2.0]) @ turn + shift, np.array([5.5, 2.0]) @ turn + shift
    plan = make_plan(PlanningProblem(map, ROBOT, *ends, (thing,)))
    assert [task.kind for task in plan.tasks] == ["navigate", "sideward", "navigate"]
    brush = plan.tasks[1]
    own = [(np.array(points) - shift) @ turn.T - PLACE for points in (brush.path_m, [brush.goal_m])]
    walls = walls_of(bay)
    assert shapely.LineString(own[0]).distance(walls) > ROBOT.radius_m - 0.05 * 0.05
    after = placed((*own[1][0], brush.turn_rad))
    assert after.distance(walls) > 0
    # What is driven afterwards keeps clear of where the box is by then; 5 mm for the grid of clearances.
    onward = (np.array(plan.tasks[2].path_m) - shift) @ turn.T - PLACE
    assert shapely.LineString(onward).distance(after) > ROBOT.radius_m - 0.005
    for before, later in zip(plan.tasks[:-1], plan.tasks[1:], strict=True):
        assert np.allclose(before.path_m[-1], later.path_m[0], atol=1e-6)
    assert plan.pushes == (brush,)
    assert np.linalg.eigvalsh(np.array(brush.end_covariance)).min() > 0
    again = plan_from_json(plan.to_json())
    assert again.tasks[1].turn_rad == pytest.approx(brush.turn_rad, abs=1e-6)


def test_what_is_free_of_it_or_may_not_move_is_not_brushed():
    # In the hall the detour is cheaper than pushing at 5 cm/s.
    assert not make_plan(problem_in(hall())).pushes
    assert not make_plan(problem_in(corridor(True), HapticTag(fixed=True))).reachable


def test_the_file_says_how_an_object_is_pushed():
    entry = {"id": "box", "footprint_m": BOX.tolist(), "haptic_tag": {"explored": 1}}
    (plain,) = objects_from_data({"objects": [entry]})
    assert plain.push is PushMode.DIRECT
    (aside,) = objects_from_data({"objects": [{**entry, "push": "sideward"}]})
    assert aside.push is PushMode.SIDEWARD
    (known,) = objects_from_data({"objects": [{**entry, "pose_sigma": [0.002, 0.01]}]})
    assert known.pose_sigma == pytest.approx((0.002, 0.01))
    with pytest.raises(InputError, match=r"push.*found 'under'.*direct.*sideward"):
        objects_from_data({"objects": [{**entry, "push": "under"}]})
