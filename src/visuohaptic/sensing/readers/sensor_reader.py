"""A sensor as a program runs it: a frame in, a reading out, written to a sink on its way.

The command line and the ROS 2 bridge run every sensor through these readers, so that a recording and a live
node say the same.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar, cast

from ...core import BaseState, Camera, Closing, Event, Frame, InputError, Reason
from ...io.sinks.measurement_sink import MeasurementSink

Measured = TypeVar("Measured")

#: Types of the topics of more than one sensor.
WRENCH, DIAGNOSTICS = "geometry_msgs/msg/WrenchStamped", "diagnostic_msgs/msg/DiagnosticArray"


@dataclass(frozen=True, slots=True, eq=False)
class SensorReading(Generic[Measured]):
    """What a sensor made of one frame."""

    measured: Measured
    reason: Reason  #: why it is invalid; ``ok`` when it is valid
    events: tuple[Event, ...] = ()


class SensorReader(Closing, Generic[Measured]):
    """One sensor behind one interface; closed when its ``with`` block ends.

    Parameters
    ----------
    name
        First part of its topics, as ``foam`` in ``/foam/wrench``.
    """

    kind: ClassVar[str]  #: ``foam``, ``beam`` or ``scene``, as in its file
    sensor: Any = None  #: what measures; its camera and zero reference are the reader's
    topics: dict[str, str]  #: topics that are written for every frame, and their types

    def __init__(self, name: str) -> None:
        self.name = name
        #: speed and pose of the platform at a time [s]; ``None`` where they are not known
        self.odometry: Callable[[float], BaseState | None] = lambda t_s: None

    @property
    def camera(self) -> Camera | None:
        """Model of the camera; ``None`` of a sensor that does not read images."""
        return cast("Camera | None", getattr(self.sensor, "camera", None))

    @property
    def zeroed(self) -> bool:
        """Whether it can measure; a sensor without a zero reference always can."""
        return bool(getattr(self.sensor, "zeroed", True))

    @property
    def zero_path(self) -> Path | None:
        """File of the zero reference, which may not exist yet."""
        return None

    def zero(self, frames: Iterable[Frame]) -> Any:
        """Take the zero reference from frames of an untouched sensor.

        Parameters
        ----------
        frames
            Of the sensor's camera, in order of time.

        Returns
        -------
        ZeroReference or BeamZero
            With the method ``save``; ``None`` from a sensor that needs no zero.
        """
        return self.sensor.zero(frames) if hasattr(self.sensor, "zero") else None

    @abstractmethod
    def read(self, frame: Frame, sink: MeasurementSink | None = None) -> SensorReading[Measured]:
        """Measure one frame.

        Parameters
        ----------
        frame
            Newer than the one before.
        sink
            Where the measurement is written as ROS 2 messages: a recording, or topics.
        """

    @abstractmethod
    def blank(self, t_s: float, sink: MeasurementSink) -> None:
        """Write that there is nothing to measure: a silent sensor would be taken for one that feels nothing.

        Parameters
        ----------
        t_s
            Time [s].
        sink
            Where it is written.
        """

    def require_zero(self, otherwise: str) -> None:
        """Refuse to measure without a zero reference.

        Parameters
        ----------
        otherwise
            What else the user can do, for the message.

        Raises
        ------
        InputError
            There is none.
        """
        if not self.zeroed:
            raise InputError(
                self.zero_path,
                "there is no zero reference",
                remedy=f"take one first (visuohaptic sense {self.kind} ... --zero) or {otherwise}",
            )

    def close(self) -> None:
        """End its threads, if it has any; may be called repeatedly."""
