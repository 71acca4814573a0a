"""Completion by touch with an arm: a hidden bulge is found, the stop rule works, failures have reasons."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from visuohaptic.core import FrameSource, InputError, Reason, Wrench
from visuohaptic.core.camera import Frame, Pose
from visuohaptic.reconstruction import SurfaceMesh
from visuohaptic.reconstruction.completion import Completion, HoleRegion
from visuohaptic.simulation.tabletop import Bottle, ProbeCell, SimulatedArm
from visuohaptic.tasks.framework import replay
from visuohaptic.tasks.manipulation import (
    CompleteOutcome,
    CompleteSettings,
    CompleteTask,
    CompletionByTouch,
    ProbeObservation,
    complete_by_touch,
)

#: Its belly begins and ends where nobody sees it.
BOTTLE = Bottle(
    "round", 0.2, np.array([0.0, 0.065, 0.135, 0.16, 0.185, 0.2]),
    np.array([0.03, 0.03, 0.03, 0.028, 0.015, 0.015]), np.array([0.0, 0.012, 0.0, 0.0, 0.0]), 1.0, 10.0,
)  # fmt: skip
PLACE = Pose.from_rotation_vector([0.0, 0.0, 0.7], [0.5, 0.1, 0.0])
SETTINGS = CompleteSettings(bound_m=0.002, touches=8, top_m=0.2, compliance_m_per_N=1 / 2000.0)
LOW_M, HIGH_M = 0.054, 0.146


def unfinished() -> Completion:
    visible = SurfaceMesh(*BOTTLE.mesh(0.0, LOW_M)).joined(SurfaceMesh(*BOTTLE.mesh(HIGH_M, 0.2)))
    hidden, _ = BOTTLE.mesh(LOW_M, HIGH_M, caps=False)
    centre = hidden.mean(axis=0)
    region = HoleRegion.of_points(centre + 0.9 * (hidden - centre))
    return Completion(visible, region, T_visual_haptic=PLACE.inverse())


def explore(
    settings: CompleteSettings = SETTINGS, valid: bool = True, **cell: Any
) -> tuple[CompletionByTouch, Completion]:
    arm = SimulatedArm(Pose(np.eye(3), np.array([0.3, 0.0, 0.3])), rng=np.random.default_rng(0))
    world = ProbeCell(arm, BOTTLE, np.random.default_rng(1), **({"T_base_bottle": PLACE} | cell))
    assert isinstance(world, FrameSource)

    def feel(frame: Frame) -> Wrench:
        return Wrench(frame.t_s, valid, Reason.OK, world.force(), np.zeros(3), np.eye(6))

    completion = unfinished()
    return complete_by_touch(arm, world, feel, completion, settings, T_base_visual=PLACE), completion


def wall_error_m(completion: Completion) -> float:
    points = completion.surface().vertices_m
    points = points[(points[:, 2] > LOW_M) & (points[:, 2] < HIGH_M)]
    wall = BOTTLE.radius_m(np.arctan2(points[:, 1], points[:, 0]), points[:, 2])
    return float(np.sqrt(np.mean((np.hypot(points[:, 0], points[:, 1]) - wall) ** 2)))


def test_touches_find_the_belly() -> None:
    before = wall_error_m(unfinished())
    found, completion = explore()
    assert found.ending.outcome in (CompleteOutcome.COMPLETED, CompleteOutcome.TOUCHES_USED)
    assert wall_error_m(completion) < 0.35 * before
    contacts = np.array(
        [PLACE.inverse().apply(t.contact_m) for t in found.touches if t.contact_m is not None]
    )
    assert len(contacts) >= 3
    wall = BOTTLE.radius_m(np.arctan2(contacts[:, 1], contacts[:, 0]), contacts[:, 2])
    # A frame at 3 cm/s is a millimetre deep, which the compliance takes out; 0.03 N are 0.02 mm.
    assert np.abs(np.hypot(contacts[:, 0], contacts[:, 1]) - wall).max() < 2e-4
    assert found.ending.success == completion.done(SETTINGS.bound_m)
    assert replay(found.trace, CompleteTask(SETTINGS), ProbeObservation) == found.ending


def test_a_missing_bottle_uses_its_touches_up() -> None:
    """Lines that meet nothing are no contacts, and nothing is claimed."""
    found, _ = explore(replace(SETTINGS, touches=2), T_base_bottle=Pose(np.eye(3), np.array([9.0, 0.0, 0.0])))
    assert found.ending.outcome == CompleteOutcome.TOUCHES_USED
    assert [touch.contact_m for touch in found.touches] == [None, None]


def test_other_failures() -> None:
    found, _ = explore(valid=False)
    assert found.ending.outcome == CompleteOutcome.SENSOR_FAILED
    found, _ = explore(duration_s=0.5)
    assert found.ending.outcome == CompleteOutcome.SOURCE_ENDED
    found, _ = explore(replace(SETTINGS, top_m=2.0))
    assert found.ending.outcome == CompleteOutcome.OUT_OF_REACH
    task = CompleteTask(SETTINGS)
    line = ((0.4, 0.0, 0.1), (0.5, 0.0, 0.1), 0, 0.01, False)
    task.step(ProbeObservation(0.0, (0.3, 0.0, 0.3), True, 0.0, *line))
    task.step(ProbeObservation(0.1, (0.3, 0.0, 0.2), True, 3.0, *line))
    assert task.ending is not None
    assert task.ending.outcome == CompleteOutcome.BLOCKED
    with pytest.raises(InputError, match="bound_m: found nan"):
        CompleteSettings(bound_m=math.nan)
