"""The sensors as a ROS 2 node: subscribes to image topics, publishes forces with validity and reason."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

from ..core import Closing, InputError
from ..sensing import SensorReader, load_reader
from .bridge_config import BridgeConfig, SensorSection, sensor_kind
from .channel import SensorChannel, SensorReport
from .transports.open_node import open_node


class Bridge(Closing):
    """Runs the sensors of ``bridge.yaml``; a context manager.

    All files are read and checked before the node joins. Each sensor has its own thread. If no image
    arrives for ``stale_s``, this is published: a silent sensor could be mistaken for one without contact.

    Parameters
    ----------
    config
        Fields of ``bridge.yaml``.
    folder
        Folder that its file names are relative to.

    Examples
    --------
    >>> with Bridge.load("bridge.yaml") as bridge:                                   # doctest: +SKIP
    ...     bridge.wait(60.0)
    """

    def __init__(self, config: BridgeConfig, folder: Path) -> None:
        self.config = config
        self._stop = threading.Event()
        self._problem: BaseException | None = None
        self._channels: list[SensorChannel] = []
        self.reports: tuple[SensorReport, ...] = ()
        with ExitStack() as opened:
            readers = [
                opened.enter_context(open_reader(each, folder / each.config)) for each in config.sensors
            ]
            node = open_node(config.node.name, config.node.options(folder), config.node.transport)
            self.node = opened.enter_context(node)
            for section, reader in zip(config.sensors, readers, strict=True):
                channel = SensorChannel(node, section, reader, config.stale_s, self._stop, self._fail)
                self._channels.append(channel)
            opened.pop_all()
        for channel in self._channels:
            channel.start()

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Load the file and start the bridge.

        Parameters
        ----------
        path
            ``bridge.yaml``.

        Raises
        ------
        InputError
            A field, or a file that it names, is invalid.
        DeviceError
            No router responds.
        """
        return cls(BridgeConfig.load(path), Path(path).parent)

    def _fail(self, error: BaseException) -> None:
        """Handle the failure of a sensor: all sensors are stopped, and :meth:`wait` raises its error."""
        self._problem = self._problem or error
        self._stop.set()

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until the bridge is stopped, or for a limited time; returns whether it was stopped.

        Parameters
        ----------
        timeout_s
            Maximum waiting time [s]; by default until stopped.

        Raises
        ------
        InputError, DeviceError
            Error of a failed sensor.
        """
        stopped = self._stop.wait(timeout_s)
        if self._problem is not None:
            raise self._problem
        return stopped

    def stop(self) -> None:
        """Stop; may be called from a signal handler and from any thread."""
        self._stop.set()

    @property
    def frames(self) -> int:
        """Number of images processed so far, by all sensors."""
        return sum(channel.report.frames for channel in self._channels)

    def close(self) -> None:
        """Stop all sensors and remove all topics; may be called repeatedly. ``reports`` contains the statistics."""
        self._stop.set()
        if not self.reports:
            self.reports = tuple(channel.close() for channel in self._channels)
        self.node.close()


def open_reader(section: SensorSection, path: Path, kind: str | None = None) -> SensorReader[Any]:
    """Open a sensor and check that it can measure as configured in the section.

    Parameters
    ----------
    section
        Names of the sensor's topics.
    path
        Configuration file of the sensor.
    kind
        ``foam``, ``beam`` or ``scene``; any if omitted.

    Raises
    ------
    InputError
        It has another kind, is a beam with odometry, or has neither a zero reference nor frames to take one from.
    """
    found = sensor_kind(path)
    if kind is not None and found != kind:
        raise InputError(path, f"found the sensor {found}, expected {kind}", field="kind")
    if section.odometry and found == "beam":
        raise InputError(path, "a beam sensor does not use odometry", field=f"{section.name}.odometry")
    with ExitStack() as opened:
        reader = opened.enter_context(load_reader(path, section.name))
        if not section.zero_frames:
            reader.require_zero("set zero_frames")
        opened.pop_all()
    return reader
