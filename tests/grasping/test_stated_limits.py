"""What constants of grasping are said to do, by other means."""

from __future__ import annotations

import numpy as np
import pytest

from visuohaptic.grasping import feasibility, match, rim
from visuohaptic.grasping.force import GripperModel, Load
from visuohaptic.grasping.grasp_task import GraspTask
from visuohaptic.recognition.touch import refinement


def test_points_of_a_match_know_their_residual_to_a_seventh() -> None:
    """Root mean square of the residuals of a fit of seven unknowns, as in a linear one."""
    rng = np.random.default_rng(1)
    free = rng.standard_normal((20_000, match.MIN_POINTS - 7))
    assert np.sqrt(np.mean(free**2, axis=1)).std() == pytest.approx(0.147, rel=0.07)


def test_a_map_without_a_deviation_has_that_of_a_class() -> None:
    """Common and local part of the ratio of an object's stiffness to that of its class, which recognition states."""
    common, local, _ = refinement.CLASS
    assert pytest.approx(np.hypot(common, local), rel=0.01) == feasibility.UNSTATED_SIGMA


def test_a_rim_is_held_while_the_pressure_of_a_finger_is_uneven_by_half() -> None:
    """Moment of the pressure p (1 + y / 2 r) on the disc of a finger, by quadrature, against that of half of the weight."""
    y = np.linspace(-1.0, 1.0, 4001)
    chord = 2.0 * np.sqrt(1.0 - y**2)
    pressure = 1.0 + 0.5 * y
    arm = float((chord * pressure * y).sum() / (chord * pressure).sum())
    radius_m = GripperModel().finger_radius_m
    load, task = Load(0.2, (0.05, 0.0, 0.0)), GraspTask(gripper=GripperModel(friction=50.0))
    weight_N = 0.2 * (9.81 + task.handling.acceleration_m_per_s2)
    found = rim._needed_N(np.zeros(3), np.array([1.0, 0.0, 0.0]), load, task)
    assert found == pytest.approx(task.handling.safety * 0.5 * weight_N * 0.05 / (arm * radius_m), rel=0.02)
