"""The sensors as a ROS 2 node: image topics in, forces with validity and reason out."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

from ..core.errors import InputError
from ..core.files.plain_json import picked
from ..core.resources import Closing
from ..sensing.readers.load import load_reader
from ..sensing.readers.sensor_reader import SensorReader
from .bridge_config import BridgeConfig, SensorSection, sensor_kind
from .channel import SensorChannel, SensorReport
from .transports.open_node import open_node

__all__ = ["Bridge"]


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

    def _fail(self, error: BaseException) -> None:
        """A sensor cannot go on: all end, and :meth:`wait` raises its error."""
        self._problem = self._problem or error
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
            raise self._problem
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


def open_reader(section: SensorSection, path: Path, kind: str | None = None) -> SensorReader[Any]:
    """A sensor, where it can measure as the section says.

    Parameters
    ----------
    section
        Names of its topics.
    path
        Its file.
    kind
        ``foam``, ``beam`` or ``scene``; any by default.

    Raises
    ------
    InputError
        It is of another kind, has odometry but is a beam, or neither a zero reference nor frames to take one from.
    """
    found = sensor_kind(path)
    if kind is not None and found != kind:
        raise InputError(path, f"found the sensor {found}, expected {kind}", field="kind")
    if section.odometry and found == "beam":
        raise InputError(path, "a beam sensor has no use for odometry", field=f"{section.name}.odometry")
    with ExitStack() as opened:
        reader = opened.enter_context(load_reader(path, section.name))
        if not section.zero_frames:
            reader.require_zero("set zero_frames")
        opened.pop_all()
    return reader


def summary(reports: tuple[SensorReport, ...]) -> list[dict[str, Any]]:
    """Reports as plain data."""
    names = "name frames reasons stale lost left_out damaged"
    return [picked(report, names) for report in reports]
