"""An arm with a probe tip and a Cartesian controller."""

from __future__ import annotations

import threading
import time

import numpy as np
from jaxtyping import Float

from ...core import POSITIVE, Closing, InputError, Pose, ProbeArm, check_numbers
from ...core.errors import StaleFrameError
from ...io.ros import ros_messages as ros
from ...tasks.robots.repeater import Repeater
from ..frames import message_pose
from ..latest import LatestMessage
from ..transports.topic_node import TopicNode


class RosArm(Closing, ProbeArm):
    """Implements :class:`visuohaptic.core.robots.ProbeArm`.

    The straight line is generated here: ``geometry_msgs/PoseStamped`` targets along it, at a fixed rate. Any controller
    that follows such a topic is suitable.

    Parameters
    ----------
    node
        Node that publishes and subscribes.
    reach_m
        Minimum and maximum distance of the tip from the base [m]; targets outside are rejected.
    command, pose
        Topics: targets out, the tip's pose in; both in the base frame.
    frame
        Base frame, in which targets are given.
    rate_Hz
        Targets per second.
    max_age_s
        Maximum age of poses [s]; older ones are ignored.
    """

    def __init__(
        self,
        node: TopicNode,
        reach_m: tuple[float, float],
        *,
        command: str = "target_frame",
        pose: str = "current_pose",
        frame: str = "base_link",
        rate_Hz: float = 50.0,
        max_age_s: float = 0.5,
    ) -> None:
        if not 0.0 <= reach_m[0] < reach_m[1] < float("inf"):
            raise InputError("RosArm", f"found {reach_m}, expected 0 <= smallest < largest", field="reach_m")
        self._reach_m, self._frame = reach_m, frame
        self._lock = threading.Lock()
        self._line: _Line | None = None
        self._publisher = node.advertise(command, "geometry_msgs/msg/PoseStamped")
        self._pose = LatestMessage(node, pose, "geometry_msgs/msg/PoseStamped", max_age_s)
        self._repeater = Repeater(self._step, rate_Hz, f"targets to {self._publisher.topic}")

    def move_linear(self, T_base_tip: Pose, speed_m_s: float) -> None:
        """Start to move the tip along a straight line.

        Raises
        ------
        InputError
            The target is out of reach, or the speed not positive.
        StaleFrameError
            The current pose of the tip is unknown.
        DeviceError
            There is no subscriber.
        """
        check_numbers("RosArm.move_linear", POSITIVE, speed_m_s=speed_m_s)
        distance_m = float(np.linalg.norm(T_base_tip.translation_m))
        if not self._reach_m[0] <= distance_m <= self._reach_m[1]:
            raise InputError(
                "RosArm.move_linear",
                f"found a target {distance_m:.3f} m away, the tip reaches {self._reach_m[0]:g} to "
                f"{self._reach_m[1]:g} m",
                field="T_base_tip",
            )
        self._repeater.check()
        self._publisher.wait_until_heard()
        _, now = self.pose()
        with self._lock:
            self._line = _Line(now, T_base_tip, speed_m_s)

    def stop(self) -> None:
        """Stop and hold the current pose; where it is not known, no further target is sent: the arm holds the last one.

        Raises
        ------
        StaleFrameError
            The current pose of the tip is unknown.
        """
        with self._lock:
            self._line = None
        _, now = self.pose()
        with self._lock:
            self._publish(now)

    def _step(self) -> None:
        with self._lock:
            if self._line is None:
                return
            target, arrived = self._line.at(time.monotonic())
            self._publish(target)
            if arrived:
                self._line = None

    def _publish(self, target: Pose) -> None:
        self._publisher.publish({"header": ros.header(time.time(), self._frame), "pose": ros.pose(target)})

    def pose(self) -> tuple[float, Pose]:
        """Latest time [s] and pose of the tip in the base frame.

        Raises
        ------
        StaleFrameError
            There is none, it is too old, or its numbers are no pose.
        """
        received = self._pose.get()
        try:
            return received.t_s, message_pose(received.message.pose)
        except InputError as error:
            raise StaleFrameError(f"the pose on {self._pose.topic} is not valid: {error.problem}") from error

    def reach_m(self) -> Float[np.ndarray, "2"]:
        """Minimum and maximum distance of the tip from the base."""
        return np.array(self._reach_m)

    def close(self) -> None:
        """Stop sending targets and release the arm; may be called repeatedly."""
        with self._lock:
            self._line = None
        self._repeater.close()
        self._pose.close()


class _Line:
    """A straight path at constant speed, with uniform rotation along it."""

    #: A pure rotation takes as long as the path of a point at this distance from the axis.
    _LEVER_M = 0.1

    def __init__(self, start: Pose, end: Pose, speed_m_s: float) -> None:
        self._start, self._end = start, end
        length_m = float(np.linalg.norm(end.translation_m - start.translation_m))
        self._lasts_s = max(length_m, self._LEVER_M * start.angle_to(end)) / speed_m_s
        self._began_s = time.monotonic()

    def at(self, now_s: float) -> tuple[Pose, bool]:
        """Target at a given time, and whether it is the last one."""
        part = 1.0 if self._lasts_s <= 0 else (now_s - self._began_s) / self._lasts_s
        if part >= 1.0:
            return self._end, True
        return self._start.interpolated(self._end, part), False
