"""A robot with a footprint drives, turns and pushes in MuJoCo as planned."""

from __future__ import annotations

import numpy as np
import pytest
from tests.navigation.plan_scenes import STOOL, box, rooms, with_objects

from visuohaptic.navigation.problem import MovableObject, PlanningProblem, RobotModel
from visuohaptic.simulation.floor import FloorObject, FloorRobot, FloorSenses, FloorWorld
from visuohaptic.tasks.mobile.travel import TravelSettings, travel

pytest.importorskip("mujoco")

#: 0.6 x 0.4 m: the circle around it needs a door of 0.72 m.
ROBOT = RobotModel.of_footprint([[0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2]], v_push_m_s=0.1)
DRIVE = FloorRobot(0.2, footprint_m=ROBOT.footprint_m)


def go(walls, objects, goal, *, pose=(0.7, 1.0, 0.0), hidden=None):
    problem = PlanningProblem(
        with_objects(walls, objects), ROBOT, np.array(pose[:2]), np.array(goal), tuple(objects)
    )
    items = [
        FloorObject(o.id, o.footprint_m, 2.7, 0.3, centre_offset_m=(0.02, -0.03), contact_friction=0.3)
        for o in objects
    ]
    world = FloorWorld(hidden or walls, items, pose, DRIVE)
    senses = FloorSenses(world, np.random.default_rng(0))
    return travel(problem, world.base, senses, world.step, TravelSettings(timeout_s=120.0)), world


def test_the_planned_push_and_turns_are_driven_through_a_door_that_the_circle_around_it_does_not_pass():
    walls = rooms(3.4, 2.0, [(1.4, 0.0, 1.5, 0.7), (1.4, 1.3, 1.5, 2.0)])
    done, world = go(walls, [MovableObject("stool", box(1.55, 1.0, 0.3), STOOL)], (2.2, 0.45))
    assert done.arrived
    # One plan: the object ends where it was planned, its mass beside its centre, and nothing is touched otherwise.
    assert (done.plans, done.pushes) == (1, 1)
    assert world.wall_s < 1e-9
    assert np.hypot(*(world.pose_m()[:2] - (2.2, 0.45))) < 0.06


def test_a_turn_into_an_unknown_wall_is_turned_back():
    walls = rooms(2.4, 2.0, [])
    cells = walls.cells.copy()
    cells[26:28, 8:14] = 100  # beside its rear, which swings over it
    done, _ = go(walls, [], (0.7, 0.5), pose=(0.7, 1.0, 0.0), hidden=type(walls)(cells, walls.resolution_m))
    bump = next(record for record in done.records if record.values.get("new"))
    again = next(r for r in done.records if r.event == "planned" and r.t_s > bump.t_s)
    assert bump.event in ("bumped", "overloaded", "stalled")
    assert abs(again.pose_m[2]) < 0.05  # the heading before the turn
    assert done.arrived


def test_a_turn_against_a_wall_stalls():
    world = FloorWorld(rooms(2.0, 2.0, []), [], (0.35, 1.0, 0.0), DRIVE)
    world.base.drive(0.0, 0.5)
    for _ in range(200):
        world.step(0.02)
    # Its left rear corner is at the wall from the start; with 2 rad it would face the wall.
    assert abs(world.pose_m()[2]) < 0.1
    assert world.wall_s > 0
