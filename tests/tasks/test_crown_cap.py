"""Opening a crown cap: order of Table 3.1, the claim compared with the truth, a reason for every failure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from visuohaptic.core import FrameSource, InputError, ProbeArm, Reason, Wrench
from visuohaptic.core.camera import Frame, Pose
from visuohaptic.rigs import open_virtual_cap, virtual_opener
from visuohaptic.rigs.virtual_crown_cap import SCAN_M
from visuohaptic.simulation.tabletop import CrownCapCell
from visuohaptic.simulation.tabletop.crown_cap import ROTATION_TOOL_SENSOR
from visuohaptic.tasks.framework import Trace, replay
from visuohaptic.tasks.manipulation import (
    CapObservation,
    CapOpening,
    CapOutcome,
    CapSettings,
    CrownCapTask,
    open_crown_cap,
    tool_wrench,
)

SETTINGS = CapSettings(scan_m=SCAN_M)


def wrench_of(cell: CrownCapCell, frame: Frame) -> Wrench:
    wrench, covariance = cell.feel(frame)
    return Wrench(frame.t_s, True, Reason.OK, wrench[:3], wrench[3:], covariance, "tool")


def attempt(cell: CrownCapCell, settings: CapSettings = SETTINGS, **parts: Any) -> CapOpening:
    feel = parts.get("feel", lambda frame: wrench_of(cell, frame))
    return open_crown_cap(cell.arm, cell, feel, parts.get("look", cell.look), settings)


def test_the_rows_of_table_3_1_in_their_order(tmp_path: Path) -> None:
    trial = open_virtual_cap(0, "tracked")
    assert trial.opening.opened
    assert trial.truly_open
    states = trial.opening.trace.states()
    rows = ["find", "track", "approach", "push_down", "feel", "forward", "rotate", "leave", "check"]
    assert [states.index(row) for row in rows] == sorted(states.index(row) for row in rows)
    trial.opening.trace.save(tmp_path / "cap.jsonl")
    read = Trace.load(tmp_path / "cap.jsonl")
    assert replay(read, CrownCapTask(SETTINGS), CapObservation) == trial.opening.ending


@pytest.mark.parametrize(("seed", "sight"), [(1, "start"), (2, "start"), (3, "corner")])
def test_a_centimetre_and_five_degrees_off(seed: int, sight: Any) -> None:
    """Three of the benchmark's 150."""
    trial = open_virtual_cap(seed, sight)
    assert trial.opening.ending.outcome == CapOutcome.OPENED
    assert trial.truly_open


def test_the_protocols() -> None:
    cell = virtual_opener(0)
    assert isinstance(cell, FrameSource)
    assert isinstance(cell.arm, ProbeArm)


def test_no_bottle_is_not_found() -> None:
    cell = virtual_opener(0)
    cell.position_base_m = np.array([0.5, 0.1, -5.0])
    found = attempt(cell)
    assert found.ending.outcome == CapOutcome.NOT_FOUND
    assert found.ending.why == "2 places looked at"


def test_a_bottle_that_is_taken_away_gives_no_contact() -> None:
    cell = virtual_opener(0)
    seen = cell.look(next(iter(cell)))
    assert seen.valid

    def look(frame: Frame) -> Any:
        found = cell.look(frame)
        # Taken away as soon as the arm is above it.
        if cell.arm.true_pose().translation_m[2] < cell.position_base_m[2] + 0.06:
            cell.position_base_m = np.array([0.5, 0.1, -5.0])
        return found

    found = attempt(cell, look=look)
    assert found.ending.outcome == CapOutcome.NO_CONTACT


def test_a_cap_that_holds_is_not_claimed_to_be_open() -> None:
    cell = virtual_opener(0, "tracked")
    cell.open_N = 1e4
    found = attempt(cell, replace(SETTINGS, attempts=2))
    assert not found.opened
    assert found.ending.outcome in (CapOutcome.TOO_TIGHT, CapOutcome.STILL_CLOSED)
    assert found.ending.why


def test_a_blocked_view_is_not_success() -> None:
    """Once touched, the camera sees nothing any more, and the cap holds: nothing may be claimed."""
    cell = virtual_opener(0, "tracked")
    cell.open_N = 1e4
    blocked = [False]

    def look(frame: Frame) -> Any:
        found = cell.look(frame)
        blocked[0] = blocked[0] or bool(np.abs(cell.wrench_tool[:3]).max() > 3)
        return replace(found, valid=False) if blocked[0] else found

    found = attempt(cell, replace(SETTINGS, attempts=1, turn_rad=0.05), look=look)
    assert found.ending.outcome == CapOutcome.NOT_VERIFIED


def test_a_blind_sensor_stops_the_arm() -> None:
    cell = virtual_opener(0)

    def feel(frame: Frame) -> Wrench:
        return replace(wrench_of(cell, frame), valid=False, reason=Reason.OCCLUDED)

    found = attempt(cell, feel=feel)
    assert found.ending.outcome == CapOutcome.SENSOR_FAILED
    _, before = cell.arm.pose()
    cell.arm.advance(1.0)
    assert np.array_equal(cell.arm.pose()[1].translation_m, before.translation_m)


def test_out_of_reach_and_ended_sources_are_said() -> None:
    cell = virtual_opener(0, duration_s=1.0)
    assert attempt(cell).ending.outcome == CapOutcome.SOURCE_ENDED
    cell = virtual_opener(0)
    found = attempt(
        cell, CapSettings(scan_m=((3.0, 0.0, 0.0),)), look=lambda f: replace(cell.look(f), valid=False)
    )
    assert found.ending.outcome == CapOutcome.OUT_OF_REACH
    assert "out of reach" in found.ending.why


def test_wrenches_turn_into_the_tool() -> None:
    """The rod points forward: a pull along it is along y of the tool; lengths and covariances stay."""
    rng = np.random.default_rng(1)
    root = rng.standard_normal((6, 6))
    sensor = Wrench(0.0, True, Reason.OK, np.array([1.0, 2, 3]), np.array([4.0, 5, 6]), root @ root.T)
    tool = tool_wrench(sensor, ROTATION_TOOL_SENSOR)
    assert tool.force_N.tolist() == [-2, 1, 3]
    assert tool.moment_Nm.tolist() == [-5, 4, 6]
    assert np.allclose(np.linalg.eigvalsh(tool.covariance), np.linalg.eigvalsh(sensor.covariance))


def test_bad_settings_are_refused() -> None:
    with pytest.raises(InputError, match="press_N: found -1"):
        CapSettings(press_N=-1.0)


def test_a_pushed_tool_carries_what_the_beam_gives_way() -> None:
    """Law of the cell: force = stiffness x deflection, and F_z alone on a level, centred bridge."""
    cell = virtual_opener(0, error_rad=0.0)
    # The arch stands 3.2 mm above the edge of 13.3 mm that it bears on; the hook is clear behind.
    above = cell.position_base_m + np.array([0.0, -0.005, 0.002])
    cell.arm.move_linear(Pose(np.eye(3), above), 1.0)
    for _ in zip(range(30), cell, strict=False):
        pass
    # The arch overlaps the cap by 0.7 mm: 13.5 N on the beam alone, less for the contact that gives way.
    assert 0.5 * 13.5 < cell.wrench_tool[2] < 13.5
    assert abs(cell.wrench_tool[0]) < 0.05 * cell.wrench_tool[2]
    assert abs(cell.wrench_tool[4]) < 1e-3 * cell.wrench_tool[2]
    assert np.allclose(cell.beam.compliance_tool @ cell.wrench_tool, cell.deflection, atol=1e-12)
