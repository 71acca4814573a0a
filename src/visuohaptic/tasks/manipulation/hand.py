"""What the tasks of the hand share: arm, gripper and finger sensor, and the observations made with them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core.camera.frame import Frame
from ...core.camera.pose import Pose
from ...core.robots import FingerTouch, FrameSource, Gripper, ProbeArm, require_members
from ..framework.machine import Machine, StateT
from ..framework.run import run_machine

__all__ = ["Hand", "HandCommand", "HandObservation", "HandTask", "Place", "as_vector", "run_hand"]


@dataclass(frozen=True, slots=True)
class Hand:
    """An arm with a gripper whose finger feels. The tip is the middle between the fingers."""

    arm: ProbeArm
    gripper: Gripper
    source: FrameSource
    feel: Callable[[Frame], FingerTouch]
    #: downward load on the fingers at a frame [N], up to a constant; NaN when it was not read. ``None``: no sensor
    weigh: Callable[[Frame], float] | None = None
    weigh_scale: float = 0.0  #: relative standard deviation of what that sensor takes for a newton
    weigh_sigma_N: float = 0.0  #: standard deviation of its zero, which many readings do not make less


@dataclass(frozen=True, slots=True)
class Place:
    """Where to grasp an object that stands upright."""

    height_m: float  #: above its bottom
    angle_rad: float = 0.0  #: of the fingers about its axis


@dataclass(frozen=True, slots=True)
class HandObservation:
    """One observation."""

    t_s: float
    tip_m: tuple[float, float, float]  #: in the base
    angle_rad: float  #: turn of the tip about z
    opening_m: float
    felt: bool
    force_N: float
    surface_m: float
    load_N: float = math.nan  #: downward on the fingers, up to a constant


@dataclass(frozen=True, slots=True)
class HandCommand:
    """One command; both parts hold until the next one that says otherwise."""

    move: bool = False  #: the arm, to ``tip_m`` and ``angle_rad``
    tip_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    angle_rad: float = 0.0
    speed_m_s: float = 0.0
    opening_m: float = math.nan  #: of the gripper; NaN: it holds
    finger_m_s: float = 0.0


class HandTask(Machine[StateT, HandObservation, HandCommand]):
    """A task of the hand: arm and fingers hold where nothing else is said."""

    def halt(self) -> HandCommand:
        """Arm and fingers hold: what is in the hand stays there."""
        return HandCommand()

    def weighs(self, t_s: float) -> bool:
        """Whether the load is to be read at a time: pictures that nobody asks for are not read.

        Parameters
        ----------
        t_s
            Time of the observation [s].
        """
        return False


def as_vector(values: Float[np.ndarray, "3"]) -> tuple[float, float, float]:
    """Three numbers as a tuple, as traces keep them.

    Parameters
    ----------
    values
        Of any unit.
    """
    return float(values[0]), float(values[1]), float(values[2])


def run_hand(hand: Hand, task: HandTask[Any]) -> None:
    """Step a task with every frame until it ends; arm and gripper then hold.

    Parameters
    ----------
    hand
        Arm, gripper, camera and sensors.
    task
        A task of the hand; its ending is set.

    Raises
    ------
    InputError
        A part of the hand lacks a member of its protocol.
    """
    require_members(hand.arm, ProbeArm, task.task, "arm")
    require_members(hand.gripper, Gripper, task.task, "gripper")
    require_members(hand.source, FrameSource, task.task, "frame source", members=("__iter__",))
    run_machine(
        task,
        (_observation(hand, frame, task.weighs(frame.t_s)) for frame in hand.source),
        lambda command: _carry_out(hand, command),
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


def _carry_out(hand: Hand, command: HandCommand) -> None:
    if command.move:
        pose = Pose.from_rotation_vector([0.0, 0.0, command.angle_rad], np.array(command.tip_m))
        hand.arm.move_linear(pose, command.speed_m_s)
    else:
        hand.arm.stop()
    if math.isnan(command.opening_m):
        hand.gripper.stop()
    else:
        hand.gripper.move(command.opening_m, command.finger_m_s)
