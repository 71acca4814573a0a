"""The simulated floor obeys Coulomb, walls stand, the drive has limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.navigation.plan_scenes import box, rooms

from visuohaptic import RobotModel
from visuohaptic.core import InputError, MobileBase
from visuohaptic.simulation.floor import FloorObject, FloorSenses, FloorWorld, SensorErrors

pytest.importorskip("mujoco")


def drive(world, speed, seconds, turn=0.0):
    world.base.drive(speed, turn)
    forces = []
    for _ in range(round(seconds / 0.02)):
        world.step(0.02)
        forces.append(world.touch.force_N if world.touch else 0.0)
    return np.array(forces)


@pytest.mark.parametrize("friction", [0.2, 0.4])
def test_a_push_needs_weight_times_friction(friction):
    item = FloorObject("box", box(2.5, 2.0, 0.4), 3.0, friction)
    world = FloorWorld(rooms(5, 4, []), [item], (2.0, 2.0, 0.0))
    forces = drive(world, 0.05, 8.0)
    x, y, yaw = world.object_pose_m("box")
    # The rim is at 2.3 - 0.17 = 2.13 first; then the box goes as far as the robot (foam gives way by mm).
    assert x - 2.5 == pytest.approx(world.pose_m()[0] - 2.13, abs=0.006)
    assert abs(y - 2.0) < 0.01
    assert abs(yaw) < 0.05
    # Coulomb, 10 %: contacts in MuJoCo are soft.
    assert np.median(forces[-100:]) == pytest.approx(item.friction_N, rel=0.1)


def test_what_is_too_heavy_stands_and_stops_the_robot():
    item = FloorObject("block", box(2.5, 2.0, 0.4), 10.0, 0.4)
    world = FloorWorld(rooms(5, 4, []), [item], (2.0, 2.0, 0.0))
    drive(world, 0.05, 8.0)
    # 39 N against 20 N: regularised friction creeps by half a millimetre per second.
    assert world.object_pose_m("block")[0] - 2.5 < 0.01
    assert world.pose_m()[0] < 2.15


def test_the_planners_model_of_the_robot_is_refused():
    with pytest.raises(InputError, match="FloorWorld: robot: found RobotModel, expected FloorRobot"):
        FloorWorld(rooms(3, 3, []), [], (1.5, 1.5, 0.0), RobotModel(0.17))  # type: ignore[arg-type]


@pytest.mark.parametrize("round_m", [0.0, 0.2])
def test_an_object_in_a_wall_is_refused_and_one_against_it_weighs_what_it_weighs(round_m):
    with pytest.raises(InputError, match=r"FloorWorld: objects: found 'box' on \d+ cells of walls, such as"):
        FloorWorld(
            rooms(3, 3, []),
            [FloorObject("box", box(0.1, 1.5, 0.4), 3.0, 0.3, round_m=round_m)],
            (1.5, 1.5, 0.0),
        )
    item = FloorObject("box", box(0.25, 1.5, 0.4), 3.0, 0.3, round_m=round_m)
    world = FloorWorld(rooms(3, 3, []), [item], (0.9, 1.5, math.pi))
    forces = drive(world, 0.05, 8.0)
    # It stands at the wall: the robot stalls above the force of its drive, not at one of kilonewtons.
    assert 0 < forces[-20:].max() < 2 * world.robot.force_max_N


def test_what_is_not_on_the_floor_is_not_seen():
    world = FloorWorld(rooms(3, 3, []), [FloorObject("box", box(2, 2, 0.4), 3.0, 0.3)], (1.5, 1.0, 0.0))
    senses = FloorSenses(world, np.random.default_rng(0))
    assert senses.look("box") is not None
    assert senses.look("pane") is None


def test_walls_stand():
    world = FloorWorld(rooms(3, 3, []), [], (1.5, 1.5, 0.0))
    drive(world, 0.3, 6.0)
    assert world.pose_m()[0] == pytest.approx(3.0 - 0.05 - 0.17, abs=0.01)
    assert world.wall_s > 0
    assert world.touch is None or world.touch.objects == ("",)


def test_free_space_costs_no_physics():
    world = FloorWorld(rooms(5, 4, []), [FloorObject("box", box(4, 3, 0.4), 3.0, 0.3)], (1.0, 1.0, 0.0))
    drive(world, 0.2, 4.0)
    assert world.steps == 0
    # 0.5 m/s^2 up to 0.2 m/s: 4 cm are lost.
    assert world.pose_m()[0] == pytest.approx(1.0 + 0.2 * 4.0 - 0.04, abs=0.002)
    assert isinstance(world.base, MobileBase)


def test_pushed_beside_the_centre_it_turns_away():
    item = FloorObject("box", box(2.5, 2.0, 0.3), 3.0, 0.3, centre_offset_m=(0.0, 0.08))
    world = FloorWorld(rooms(6, 4, []), [item], (2.0, 2.0, 0.0))
    drive(world, 0.05, 12.0)
    # The centre of friction is to the left: the push, to the right of it, turns it to the left.
    assert world.object_pose_m("box")[2] > 0.3


def test_a_turned_map_is_the_same_world():
    grid = rooms(4, 3, [])
    turned = type(grid)(grid.cells, grid.resolution_m, (1.0, 2.0, math.pi / 2))
    world = FloorWorld(turned, [], (1.0 - 1.5, 2.0 + 2.0, math.pi / 2))
    drive(world, 0.3, 8.0)
    # Along the grid's x, which is the world's y: the wall's face is 3.95 from the origin.
    assert world.pose_m()[1] == pytest.approx(2.0 + 3.95 - 0.17, abs=0.01)


def test_senses_err_as_they_say():
    world = FloorWorld(rooms(4, 3, []), [FloorObject("box", box(3, 1.5, 0.3), 3.0, 0.3)], (1.0, 1.5, 0.0))
    errors = SensorErrors(place_m=0.02, drift_time_s=0.01)
    senses = FloorSenses(world, np.random.default_rng(1), errors)
    places = []
    for _ in range(300):
        world.step(0.02)
        places.append(senses.pose()[0])
    assert np.std(places) == pytest.approx(0.02, rel=0.15)  # 300 draws: 4 % one sigma
    assert senses.look("box") is not None
    assert FloorSenses(world, np.random.default_rng(1), SensorErrors(range_m=1.0)).look("box") is None


def test_bad_input():
    with pytest.raises(InputError, match="expected an outline, mass and floor friction > 0"):
        FloorObject("x", box(0, 0, 1), 0.0, 0.3)
    world = FloorWorld(rooms(2, 2, []), [], (1, 1, 0))
    with pytest.raises(InputError, match="found no object 'cat', expected one of: none"):
        world.footprint_m("cat")
    with pytest.raises(InputError, match="expected finite numbers"):
        world.base.drive(math.nan, 0.0)
