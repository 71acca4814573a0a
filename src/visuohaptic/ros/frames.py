"""An image topic as a source of frames."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque
from typing import Any

import numpy as np
from jaxtyping import UInt8

from ..core import Camera, Frame, ImageMode, Pose, decode_image
from ..core.errors import DeviceError, InputError, StaleFrameError
from ..io.ros.ros_image import camera_from_message, decode_raw
from ..io.source import LiveFrames
from .transports.topic_node import Received, TopicNode
from .wire.graph import Qos

_log = logging.getLogger(__name__)

#: Quality of service of typical camera drivers.
SENSOR_QOS = Qos(reliable=False, depth=5)


class TopicFrames(LiveFrames):
    """Frames of a ``sensor_msgs/Image`` or ``CompressedImage``; implements :class:`visuohaptic.core.robots.FrameSource`.

    The time of a frame is the timestamp in its header, or the sending time if that is zero. Its index is the
    sender's message number, so that a gap means that messages were lost or skipped.

    Parameters
    ----------
    node
        Node that subscribes.
    topic
        Image topic; a name that ends in ``/compressed`` refers to compressed images.
    camera
        Camera model; images of another size are rejected. By default, from the ``CameraInfo`` topic of the images.
    depth
        Queue size for a slow reader; if full, the oldest frame is dropped. 1: always the latest.
    grey
        Decode compressed images directly to grey.
    """

    def __init__(
        self,
        node: TopicNode,
        topic: str,
        *,
        camera: Camera | None = None,
        depth: int = 2,
        grey: bool = False,
    ) -> None:
        if depth < 1:
            raise InputError("TopicFrames", f"found {depth}, expected 1 or more", field="depth")
        self.topic = node.resolve(topic)
        self.left_out = 0  #: frames dropped because they arrived faster than they were read
        self.damaged = 0  #: images that could not be decoded, or whose size differed from the previous ones
        self._camera, self._grey = camera, grey
        self._new = threading.Condition()
        self._waiting: deque[tuple[Received, int]] = deque(maxlen=depth)
        self._newest: tuple[Received, int] | None = None
        self._came_s = 0.0
        self._gid, self._offset, self._last = b"", 0, -1
        self._fitted = self._interrupted = False
        compressed = self.topic.endswith("/compressed")
        datatype = "sensor_msgs/msg/" + ("CompressedImage" if compressed else "Image")
        self._subscriptions = [node.subscribe(self.topic, datatype, self._take, SENSOR_QOS)]
        if camera is None:
            self._subscriptions.append(
                node.subscribe(
                    info_topic(self.topic), "sensor_msgs/msg/CameraInfo", self._describe, SENSOR_QOS
                )
            )

    @property
    def camera(self) -> Camera | None:
        """Camera model, as soon as it is known."""
        return self._camera

    def _describe(self, received: Received) -> None:
        self._camera = camera_from_message(received.message, info_topic(self.topic), self.topic)

    def _take(self, received: Received) -> None:
        with self._new:
            entry = (received, self._index(received))
            self.left_out += len(self._waiting) == self._waiting.maxlen
            self._waiting.append(entry)
            self._newest, self._came_s = entry, time.monotonic()
            self._new.notify_all()

    def _index(self, received: Received) -> int:
        """The sender's message number; a new sender continues after the last one."""
        beside = received.attachment
        if beside is None:
            self._last += 1
            return self._last
        if beside.gid != self._gid or beside.sequence + self._offset <= self._last:
            # The first message of a sender causes no gap: earlier ones were not sent to this node.
            self._gid, self._offset = beside.gid, self._last + 1 - beside.sequence
        self._last = beside.sequence + self._offset
        return self._last

    def read(self, timeout_s: float = 2.0) -> Frame:
        """Wait for the next frame.

        Parameters
        ----------
        timeout_s
            Time-out [s].

        Raises
        ------
        DeviceError
            No image arrived in time, or the source is closed.
        """
        until = time.monotonic() + timeout_s
        while True:
            with self._new:
                self._new.wait_for(
                    lambda: bool(self._waiting) or not self._running or self._interrupted,
                    until - time.monotonic(),
                )
                if not self._running or self._interrupted:
                    raise DeviceError(f"{self.topic} is closed")
                if not self._waiting:
                    raise DeviceError(
                        f"no image on {self.topic} for {timeout_s:g} s; "
                        "check the camera's node, and that domain and ROS release are the same"
                    )
                entry = self._waiting.popleft()
            if (frame := self._frame(*entry)) is not None:
                return frame

    def interrupt(self) -> None:
        """Interrupt waiting for images, until :meth:`discard`."""
        with self._new:
            self._interrupted = True
            self._new.notify_all()

    def discard(self) -> None:
        """Discard queued images, which were received while not measuring."""
        with self._new:
            self._interrupted = False
            self._waiting.clear()

    def read_latest(self, max_age_ms: float = 100.0) -> Frame:
        """The latest frame, without waiting.

        Parameters
        ----------
        max_age_ms
            Maximum age according to the timestamp and this machine's clock, and since it arrived [ms]: the clock of
            the camera's machine may be ahead.

        Raises
        ------
        StaleFrameError
            There is no frame yet, or it is older than ``max_age_ms``.
        """
        with self._new:
            entry, came_s = self._newest, self._came_s
        frame = self._frame(*entry) if entry is not None else None
        if frame is None:
            raise StaleFrameError(f"{self.topic} has delivered no image yet; wait with read()")
        self.check_age(max(time.time() - frame.t_s, time.monotonic() - came_s), max_age_ms)
        return frame

    def _frame(self, received: Received, index: int) -> Frame | None:
        """The image with its time; ``None`` if it cannot be decoded."""
        image = None
        try:
            image = self._image(received)
            if self._camera is not None:
                self._camera.check_size(self.topic, image.shape[1], image.shape[0])
        except InputError as error:
            # A wrong size in the first image means a wrong camera; later, it is from another sender, or damaged.
            if image is not None and not self._fitted:
                raise
            self.damaged += 1
            if self.damaged & (self.damaged - 1) == 0:
                _log.warning("%s: %d images cannot be used; %s", self.topic, self.damaged, error)
            return None
        self._fitted = True
        return Frame(image, received.t_s, index)

    def _image(self, received: Received) -> UInt8[np.ndarray, "rows columns *colour"]:
        if self.topic.endswith("/compressed"):
            mode: ImageMode = "grey" if self._grey else "any"
            return decode_image(received.message.data, self.topic, mode, check_pixels=False)
        return decode_raw(received.message, self.topic)

    def close(self) -> None:
        """Unsubscribe; may be called repeatedly."""
        with self._new:
            if not self._running:
                return
            self._running = False
            self._new.notify_all()
        for subscription in self._subscriptions:
            subscription.close()


def info_topic(image: str) -> str:
    """Topic of the camera model, by ROS convention in the namespace of the image.

    Parameters
    ----------
    image
        Image topic.
    """
    return image.removesuffix("/compressed").rpartition("/")[0] + "/camera_info"


def message_pose(message: Any) -> Pose:
    """Convert a ``geometry_msgs/Pose``.

    Parameters
    ----------
    message
        With ``position`` and ``orientation``.
    """
    place, turn = message.position, message.orientation
    return Pose.from_quaternion([turn.x, turn.y, turn.z, turn.w], [place.x, place.y, place.z])


def planar(message: Any) -> tuple[float, float, float]:
    """x, y [m] and heading [rad] of a ``geometry_msgs/Pose``, regardless of roll and pitch.

    Parameters
    ----------
    message
        With ``position`` and ``orientation``.
    """
    turn = message.orientation
    heading = math.atan2(2.0 * (turn.w * turn.z + turn.x * turn.y), 1.0 - 2.0 * (turn.y**2 + turn.z**2))
    return message.position.x, message.position.y, heading
