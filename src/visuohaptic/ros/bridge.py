"""The sensors as a ROS 2 node: image topics in, forces with validity and reason out."""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from ..core.camera.frame import Frame
from ..core.errors import DeviceError, InputError, StaleFrameError
from ..core.resources import Closing
from ..core.robots import BaseState
from ..sensing.readers.load import load_reader
from ..sensing.readers.sensor_reader import SensorReader
from .bridge_config import BridgeConfig, SensorSection, sensor_kind
from .frames import TopicFrames
from .latest import LatestMessage
from .node import RosNode
from .robots.mobile_base import base_state
from .sink import RosSink

__all__ = ["Bridge", "SensorReport"]

_log = logging.getLogger(__name__)


@dataclass(slots=True)
class SensorReport:
    """What became of the images of one sensor."""

    name: str
    frames: int = 0
    reasons: Counter[str] = field(default_factory=Counter)
    stale: int = 0  #: how often it was published that no image comes
    left_out: int = 0  #: images that came faster than they were read
    damaged: int = 0  #: images that could not be decoded
    lost: int = 0  #: images that were sent but never came, and those left out


def _odometry(latest: LatestMessage) -> Callable[[float], BaseState | None]:
    """Newest odometry, where there is some now: without it a sensor goes by its images alone."""

    def state(t_s: float) -> BaseState | None:
        try:
            return base_state(latest.get(0.0))
        except StaleFrameError:
            return None

    return state


class _Channel:
    """One sensor with its topics and its thread."""

    def __init__(self, bridge: Bridge, section: SensorSection, reader: SensorReader[Any]) -> None:
        self.report = SensorReport(section.name)
        self._bridge, self._section, self.reader = bridge, section, reader
        self.sink = RosSink(bridge.node, frame=section.frame or section.name)
        for topic, datatype in reader.topics.items():
            self.sink.advertise(topic, datatype)
        self.frames = TopicFrames(
            bridge.node, section.image, camera=reader.camera, depth=section.queue, grey=True
        )
        self._last_index = -1
        self._thread = threading.Thread(target=self._run, name=f"sensor {section.name}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def _run(self) -> None:
        try:
            if self._section.zero_frames:
                _log.info("%s: zeroing on %d frames", self._section.name, self._section.zero_frames)
                self.reader.zero(self._first_frames())
            while not self._bridge.stopping:
                self._step()
        except Exception as error:  # noqa: BLE001 - raised by wait() in the caller's thread
            self._bridge.fail(self, error)

    def _first_frames(self) -> Iterator[Frame]:
        for _ in range(self._section.zero_frames):
            while not self._bridge.stopping:
                try:
                    yield self.frames.read(self._bridge.config.stale_s)
                    break
                except DeviceError:
                    continue

    def _step(self) -> None:
        try:
            frame = self.frames.read(self._bridge.config.stale_s)
        except DeviceError:
            if not self._bridge.stopping:
                self.report.stale += 1
                self.reader.blank(time.time(), self.sink)
            return
        reason = self.reader.read(frame, self.sink).reason
        self.report.frames += 1
        self.report.reasons[reason.value] += 1
        if self._last_index >= 0:
            self.report.lost += max(0, frame.index - self._last_index - 1)
        self._last_index = frame.index

    def close(self) -> SensorReport:
        self.frames.close()
        if self._thread.is_alive():
            self._thread.join()
        self.reader.close()
        self.report.left_out, self.report.damaged = self.frames.left_out, self.frames.damaged
        return self.report


class Bridge(Closing):
    """Runs the sensors of ``bridge.yaml``; a context manager.

    Everything is read and checked before the node joins. Each sensor has a thread of its own. Where no image
    comes for ``stale_s``, that is published: a silent sensor would be taken for one that feels nothing.

    Parameters
    ----------
    config
        Fields of ``bridge.yaml``.
    folder
        To which its file names are relative.

    Examples
    --------
    >>> with Bridge.load("bridge.yaml") as bridge:                                   # doctest: +SKIP
    ...     bridge.wait(60.0)
    """

    def __init__(self, config: BridgeConfig, folder: Path) -> None:
        self.config = config
        self._stop = threading.Event()
        self._problem: tuple[_Channel, BaseException] | None = None
        self._channels: list[_Channel] = []
        self.reports: tuple[SensorReport, ...] = ()
        files = [(section, folder / section.config) for section in config.sensors]
        kinds = [sensor_kind(path) for _, path in files]
        readers: list[SensorReader[Any]] = []
        node: RosNode | None = None
        try:
            for (section, path), kind in zip(files, kinds, strict=True):
                reader = load_reader(path, section.name)
                readers.append(reader)
                _check(section, reader, path, kind)
            self.node = node = RosNode(config.node.name, config.node.options(folder))
            for (section, _), reader in zip(files, readers, strict=True):
                if section.odometry is not None:
                    latest = LatestMessage(node, section.odometry, "nav_msgs/msg/Odometry", config.stale_s)
                    reader.odometry = _odometry(latest)
                self._channels.append(_Channel(self, section, reader))
        except BaseException:
            for reader in readers:
                reader.close()
            if node is not None:
                node.close()
            raise
        for channel in self._channels:
            channel.start()

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read the file and begin.

        Parameters
        ----------
        path
            ``bridge.yaml``.

        Raises
        ------
        InputError
            A field, or a file that it names, cannot be used.
        DeviceError
            No router answers.
        """
        return cls(BridgeConfig.load(path), Path(path).parent)

    @property
    def stopping(self) -> bool:
        """Whether :meth:`stop` was called, or a sensor has failed."""
        return self._stop.is_set()

    def fail(self, channel: _Channel, error: BaseException) -> None:
        """A sensor cannot go on: all end, and :meth:`wait` raises its error.

        Parameters
        ----------
        channel
            Whose sensor it is.
        error
            What was raised in its thread.
        """
        if self._problem is None:
            self._problem = (channel, error)
        self._stop.set()

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until it is stopped, or for some time; returns whether it was stopped.

        Parameters
        ----------
        timeout_s
            At most so long [s]; until it is stopped by default.

        Raises
        ------
        InputError, DeviceError
            What a sensor has failed with.
        """
        stopped = self._stop.wait(timeout_s)
        if self._problem is not None:
            raise self._problem[1]
        return stopped

    def stop(self) -> None:
        """End; safe in a signal handler and in any thread."""
        self._stop.set()

    @property
    def frames(self) -> int:
        """Images that were read so far, by all sensors."""
        return sum(channel.report.frames for channel in self._channels)

    def close(self) -> None:
        """Stop all sensors, take back all topics; harmless when repeated. ``reports`` says what was done."""
        self._stop.set()
        if not self.reports:
            self.reports = tuple(channel.close() for channel in self._channels)
        self.node.close()


def _check(section: SensorSection, reader: SensorReader[Any], path: Path, kind: str) -> None:
    if section.odometry is not None and kind == "beam":
        raise InputError(path, "a beam sensor has no use for odometry", field=f"{section.name}.odometry")
    if not section.zero_frames:
        reader.require_zero("set zero_frames")


def summary(reports: tuple[SensorReport, ...]) -> list[dict[str, Any]]:
    """Reports as plain data."""
    return [
        {
            "name": report.name,
            "frames": report.frames,
            "reasons": dict(report.reasons),
            "stale": report.stale,
            "lost": report.lost,
            "left_out": report.left_out,
            "damaged": report.damaged,
        }
        for report in reports
    ]
