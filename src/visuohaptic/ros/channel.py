"""Connection of one sensor from its image topic to its measurement topics."""

from __future__ import annotations

import logging
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from ..core import BaseState, DeviceError, Frame, StaleFrameError
from ..core.resources import end_thread
from ..sensing.readers.sensor_reader import SensorReader
from .bridge_config import SensorSection
from .frames import TopicFrames
from .latest import LatestMessage
from .robots.mobile_base import base_state
from .sink import RosSink
from .transports.topic_node import TopicNode

_log = logging.getLogger(__name__)


@dataclass(slots=True)
class SensorReport:
    """Image statistics of one sensor."""

    name: str
    frames: int = 0
    reasons: Counter[str] = field(default_factory=Counter)
    stale: int = 0  #: number of published notices that no image arrives
    left_out: int = 0  #: images skipped because they arrived faster than they were processed
    damaged: int = 0  #: images that could not be decoded
    lost: int = 0  #: images that were sent but not received, plus skipped images


def _odometry(latest: LatestMessage) -> Callable[[float], BaseState | None]:
    """Latest odometry, if current: otherwise a sensor uses its images alone."""

    def state(t_s: float) -> BaseState | None:
        try:
            return base_state(latest.get(0.0))
        except StaleFrameError:
            return None

    return state


class SensorChannel:
    """One sensor with its topics and its thread.

    Parameters
    ----------
    node
        Node that subscribes and publishes.
    section
        Names of the sensor's topics.
    reader
        The sensor; closed with the channel, or after the image that is processed then.
    stale_s
        Time without image after which ``stale`` is published [s].
    stop
        Event that stops the channel.
    fail
        Called in the channel's thread with the error that terminated it.
    """

    def __init__(
        self,
        node: TopicNode,
        section: SensorSection,
        reader: SensorReader[Any],
        stale_s: float,
        stop: threading.Event,
        fail: Callable[[BaseException], None],
    ) -> None:
        self.report = SensorReport(section.name)
        self.reader = reader
        self._node, self._section, self._stale_s, self._stop, self._fail = node, section, stale_s, stop, fail
        self._latest: LatestMessage | None = None
        if section.odometry:
            self._latest = LatestMessage(node, section.odometry, "nav_msgs/msg/Odometry", stale_s)
            reader.odometry = _odometry(self._latest)
        self.sink = RosSink(node, frame=section.frame or section.name)
        for topic, datatype in reader.topics.items():
            self.sink.advertise(topic, datatype)
        self.frames = TopicFrames(node, section.image, camera=reader.camera, depth=section.queue, grey=True)
        self.silent = True  #: whether no image has arrived for ``stale_s``
        self._last_index = -1
        self._thread: threading.Thread | None = None
        self._lock, self._users = threading.Lock(), {"owner"}  # of the reader

    def start(self) -> None:
        """Start to measure with the next image; may be called again after a successful :meth:`join`."""
        self.frames.discard()
        with self._lock:
            self._users.add("thread")
        self._thread = threading.Thread(target=self._run, name=f"sensor {self.report.name}", daemon=True)
        self._thread.start()

    def join(self) -> bool:
        """Wait until the current image is processed, after ``stop`` was set; returns whether it was, in time."""
        if self._thread is not None:
            self.frames.interrupt()
            if not end_thread(self._thread):
                return False
            self._thread = None
        return True

    def _run(self) -> None:
        try:
            if self._section.zero_frames:
                _log.info("%s: zeroing on %d frames", self._section.name, self._section.zero_frames)
                self.reader.zero(self._first_frames())
            while not self._stop.is_set():
                self._step()
        except Exception as error:  # noqa: BLE001 - raised in the caller's thread
            self._fail(error)
        finally:
            self._release("thread")

    def _release(self, user: str) -> None:
        """The last user of the reader closes it: an image may take longer than its owner waits."""
        with self._lock:
            last = self._users == {user}
            self._users.discard(user)
        if last:
            self.reader.close()

    def _first_frames(self) -> Iterator[Frame]:
        for _ in range(self._section.zero_frames):
            while not self._stop.is_set():
                try:
                    yield self.frames.read(self._stale_s)
                    break
                except DeviceError:
                    continue

    def _step(self) -> None:
        try:
            frame = self.frames.read(self._stale_s)
        except DeviceError:
            if not self._stop.is_set():
                self.silent = True
                self.report.stale += 1
                self.reader.blank(self._node.now_s(), self.sink)
            return
        self.silent = False
        reason = self.reader.read(frame, self.sink).reason
        self.report.frames += 1
        self.report.reasons[reason.value] += 1
        if self._last_index >= 0:
            self.report.lost += max(0, frame.index - self._last_index - 1)
        self._last_index = frame.index

    def close(self) -> SensorReport:
        """Close the channel, after ``stop`` was set; returns its image statistics."""
        self.frames.close()
        self.join()
        if self._latest is not None:
            self._latest.close()
        self._release("owner")
        self.report.left_out, self.report.damaged = self.frames.left_out, self.frames.damaged
        return self.report
