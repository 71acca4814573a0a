"""What a robot must offer, and nothing else.

The simulator and a real robot implement the same protocols, so that a task
never knows which of them it drives.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

import numpy as np
from jaxtyping import Float

from .camera import Camera, Frame, Pose

__all__ = ["BaseState", "FrameSource", "Gripper", "GripperState", "MobileBase", "ProbeArm"]


@runtime_checkable
class FrameSource(Protocol):
    """Images with times, from a file, a live camera or the simulator."""

    @property
    def camera(self) -> Camera | None:
        """The camera's model where the source knows it."""

    @property
    def frame_count(self) -> int | None:
        """How many frames there are; ``None`` for a live camera."""

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order of time, until the source ends."""

    def close(self) -> None:
        """Release the file or device; harmless when repeated."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


@dataclass(frozen=True, slots=True)
class BaseState:
    """Where a mobile base believes to be."""

    t_s: float
    x_m: float  #: in the odometry frame
    y_m: float
    heading_rad: float  #: counter-clockwise from x
    speed_m_s: float  #: forward
    turn_rate_rad_s: float


@runtime_checkable
class MobileBase(Protocol):
    """A platform that drives on the floor."""

    def drive(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """Set the velocities; they hold until the next call or :meth:`stop`."""

    def stop(self) -> None:
        """Stand still as soon as possible."""

    def state(self) -> BaseState:
        """Newest odometry."""


@dataclass(frozen=True, slots=True)
class GripperState:
    """Opening of a two-finger gripper."""

    t_s: float
    opening_m: float
    speed_m_s: float


@runtime_checkable
class Gripper(Protocol):
    """A two-finger gripper with a linear drive."""

    def move(self, opening_m: float, speed_m_s: float) -> None:
        """Begin to move to an opening."""

    def stop(self) -> None:
        """Hold the present opening."""

    def state(self) -> GripperState:
        """Newest reading."""


@runtime_checkable
class ProbeArm(Protocol):
    """An arm with a probe tip."""

    def move_linear(self, pose_base_tip: Pose, speed_m_s: float) -> None:
        """Begin to move the tip in a straight line."""

    def stop(self) -> None:
        """Hold the present pose."""

    def pose(self) -> tuple[float, Pose]:
        """Newest time [s] and pose of the tip in the base frame."""

    def reach_m(self) -> Float[np.ndarray, "2"]:
        """Smallest and largest distance of the tip from the base."""
