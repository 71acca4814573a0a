"""A two-finger gripper with a joint trajectory controller."""

from __future__ import annotations

import math
import time
from typing import Any

from ...core import POSITIVE, Closing, DeviceError, Gripper, GripperState, InputError, check_numbers, within
from ...core.errors import StaleFrameError
from ...io.ros.ros_messages import header, stamp
from ..latest import LatestMessage
from ..transports.topic_node import Received, TopicNode


class RosGripper(Closing, Gripper):
    """Implements :class:`visuohaptic.core.robots.Gripper`.

    A command is a ``trajectory_msgs/JointTrajectory`` with one point, whose time is the distance divided by the speed.

    Parameters
    ----------
    node
        Node that publishes and subscribes.
    joint
        Name of the finger's joint in ``joint_states``.
    command, states
        Topics: ``trajectory_msgs/JointTrajectory`` out, ``sensor_msgs/JointState`` in.
    opening_per_joint, opening_at_zero_m
        The opening is ``opening_at_zero_m + opening_per_joint * position``: 2 if a joint moves both
        fingers, negative if a larger position closes the gripper.
    max_opening_m
        Openings outside 0 to this value are rejected.
    max_age_s
        Maximum age of joint states [s]; older ones are ignored.
    """

    def __init__(
        self,
        node: TopicNode,
        joint: str,
        *,
        command: str = "gripper_controller/joint_trajectory",
        states: str = "joint_states",
        opening_per_joint: float = 1.0,
        opening_at_zero_m: float = 0.0,
        max_opening_m: float = 0.1,
        max_age_s: float = 0.5,
    ) -> None:
        if not (math.isfinite(opening_per_joint) and opening_per_joint):
            raise InputError(
                "RosGripper", f"found {opening_per_joint}, expected not 0", field="opening_per_joint"
            )
        self.joint = joint
        self._slope, self._zero_m, self._largest_m = opening_per_joint, opening_at_zero_m, max_opening_m
        self._publisher = node.advertise(command, "trajectory_msgs/msg/JointTrajectory")
        self._states = LatestMessage(node, states, "sensor_msgs/msg/JointState", max_age_s)
        #: Openings [m] at the start and at the end of the last command, when it was sent, and its duration [s].
        self._command = (math.nan, math.nan, 0.0, 0.0)

    def move(self, opening_m: float, speed_m_s: float) -> None:
        """Start to move to an opening width.

        Raises
        ------
        InputError
            The opening is out of range, or the speed not positive.
        StaleFrameError
            The current opening, from which the time is computed, is unknown.
        DeviceError
            There is no subscriber.
        """
        check_numbers("RosGripper.move", within(0.0, self._largest_m), opening_m=opening_m)
        check_numbers("RosGripper.move", POSITIVE, speed_m_s=speed_m_s)
        start_m = self.state().opening_m
        self._send(opening_m, start_m, abs(opening_m - start_m) / speed_m_s)

    def stop(self) -> None:
        """Stop and hold the current opening; where it is unknown, the one to which the last command has led by now.

        Raises
        ------
        StaleFrameError
            The opening is unknown, and there was no command.
        DeviceError
            There is no subscriber; or joint states lack the joint, and there was no command.
        """
        try:
            opening_m = self.state().opening_m
        except DeviceError:
            begin_m, end_m, sent_s, lasts_s = self._command
            if math.isnan(end_m):
                raise
            part = min(1.0, (time.monotonic() - sent_s) / lasts_s)
            opening_m = begin_m + part * (end_m - begin_m)
        self._send(opening_m, opening_m, 0.0)

    def _send(self, opening_m: float, start_m: float, after_s: float) -> None:
        self._publisher.wait_until_heard()
        # Controllers reject points in the past; 50 ms is soon enough.
        after_s = max(after_s, 0.05)
        point: dict[str, Any] = {
            "positions": [(opening_m - self._zero_m) / self._slope],
            "velocities": [],
            "accelerations": [],
            "effort": [],
            "time_from_start": stamp(after_s),
        }
        head = header(0.0, "")  # a timestamp of zero: start immediately, regardless of clocks
        self._publisher.publish({"header": head, "joint_names": [self.joint], "points": [point]})
        self._command = (start_m, opening_m, time.monotonic(), after_s)

    def state(self) -> GripperState:
        """Latest reading.

        Raises
        ------
        StaleFrameError
            There is none, it is too old, or its position is not finite.
        DeviceError
            It does not contain the joint.
        """
        received = self._states.get()
        position, speed = self._joint(received)
        return GripperState(received.t_s, self._zero_m + self._slope * position, self._slope * speed)

    def _joint(self, received: Received) -> tuple[float, float]:
        message = received.message
        if self.joint not in message.name:
            raise DeviceError(
                f"{self._states.topic} has no joint {self.joint!r}, only {', '.join(message.name) or 'none'}"
            )
        place = message.name.index(self.joint)
        if place >= len(message.position):
            raise DeviceError(f"{self._states.topic} has no position of the joint {self.joint!r}")
        if not math.isfinite(message.position[place]):
            raise StaleFrameError(f"{self._states.topic} has the position NaN of the joint {self.joint!r}")
        speed = float(message.velocity[place]) if place < len(message.velocity) else math.nan
        return float(message.position[place]), speed

    def close(self) -> None:
        """Release the gripper; it remains in its position."""
        self._states.close()
