"""The simulated arm: straight, at its speed, within its reach, with the configured errors."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.core import DeviceError, InputError, ProbeArm
from visuohaptic.core.camera import Pose
from visuohaptic.simulation.tabletop import SimulatedArm

START = Pose(np.eye(3), np.array([0.4, 0.0, 0.3]))


def test_straight_and_in_time() -> None:
    arm = SimulatedArm(START)
    assert isinstance(arm, ProbeArm)
    goal = Pose.from_rotation_vector([0.0, 0.0, 0.2], [0.5, 0.0, 0.3])
    arm.move_linear(goal, 0.1)
    arm.advance(0.5)
    t_s, pose = arm.pose()
    assert t_s == pytest.approx(0.5)
    assert np.allclose(pose.translation_m, [0.45, 0, 0.3])
    assert np.allclose(pose.rotation, Pose.from_rotation_vector([0, 0, 0.1], np.zeros(3)).rotation)
    arm.advance(0.5)
    assert np.allclose(arm.pose()[1].matrix, goal.matrix)
    arm.advance(5.0)
    assert np.allclose(arm.pose()[1].matrix, goal.matrix)


def test_a_turn_takes_its_time_and_stop_holds() -> None:
    arm = SimulatedArm(START, turn_rate_rad_s=0.5)
    arm.move_linear(Pose.from_rotation_vector([1.0, 0, 0], START.translation_m), 0.1)
    arm.advance(1.0)
    arm.stop()
    arm.advance(3.0)
    expected = Pose.from_rotation_vector([0.5, 0, 0], np.zeros(3)).rotation
    assert np.allclose(arm.pose()[1].rotation, expected)


def test_errors_are_of_the_truth_only() -> None:
    error = Pose.from_rotation_vector([0.05, 0, 0], [0.001, 0.002, 0.003])
    arm = SimulatedArm(START, error=error, repeat_sigma_m=1e-4, rng=np.random.default_rng(3))
    assert np.allclose(arm.true_pose().matrix, (START @ error).matrix)
    ends = []
    for k in range(200):
        arm.move_linear(Pose(np.eye(3), np.array([0.4, 0.0, 0.3 + 0.01 * (k % 2)])), 1.0)
        arm.advance(1.0)
        ends.append(arm.true_pose().translation_m - (arm.pose()[1] @ error).translation_m)
    # 600 values: the standard deviation is known to 3 %.
    assert np.std(ends) == pytest.approx(1e-4, rel=0.12)


def test_refused() -> None:
    arm = SimulatedArm(START)
    with pytest.raises(DeviceError, match=r"2\.000 m from the base is out of reach"):
        arm.move_linear(Pose(np.eye(3), np.array([2.0, 0, 0])), 0.1)
    with pytest.raises(InputError, match="expected more than 0"):
        arm.move_linear(START, 0.0)
    with pytest.raises(InputError, match=r"dt_s: found -1\.0, expected at least 0"):
        arm.advance(-1.0)
    with pytest.raises(InputError, match="found reach"):
        SimulatedArm(START, reach_m=(1.0, 0.5))
    assert arm.reach_m().tolist() == pytest.approx([0.15, 1.0])
