"""Common parts of hand tasks: arm, gripper and finger sensor, observations and commands."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core import FingerTouch, Frame, FrameSource, Gripper, Pose, ProbeArm, require_members
from ..framework.machine import Machine, StateT
from ..framework.run import run_machine
from ..framework.trace import Ending


@dataclass(frozen=True, slots=True)
class Hand:
    """An arm with a gripper that has a finger sensor. The tip is the centre between the fingers."""

    arm: ProbeArm
    gripper: Gripper
    source: FrameSource
    feel: Callable[[Frame], FingerTouch]
    #: downward load on the fingers [N], up to a constant; NaN if not measured. ``None``: no load sensor
    weigh: Callable[[Frame], float] | None = None
    weigh_scale: float = 0.0  #: relative standard deviation of the scale of the load sensor
    weigh_sigma_N: float = 0.0  #: standard deviation of its zero, not reduced by averaging [N]


@dataclass(frozen=True, slots=True)
class Place:
    """Grasp position on an upright object."""

    height_m: float  #: above its bottom [m]
    angle_rad: float = 0.0  #: of the fingers about its axis [rad]


@dataclass(frozen=True, slots=True)
class HandObservation:
    """One observation."""

    t_s: float
    tip_m: tuple[float, float, float]  #: in the base frame
    angle_rad: float  #: rotation of the tip about z
    opening_m: float
    felt: bool
    force_N: float
    surface_m: float
    load_N: float = math.nan  #: downward load on the fingers, up to a constant

    @property
    def saturated(self) -> bool:
        """Whether the finger presses beyond the range of its sensor."""
        return not self.felt and math.isinf(self.force_N)


@dataclass(frozen=True, slots=True)
class HandCommand:
    """One command; both parts hold until a later command changes them."""

    move: bool = False  #: whether the arm moves to ``tip_m`` and ``angle_rad``
    tip_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    angle_rad: float = 0.0
    speed_m_s: float = 0.0
    opening_m: float = math.nan  #: target of the gripper; NaN: hold
    finger_m_s: float = 0.0


class HandTask(Machine[StateT, HandObservation, HandCommand]):
    """Base class of hand tasks; arm and fingers hold by default."""

    def halt(self) -> HandCommand:
        """Command that holds arm and fingers, so that a grasped object is not dropped."""
        return HandCommand()

    def reached(self, seen: HandObservation, command: HandCommand) -> bool:
        """Whether the hand is where a command moves it.

        Parameters
        ----------
        seen
            The newest observation.
        command
            A command that moves the arm.
        """
        turned = abs(math.remainder(seen.angle_rad - command.angle_rad, 2.0 * math.pi))
        return math.dist(seen.tip_m, command.tip_m) < 5e-4 and turned < 2e-3

    def weighs(self, t_s: float) -> bool:
        """Whether to read the load at a time; otherwise the sensor is not evaluated.

        Parameters
        ----------
        t_s
            Time of the observation [s].
        """
        return False


def as_vector(values: Float[np.ndarray, "3"]) -> tuple[float, float, float]:
    """Convert three numbers to a tuple, as stored in traces.

    Parameters
    ----------
    values
        Three values of any unit.
    """
    return float(values[0]), float(values[1]), float(values[2])


def run_hand(hand: Hand, task: HandTask[Any]) -> Ending:
    """Step a task with every frame until it ends, and return its ending; arm and gripper hold at the end.

    Parameters
    ----------
    hand
        Arm, gripper, camera and sensors.
    task
        Hand task.

    Raises
    ------
    InputError
        A part of the hand lacks a member of its protocol.
    """
    require_members(hand.arm, ProbeArm, task.task, "arm")
    require_members(hand.gripper, Gripper, task.task, "gripper")
    require_members(hand.source, FrameSource, task.task, "frame source", members=("__iter__",))
    return run_machine(
        task,
        (_observation(hand, frame, task.weighs(frame.t_s)) for frame in hand.source),
        lambda command: _execute(hand, command),
        hand.gripper.stop,
        hand.arm.stop,
    )


def _observation(hand: Hand, frame: Frame, weighs: bool) -> HandObservation:
    reading = hand.feel(frame)
    _, pose = hand.arm.pose()
    return HandObservation(
        frame.t_s,
        as_vector(pose.translation_m),
        math.atan2(pose.rotation[1, 0], pose.rotation[0, 0]),
        hand.gripper.state().opening_m,
        bool(reading.valid and math.isfinite(reading.force_N)),
        float(reading.force_N),
        float(reading.surface_m),
        float(hand.weigh(frame)) if hand.weigh is not None and weighs else math.nan,
    )


def _execute(hand: Hand, command: HandCommand) -> None:
    if command.move:
        pose = Pose.from_rotation_vector([0.0, 0.0, command.angle_rad], np.array(command.tip_m))
        hand.arm.move_linear(pose, command.speed_m_s)
    else:
        hand.arm.stop()
    if math.isnan(command.opening_m):
        hand.gripper.stop()
    else:
        hand.gripper.move(command.opening_m, command.finger_m_s)
