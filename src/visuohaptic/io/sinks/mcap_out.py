"""Measurements to MCAP, using only standard ROS 2 messages, so that any ROS tool can open the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...core.errors import InputError, needs
from ...core.files import PartFile
from ...core.resources import Closing
from ..ros import ros_messages as ros
from ..ros._ros_definitions import definition
from .measurement_sink import MeasurementSink


class MeasurementWriter(MeasurementSink, Closing):
    """Writes an MCAP file during the measurement.

    During recording, the file is named ``NAME.mcap.part``; it is renamed
    when it is closed. Every message is passed to the operating system before its
    ``write_...`` returns: after a crash, the ``.part`` file contains all of
    them; :class:`McapSource` and ``visuohaptic recording info`` read it, and
    ``visuohaptic recording recover`` completes it.

    Parameters
    ----------
    path
        File to write; an older one is replaced when this one is closed.
    frame
        Name of the sensor's coordinate frame.
    chunk_bytes
        Messages are collected up to this size before they are compressed and
        written. 0 writes each message immediately, uncompressed; 64 kB takes a fraction of the
        space but may lose the last chunk in a crash.

    Notes
    -----
    Topics and types, below the sensor's ``name``:

    ========================== =================================================
    ``/NAME/wrench``           ``geometry_msgs/WrenchStamped``, NaN when not valid
    ``/NAME/diagnostics``      ``diagnostic_msgs/DiagnosticArray``: validity, reason, sigmas
    ``/NAME/contact``          ``sensor_msgs/PointCloud2``: contact contour
    ``/NAME/profile``          ``sensor_msgs/PointCloud2``: whole strip
    ``/NAME/event``            ``std_msgs/String``, JSON: kind, t_s, s_m
    ========================== =================================================

    Examples
    --------
    >>> import numpy as np
    >>> from visuohaptic.core import Reason, Wrench
    >>> wrench = Wrench(0.1, True, Reason.OK, np.array([0.0, 2.0, 0.0]), np.zeros(3), 1e-4 * np.eye(6))
    >>> with MeasurementWriter("run.mcap") as writer:
    ...     writer.write_wrench(wrench)
    >>> Path("run.mcap").is_file()
    True
    """

    def __init__(self, path: Path | str, *, frame: str = "sensor", chunk_bytes: int = 0) -> None:
        with needs("mcap-ros2-support", "recording", "writing MCAP"):
            from mcap_ros2.writer import Writer
        if chunk_bytes < 0:
            raise InputError("chunk_bytes", f"found {chunk_bytes}, expected >= 0")
        self.path = Path(path)
        self.frame = frame
        self._file = PartFile(self.path)
        self.part = self._file.part  #: name until closed
        self._writer: Any = (
            Writer(self._file, chunk_size=chunk_bytes) if chunk_bytes else _unchunked(self._file)
        )
        self._schemas: dict[str, Any] = {}
        self._counts: dict[str, int] = {}

    def write(self, topic: str, datatype: str, t_s: float, message: dict[str, Any]) -> None:
        """Write the fields of any supported standard message."""
        if self._file.closed:
            raise InputError(self.path, "is closed")
        if datatype not in self._schemas:
            self._schemas[datatype] = self._writer.register_msgdef(datatype, definition(datatype))
        count = self._counts.get(topic, 0)
        self._writer.write_message(
            topic, self._schemas[datatype], message, log_time=ros.stamp_ns(t_s), sequence=count
        )
        self._counts[topic] = count + 1

    def close(self) -> None:
        """Write the index and rename the file; may be called repeatedly."""
        if not self._file.closed:
            self._writer.finish()
            self._file.finish()


def _unchunked(stream: PartFile) -> Any:
    """A writer that writes messages outside of chunks.

    Chunks of one message would also work, but the chunk index is kept in memory until the file is closed: half a
    kilobyte per message, a quarter of a gigabyte per hour.
    """
    from io import BytesIO

    from mcap.writer import Writer as Records
    from mcap_ros2.writer import Writer

    writer: Any = Writer(BytesIO())  # it has no option for this
    writer._writer = Records(stream, use_chunking=False)
    writer._writer.start(profile="ros2", library="visuohaptic")
    return writer
