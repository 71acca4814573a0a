"""A platform that subscribes to ``cmd_vel`` and publishes its odometry."""

from __future__ import annotations

import math
import time

from ...core.errors import StaleFrameError
from ...core.robots import BaseState
from ...io.ros.ros_messages import header
from ...tasks.robots.repeater import RepeatedBase, Repeater
from ..frames import planar
from ..latest import LatestMessage
from ..transports.topic_node import Received, TopicNode


class RosBase(RepeatedBase):
    """Implements :class:`visuohaptic.core.robots.MobileBase`.

    Parameters
    ----------
    node
        Node that publishes and subscribes.
    command, odometry
        Topics: ``geometry_msgs/Twist`` out, ``nav_msgs/Odometry`` in.
    stamped_frame
        Send ``geometry_msgs/TwistStamped`` in this coordinate frame, such as ``base_link``; expected by Nav2 and ros2_control
        since Jazzy. ``Twist`` by default.
    max_speed_m_s, max_turn_rad_s
        Larger commands are rejected.
    rate_Hz
        Rate at which a command is repeated until the next one; :meth:`close` sends a stop.
    max_age_s
        Maximum age of odometry [s]; older messages are ignored.
    """

    def __init__(
        self,
        node: TopicNode,
        *,
        command: str = "cmd_vel",
        odometry: str = "odom",
        stamped_frame: str | None = None,
        max_speed_m_s: float = 0.5,
        max_turn_rad_s: float = 1.5,
        rate_Hz: float = 20.0,
        max_age_s: float = 0.5,
    ) -> None:
        datatype = "geometry_msgs/msg/" + ("Twist" if stamped_frame is None else "TwistStamped")
        super().__init__(max_speed_m_s, max_turn_rad_s)
        self._frame = stamped_frame
        self._publisher = node.advertise(command, datatype)
        self._odometry = LatestMessage(node, odometry, "nav_msgs/msg/Odometry", max_age_s)
        self._repeater = Repeater(self._send, rate_Hz, f"commands to {self._publisher.topic}")

    def _check(self) -> None:
        super()._check()
        self._publisher.wait_until_heard()

    def _send(self) -> None:
        with self._lock:
            command = self._command
            if command is None:  # no command yet: another node may be driving
                return
            self._publisher.publish(self._message(*command))

    def _message(self, speed_m_s: float, turn_rate_rad_s: float) -> dict[str, object]:
        twist: dict[str, object] = {
            "linear": {"x": speed_m_s, "y": 0.0, "z": 0.0},
            "angular": {"x": 0.0, "y": 0.0, "z": turn_rate_rad_s},
        }
        if self._frame is None:
            return twist
        return {"header": header(time.time(), self._frame), "twist": twist}

    def state(self) -> BaseState:
        """Latest odometry.

        Raises
        ------
        StaleFrameError
            There is none, it is too old, or its numbers are not finite.
        """
        return base_state(self._odometry.get())

    def close(self) -> None:
        """Stop and release the platform; may be called repeatedly."""
        super().close()
        self._odometry.close()


def base_state(received: Received) -> BaseState:
    """Convert a ``nav_msgs/Odometry``.

    Parameters
    ----------
    received
        Message with its time.

    Raises
    ------
    StaleFrameError
        It has numbers that are not finite: a driver sends NaN where it knows nothing.
    """
    message = received.message
    speed = message.twist.twist
    numbers = (*planar(message.pose.pose), speed.linear.x, speed.angular.z)
    if not all(map(math.isfinite, numbers)):
        raise StaleFrameError(f"the odometry has numbers that are not finite, {numbers}")
    return BaseState(received.t_s, *numbers)
