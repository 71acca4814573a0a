"""Open a crown cap with an opener on a beam sensor (Alt 2016, Sec. 3.6.5)."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from ...core import Frame, FrameSource, Pose, ProbeArm, Wrench, require_members
from ...core.geometry import so3_log
from ..framework.run import run_machine
from .crown_cap_records import CapCommand, CapObservation, CapOpening, CapOutcome, CapSettings, CapSighting
from .crown_cap_task import CrownCapTask
from .hand import as_vector


def open_crown_cap(
    arm: ProbeArm,
    source: FrameSource,
    feel: Callable[[Frame], Wrench],
    look: Callable[[Frame], CapSighting],
    settings: CapSettings | None = None,
) -> CapOpening:
    """Find, touch and open a crown cap.

    Parameters
    ----------
    arm
        Arm with sensor, opener and camera; at the start the axes of the tool are those of the base, up to a rotation about z.
    source
        Frames of the camera.
    feel
        Wrench on the tool about its tip in the axes of the tool, see :func:`tool_wrench`.
    look
        Detects the cap: position in the tip frame.
    settings
        Distances, forces and limits.

    Returns
    -------
    CapOpening
        With the reason and a trace for :func:`~visuohaptic.tasks.framework.machine.replay`.

    Raises
    ------
    InputError
        ``arm`` or ``source`` lacks a member of its protocol.
    """
    require_members(arm, ProbeArm, "open_crown_cap", "arm")
    require_members(source, FrameSource, "open_crown_cap", "frame source", members=("__iter__",))
    task = CrownCapTask(settings)
    ending = run_machine(
        task,
        (_observation(frame, arm, feel(frame), look(frame)) for frame in source),
        lambda command: _tell(arm, command),
        arm.stop,
        refused=CapOutcome.OUT_OF_REACH,
    )
    return CapOpening(ending, task.trace(), task.attempts)


def tool_wrench(wrench: Wrench, rotation_tool_sensor: Float[np.ndarray, "3 3"]) -> Wrench:
    """Rotate a wrench about the tip from the axes of the beam sensor to those of the tool.

    Parameters
    ----------
    wrench
        Wrench about the tip, in the axes of the sensor.
    rotation_tool_sensor
        Rotation from the axes of the sensor to those of the tool.
    """
    turn = np.asarray(rotation_tool_sensor, dtype=np.float64)
    both = np.kron(np.eye(2), turn)
    return Wrench(
        wrench.t_s, wrench.valid, wrench.reason, turn @ wrench.force_N, turn @ wrench.moment_Nm,
        both @ wrench.covariance @ both.T, "tool",
    )  # fmt: skip


def _observation(frame: Frame, arm: ProbeArm, wrench: Wrench, sighting: CapSighting) -> CapObservation:
    _, pose = arm.pose()
    cap = pose.apply(np.asarray(sighting.position_tip_m, float)) if sighting.valid else np.full(3, math.nan)
    felt = wrench.valid and bool(np.isfinite(wrench.force_N).all() and np.isfinite(wrench.moment_Nm).all())
    seen = bool(sighting.valid and np.isfinite(cap).all())
    return CapObservation(
        frame.t_s, as_vector(pose.translation_m), as_vector(so3_log(pose.rotation)), felt,
        as_vector(wrench.force_N), as_vector(wrench.moment_Nm), seen, as_vector(cap),
    )  # fmt: skip


def _tell(arm: ProbeArm, command: CapCommand) -> None:
    if not command.move:
        arm.stop()
        return
    arm.move_linear(Pose.from_rotation_vector(command.turn_rad, command.tip_m), command.speed_m_s)
