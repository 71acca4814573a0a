"""Off-centre pushes: a box obliquely in a door, clearance from walls, rejected arguments."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.navigation.plan_scenes import ROBOT, STOOL, box, rooms, with_objects
from visuohaptic.core import InputError
from visuohaptic.navigation.planning import after_push, make_plan, plan_off_centre_pushes, without_pushing
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


def test_a_slanting_box_is_turned_out_of_the_way():
    asked = problem(slanting(0.9))
    pushes = plan_off_centre_pushes(asked, make_plan)
    assert pushes
    for push in pushes:
        assert 0.0 <= push.failure_probability <= 1.0
        assert np.allclose(push.approach_m[0], asked.start_m)
        # What is foreseen is what the model says of the same drive from scratch.
        ahead = np.array([math.cos(push.direction_rad), math.sin(push.direction_rad)])
        centre = asked.objects[0].centre_m
        trace = simulate_push(
            PushModel.patch(asked.objects[0].footprint_m - centre),
            (*centre, 0.0),
            line_path(push.start_m, push.start_m + push.length_m * ahead),
            ROBOT.radius_m,
        )
        # Paths are cut into steps of other lengths: of second order in 2 cm (quasi_static).
        assert np.hypot(*(trace.object_m[-1, :2] - centre - push.displacement_m)) < 0.01
        assert abs(trace.object_m[-1, 2] - push.turn_rad) < 0.05
        after = after_push(asked, "box", push.displacement_m, push.retreat_m, turn_rad=push.turn_rad)
        assert make_plan(after).reachable
        if push.opens:
            assert without_pushing(after).reachable
    costs = [push.cost_s / (1.0 - push.failure_probability) for push in pushes]
    assert costs == sorted(costs)


def test_a_plan_turns_an_object_where_no_straight_push_helps():
    # A plank across a door of 1 m, and a post behind its middle.
    walls = rooms(4.0, 3.0, [(1.9, 0.0, 2.0, 0.95), (1.9, 1.95, 2.0, 3.0), (2.45, 1.4, 2.55, 1.5)])
    asked = problem(slanting(0.0, 0.18, 0.9), walls=walls)
    straight = make_plan(asked)
    assert straight.proved  # for straight pushes
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
    pushes = plan_off_centre_pushes(problem(box(1.95, 1.45, 0.35)))
    assert all(push.opens for push in pushes)


def test_a_wall_behind_it_holds_it():
    walls = rooms(4.0, 3.0, [(1.9, 0.0, 2.0, 1.0), (1.9, 1.9, 2.0, 3.0), (2.2, 0.5, 2.3, 2.4)])
    for push in plan_off_centre_pushes(problem(slanting(math.pi / 2, 0.7, 0.5), walls=walls)):
        outline = (
            after_push(
                problem(slanting(math.pi / 2, 0.7, 0.5), walls=walls),
                "box",
                push.displacement_m,
                push.retreat_m,
                turn_rad=push.turn_rad,
            )
            .objects[0]
            .footprint_m
        )
        assert outline[:, 0].max() < 2.2 + 0.05  # half a cell, and 15 % of one inside


def test_a_margin_without_sense_is_refused():
    with pytest.raises(InputError, match="margin"):
        plan_off_centre_pushes(problem(slanting(0.9)), margin_m=1.0)
