"""Exploration tours driven in MuJoCo: what is touched, in which order, and the tags that result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.navigation.plan_scenes import ROBOT, box, rooms, with_objects

from visuohaptic.core import InputError
from visuohaptic.navigation.problem import MovableObject, PlanningProblem
from visuohaptic.simulation.floor import FloorObject, FloorSenses, FloorWorld
from visuohaptic.tasks.framework import replay
from visuohaptic.tasks.mobile.travel import FloorExploration, TravelObservation, TravelOutcome, drive_task

pytest.importorskip("mujoco")


def scene(masses):
    walls = rooms(
        6.0, 4.0, [(2.9, 0.0, 3.0, 1.0), (2.9, 1.9, 3.0, 4.0), (0.0, 2.4, 0.6, 2.5), (1.5, 2.4, 3.0, 2.5)]
    )
    places = {"east": box(2.95, 1.45, 0.4), "north": box(1.05, 2.45, 0.4), "idle": box(2.4, 0.5, 0.3)}
    items = tuple(MovableObject(id, outline_m) for id, outline_m in places.items())
    problem = PlanningProblem(
        with_objects(walls, items), ROBOT, np.array([0.7, 0.8]), np.array([0.7, 1.6]), items
    )
    bodies = [FloorObject(o.id, o.footprint_m, masses[o.id], 0.3) for o in items]
    world = FloorWorld(walls, bodies, (0.7, 0.8, 0.3))
    return problem, world, FloorSenses(world, np.random.default_rng(0))


LIGHT = {"east": 2.7, "north": 500.0, "idle": 2.7}


def test_a_floor_is_learned_by_touch_and_the_tags_are_those_of_the_world():
    problem, world, senses = scene(LIGHT)
    done = drive_task(FloorExploration(problem, 300.0), world.base, senses, world.step)
    assert done.outcome is TravelOutcome.EXPLORED
    assert done.reason == "nothing more is worth exploring"
    tags = {item.id: item.tag for item in done.problem.objects}
    assert tags["idle"] is None  # it opens no shorter way
    assert tags["east"].fixed is False
    assert abs(tags["east"].static_friction_N.value - 2.7 * 9.81 * 0.3) < 1.5
    assert tags["north"].fixed is True
    touched = [record.object for record in done.records if record.event == "explored"]
    assert sorted(touched) == ["east", "north"]
    assert done.duration_s < 300.0
    again = FloorExploration(problem, 300.0)
    assert replay(done.trace, again, TravelObservation) == done.trace.ending
    assert [step.object for step in again.tours[0].steps] == touched


def test_without_time_nothing_is_touched_and_the_tour_ends_at_the_goal():
    problem, world, senses = scene(LIGHT)
    done = drive_task(FloorExploration(problem, 9.0, to_goal=True), world.base, senses, world.step)
    assert done.arrived
    assert all(item.tag is None for item in done.problem.objects)
    assert np.hypot(*(world.pose_m()[:2] - problem.goal_m)) < 0.06
    with pytest.raises(InputError, match="budget_s"):
        FloorExploration(replace(problem, objects=()), 0.0)
