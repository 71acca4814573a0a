"""Records survive JSON and contain the motion of objects; a navigation run is replayed from its trace."""

from __future__ import annotations

import json

import numpy as np
import pytest
from tests.navigation.plan_scenes import ROBOT, STOOL, box, rooms, with_objects
from tests.tasks.block_robot import BlockRobot

from visuohaptic.core import InputError, from_dict, to_dict
from visuohaptic.navigation.problem import MovableObject, PlanningProblem
from visuohaptic.tasks.framework import Trace, replay
from visuohaptic.tasks.mobile.travel import (
    TravelObservation,
    TravelRecord,
    TravelSettings,
    TravelTask,
    travel,
)

TRACE = (
    TravelRecord(0.5, "plan", "planned", (1.0, 2.0, 0.5), values={"reachable": True, "tasks": ["navigate"]}),
    TravelRecord(9.0, "plan", "looked", (1.0, 2.0, 0.5), "box", {"place_m": [1.0, 2.0, 0.1]}),
    TravelRecord(9.5, "plan", "looked", (1.0, 2.0, 0.5), "box", {"place_m": [1.5, 2.0, 0.2]}),
)


def test_round_trip():
    stored = json.loads(json.dumps([to_dict(record) for record in TRACE]))
    assert tuple(from_dict(TravelRecord, record) for record in stored) == TRACE


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ({"state": "plan", "event": "", "t_s": 1}, "pose_m: is missing"),
        ({"pose_m": [0, 0], "t_s": 1, "state": "", "event": ""}, "pose_m"),
        (
            {"pose_m": [0, "nan", 0], "t_s": 1, "state": "", "event": ""},
            r"trace\[0\]: pose_m: found .* finite number",
        ),
        (
            {"pose_m": [0, 0, 0], "t_s": "inf", "state": "", "event": ""},
            r"trace\[0\]: t_s: found inf, .* finite number",
        ),
        (7, "expected a mapping"),
    ],
)
def test_bad_records(entry, text):
    with pytest.raises(InputError, match=text):
        from_dict(TravelRecord, entry, where="trace[0]")


def test_a_travel_is_replayed_from_its_trace(tmp_path):
    """A block in a door is pushed: the recorded observations alone lead to the same plans, pushes and ending."""
    walls = rooms(4.0, 3.0, [(1.9, 0.0, 2.0, 1.0), (1.9, 1.9, 2.0, 3.0)])
    block = MovableObject("block", box(1.95, 1.4, 0.35), STOOL)
    problem = PlanningProblem(
        with_objects(walls, [block]), ROBOT, np.array([0.7, 1.4]), np.array([3.4, 1.4]), (block,)
    )
    robot = BlockRobot(8.0, stiffness_N_per_m=2e4)
    settings = TravelSettings(timeout_s=25.0)
    done = travel(problem, robot, robot, robot.wait, settings)
    assert done.trace.states()[:4] == ("plan", "drive", "push", "back off")
    assert done.pushes >= 1
    done.trace.save(tmp_path / "travel.jsonl")
    trace = Trace.load(tmp_path / "travel.jsonl")
    again = TravelTask(problem, settings)
    assert replay(trace, again, TravelObservation) == done.trace.ending
    assert tuple(again.records) == done.records
    with pytest.raises(InputError, match=r"step .*expected"):
        replay(trace, TravelTask(problem, TravelSettings(timeout_s=5.0)), TravelObservation)
