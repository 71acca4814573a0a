"""Coordinate frames of a recording: its ``tf`` messages as a tree, with the pose of one frame in another at any time."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...core.camera.pose import Pose
from .poses import StampedPose, interpolate_pose, stamped_message

#: Poses are interpolated over gaps of this many usual intervals: at least one message of a longer gap is lost.
_USUAL_INTERVALS = 2.0
#: A chain of more frames is a cycle: robots have tens.
_MAX_DEPTH = 200


@dataclass(slots=True)
class FrameMotion:
    """Poses of one frame in another, in temporal order."""

    poses: list[StampedPose] = field(default_factory=list)
    static: bool = False  #: the last one is valid at all times
    _times_s: list[float] = field(default_factory=list)
    _gap_s: float = 0.1

    def finish(self) -> FrameMotion:
        """Sort the poses; the motion itself, which can be asked afterwards."""
        self.poses = sorted((one for one in self.poses if one.pose is not None), key=lambda one: one.t_s)
        self._times_s = [one.t_s for one in self.poses]
        if len(self.poses) > 1:
            self._gap_s = max(0.1, _USUAL_INTERVALS * float(np.median(np.diff(self._times_s))))
        return self

    def at(self, t_s: float) -> tuple[Pose | None, str]:
        """Pose at a time, or why there is none.

        Parameters
        ----------
        t_s
            The time [s].
        """
        if self.static and self.poses:
            return self.poses[-1].pose, ""
        after = bisect_left(self._times_s, t_s)
        return interpolate_pose(self.poses[max(after - 1, 0) : after + 1], t_s, max_gap_s=self._gap_s)


class TransformTree:
    """Frames of ``tf2_msgs/TFMessage`` messages and their parents.

    A frame that has several parents in a recording keeps the last one.
    """

    def __init__(self) -> None:
        self._motions: dict[str, tuple[str, FrameMotion]] = {}

    @classmethod
    def joined(cls, trees: Iterable[TransformTree]) -> TransformTree:
        """One tree of the frames of several.

        Parameters
        ----------
        trees
            Without common frames.
        """
        whole = cls()
        for tree in trees:
            whole._motions |= tree._motions
        return whole

    @property
    def frames(self) -> Iterable[str]:
        """Names of the frames that have a parent."""
        return self._motions.keys()

    def add(self, message: Any, *, static: bool, log_time_ns: int) -> None:
        """Add the transforms of a message.

        Parameters
        ----------
        message
            Decoded message.
        static
            Whether its topic is ``tf_static``.
        log_time_ns
            Recording time, for transforms without a stamp [ns].
        """
        for one in message.transforms:
            child, parent = frame_name(one.child_frame_id), frame_name(one.header.frame_id)
            if child not in self._motions or self._motions[child][0] != parent:
                self._motions[child] = (parent, FrameMotion())
            motion = self._motions[child][1]
            motion.static = static
            motion.poses.append(stamped_message(one, "geometry_msgs/msg/TransformStamped", log_time_ns))

    def finish(self) -> None:
        """Sort all transforms; to be called when all messages are added."""
        for _, motion in self._motions.values():
            motion.finish()

    def chain(self, frame: str, stop: str = "") -> list[str]:
        """A frame and those above it, up to the root or to ``stop``; empty if ``stop`` is not above it.

        Parameters
        ----------
        frame
            Name of the frame.
        stop
            Frame at which the chain ends; by default the root.
        """
        found = [frame]
        while found[-1] != stop and found[-1] in self._motions and len(found) < _MAX_DEPTH:
            found.append(self._motions[found[-1]][0])
        return found if not stop or found[-1] == stop else []

    def moves(self, chain: list[str]) -> bool:
        """Whether any transform of a chain changes.

        Parameters
        ----------
        chain
            As returned by :meth:`chain`.
        """
        return any(not self._motions[frame][1].static for frame in chain[:-1])

    def pose(self, chain: list[str], t_s: float) -> tuple[Pose | None, str]:
        """Pose of the first frame of a chain in the last one, or why there is none.

        Parameters
        ----------
        chain
            As returned by :meth:`chain`.
        t_s
            The time [s].
        """
        whole = Pose.identity()
        for frame in chain[:-1]:
            pose, problem = self._motions[frame][1].at(t_s)
            if pose is None:
                return None, f"{frame} in {self._motions[frame][0]}: {problem}"
            whole = pose @ whole
        return whole, ""


def frame_name(name: object) -> str:
    """Name of a frame without the leading slash of ROS 1.

    Parameters
    ----------
    name
        As in a message.
    """
    return str(name).lstrip("/")
