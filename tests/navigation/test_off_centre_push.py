"""Off-centre pushes: a box obliquely in a door, clearance from walls, rejected arguments."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely

from tests.navigation.plan_scenes import ROBOT, STOOL, box, rooms, with_objects
from visuohaptic.core import InputError
from visuohaptic.navigation.planning import (
    after_push,
    make_plan,
    off_centre_rollouts,
    plan_off_centre_pushes,
    without_pushing,
)
from visuohaptic.navigation.planning.search import push_states
from visuohaptic.navigation.problem import MovableObject, PlanningProblem, PushMode, plan_from_json
from visuohaptic.navigation.pushing import PushModel, line_path, simulate_push

#: A wall with a door of 0.9 m.
WALLS = rooms(4.0, 3.0, [(1.9, 0.0, 2.0, 1.0), (1.9, 1.9, 2.0, 3.0)])


def slanting(angle_rad, width=0.6, height=0.3):
    """A box turned about its centre, in the door."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    half = 0.5 * np.array([[-width, -height], [width, -height], [width, height], [-width, height]])
    return half @ np.array([[c, s], [-s, c]]) + (1.95, 1.45)


def problem(outline, tag=STOOL, walls=WALLS):
    item = MovableObject("box", outline, tag)
    return PlanningProblem(
        with_objects(walls, [item]), ROBOT, np.array([0.7, 1.4]), np.array([3.4, 1.4]), (item,)
    )


def after_turn(asked, push):
    turn = push[-1]
    return after_push(asked, "box", turn.displacement_m, turn.path_m[-1], turn_rad=turn.turn_rad)


def test_a_slanting_box_is_turned_out_of_the_way():
    asked = problem(slanting(0.9))
    pushes = plan_off_centre_pushes(asked, make_plan)
    assert pushes
    for drive, turn in pushes:
        assert 0.0 <= turn.failure_probability <= 1.0
        assert np.allclose(drive.path_m[0], asked.start_m)
        # The way there, at a speed between those beside and far from obstacles; sqrt(2) for the grid's diagonals.
        assert (
            drive.length_m / ROBOT.v_max_m_s / 1.01 < drive.cost_s < 1.42 * drive.length_m / ROBOT.v_min_m_s
        )
        start, contact, end, retreat = np.array(turn.path_m)
        assert np.allclose(drive.path_m[-1], start)
        # Straight through the contact, and back on the same line.
        assert turn.length_m == pytest.approx(np.hypot(*(end - start)) + np.hypot(*(end - retreat)))
        assert shapely.Polygon(asked.objects[0].footprint_m).distance(
            shapely.Point(contact)
        ) == pytest.approx(ROBOT.radius_m, abs=1e-6)
        # What is foreseen is what the model says of the same drive from scratch.
        centre = asked.objects[0].centre_m
        trace = simulate_push(
            PushModel.patch(asked.objects[0].footprint_m - centre),
            (*centre, 0.0),
            line_path(start, end),
            ROBOT.radius_m,
        )
        # Paths are cut into steps of other lengths: of second order in 2 cm (quasi_static).
        assert np.hypot(*(trace.object_m[-1, :2] - centre - turn.displacement_m)) < 0.01
        assert np.allclose(centre + turn.displacement_m, turn.goal_m)
        assert abs(trace.object_m[-1, 2] - turn.turn_rad) < 0.05
        assert make_plan(after_turn(asked, (drive, turn))).reachable
    costs = [sum(task.cost_s for task in push) / (1.0 - push[-1].failure_probability) for push in pushes]
    assert costs == sorted(costs)


def test_a_plan_turns_an_object_where_no_straight_push_helps():
    # A plank across a door of 1 m, and a post behind its middle.
    walls = rooms(4.0, 3.0, [(1.9, 0.0, 2.0, 0.95), (1.9, 1.95, 2.0, 3.0), (2.45, 1.4, 2.55, 1.5)])
    asked = problem(slanting(0.0, 0.18, 0.9), walls=walls)
    straight = make_plan(asked)
    assert (
        straight.reason
        == "no sequence of straight pushes moves box out of the way; not proved for oblique pushes"
    )
    assert not straight.proved
    free = replace(asked, objects=tuple(replace(o, push=PushMode.OFF_CENTRE) for o in asked.objects))
    plan = make_plan(free)
    assert [task.kind for task in plan.tasks] == ["navigate", "turn", "navigate"]
    assert plan.answer == "no bound"
    (turn,) = plan.pushes
    assert abs(turn.turn_rad) > 0.3
    assert turn.path_m[0] == pytest.approx(plan.tasks[0].path_m[-1])
    after = after_push(asked, "box", turn.displacement_m, turn.path_m[-1], turn_rad=turn.turn_rad)
    assert without_pushing(after).reachable
    assert plan.cost_s == pytest.approx(sum(task.cost_s for task in plan.tasks), abs=1e-5)
    assert plan_from_json(plan.to_json()).tasks[1].kind == "turn"


def test_nothing_is_pushed_that_is_fixed_or_unknown():
    outline = slanting(0.9)
    assert plan_off_centre_pushes(problem(outline, replace(STOOL, fixed=True)), make_plan) == ()
    assert plan_off_centre_pushes(problem(outline, None), make_plan) == ()


def test_without_a_planner_only_pushes_that_open_a_way_are_told():
    for asked in (problem(box(1.95, 1.45, 0.35)), problem(slanting(0.9))):
        for push in plan_off_centre_pushes(asked):
            assert without_pushing(after_turn(asked, push)).reachable


def test_a_wall_behind_it_holds_it():
    walls = rooms(4.0, 3.0, [(1.9, 0.0, 2.0, 1.0), (1.9, 1.9, 2.0, 3.0), (2.2, 0.5, 2.3, 2.4)])
    asked = problem(slanting(math.pi / 2, 0.7, 0.5), walls=walls)
    for push in plan_off_centre_pushes(asked):
        outline = after_turn(asked, push).objects[0].footprint_m
        assert outline[:, 0].max() < 2.2 + 0.05  # half a cell, and 15 % of one inside


def test_the_simulations_end_with_the_budget(monkeypatch):
    asked, done = problem(slanting(0.9)), []

    def simulated(*args):
        done.append(args)
        return simulate_push(*args)

    # A clock that only a simulation moves, by 0.1 s.
    monkeypatch.setattr(push_states, "_clocks_s", lambda: (0.1 * len(done), 0.1 * len(done)))
    monkeypatch.setattr(off_centre_rollouts, "simulate_push", simulated)
    for budget_s in (1.0, 8.0):
        done.clear()
        pushes = plan_off_centre_pushes(asked, deadline=push_states.Deadline.after(budget_s))
        assert 5 * budget_s <= len(done) <= 5 * budget_s + 1  # half of the budget
    steps = [np.diff(args[2][[0, -1], :2], axis=0)[0] for args in done]
    assert np.ptp([math.atan2(y, x) for x, y in steps]) > 0.5 * math.pi  # not from one side alone
    assert pushes  # from those that were simulated
    assert plan_off_centre_pushes(asked, make_plan, deadline=push_states.Deadline.after(-1.0)) == ()


def test_a_margin_without_sense_is_refused():
    with pytest.raises(InputError, match="margin"):
        plan_off_centre_pushes(problem(slanting(0.9)), margin_m=1.0)
