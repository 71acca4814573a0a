"""A sensor as a program runs it: a frame in, a reading out, written to a sink on its way.

The command line and the ROS 2 bridge run every sensor through these readers, so that a recording and a live
node say the same.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import numpy as np

from ..core.camera.frame import Frame
from ..core.camera.model import Camera
from ..core.errors import InputError
from ..core.measurement import Event, EventKind, ForceProfile, Reason, Wrench
from ..core.resources import Closing
from ..core.robots import BaseState
from ..io.ros import ros_messages as ros
from ..io.sinks.measurement_sink import MeasurementSink

if TYPE_CHECKING:
    from ..tracking.templates.template_tracker import TemplatePose
    from .beam.tracked import TrackedBeam, TrackedReading
    from .beam.zero import BeamZero
    from .foam.sensor import FoamSensor
    from .foam.strip.config import FoamSetup
    from .foam.strip.zero import ZeroReference
    from .scene.scene_file import SceneSetup
    from .scene.scene_tracker import SceneReading

__all__ = [
    "BeamReader",
    "FoamReader",
    "SceneReader",
    "SensorReader",
    "SensorReading",
    "load_reader",
    "write_templates",
]

Measured = TypeVar("Measured")

_WRENCH, _DIAGNOSTICS = "geometry_msgs/msg/WrenchStamped", "diagnostic_msgs/msg/DiagnosticArray"
_POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"


@dataclass(frozen=True, slots=True, eq=False)
class SensorReading(Generic[Measured]):
    """What a sensor made of one frame."""

    measured: Measured
    reason: Reason  #: why it cannot be trusted; ``ok`` when it can
    events: tuple[Event, ...] = ()


class SensorReader(Closing, Generic[Measured]):
    """One sensor behind one interface; closed when its ``with`` block ends.

    Parameters
    ----------
    name
        First part of its topics, as ``foam`` in ``/foam/wrench``.
    """

    kind: ClassVar[str]  #: ``foam``, ``beam`` or ``scene``, as in its file
    topics: dict[str, str]  #: topics that are written for every frame, and their types

    def __init__(self, name: str) -> None:
        self.name = name
        #: speed and pose of the platform at a time [s]; ``None`` where they are not known
        self.odometry: Callable[[float], BaseState | None] = lambda t_s: None

    @property
    @abstractmethod
    def camera(self) -> Camera | None:
        """Model of the camera; ``None`` of a sensor that does not read images."""

    @property
    def zeroed(self) -> bool:
        """Whether it can measure; a sensor without a zero reference always can."""
        return True

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
        """End its threads, if it has any; harmless when repeated."""


class FoamReader(SensorReader[ForceProfile]):
    """Force and shape of a foam strip, with contact events.

    Parameters
    ----------
    sensor
        Foam sensor, with or without its zero reference.
    name
        First part of its topics.
    """

    kind = "foam"

    def __init__(self, sensor: FoamSensor, name: str = "foam") -> None:
        from .push.events import ContactEvents

        super().__init__(name)
        self.sensor, self._events = sensor, ContactEvents()
        self.topics = {f"/{name}/wrench": _WRENCH, f"/{name}/diagnostics": _DIAGNOSTICS}

    @property
    def camera(self) -> Camera:
        """Model of the camera."""
        return self.sensor.setup.camera

    @property
    def zeroed(self) -> bool:
        """Whether there is a zero reference."""
        return self.sensor.zero_reference is not None

    @property
    def zero_path(self) -> Path:
        """File of the zero reference, which may not exist yet."""
        return self.sensor.setup.zero_path

    def zero(self, frames: Iterable[Frame]) -> ZeroReference:
        """Take the zero reference from frames of an untouched strip.

        Parameters
        ----------
        frames
            Of the sensor's camera, in order of time.
        """
        return self.sensor.zero(frames)

    def read(self, frame: Frame, sink: MeasurementSink | None = None) -> SensorReading[ForceProfile]:
        """Force profile of a frame; writes wrench, diagnostics, profile, contact contour and events.

        Parameters
        ----------
        frame
            Newer than the one before.
        sink
            Where they are written.
        """
        profile = self.sensor.read(frame)
        state = self.odometry(frame.t_s)
        speed = None if state is None else float(state.speed_m_s)
        # A front that stands still says nothing of the object unless the platform goes on.
        events = tuple(
            event
            for event in self._events.update(profile, speed_m_s=speed)
            if event.kind is not EventKind.MOTION or speed is not None
        )
        if sink is not None:
            sink.write_force(profile, self.name)
            for event in events:
                sink.write_event(event, self.name)
        return SensorReading(profile, profile.reason, events)

    def blank(self, t_s: float, sink: MeasurementSink) -> None:
        """Write a stale profile.

        Parameters
        ----------
        t_s
            Time [s].
        sink
            Where it is written.
        """
        sink.write_force(self.sensor.blank(t_s, Reason.STALE), self.name)


class BeamReader(SensorReader["TrackedReading"]):
    """Force and moment, six axes, from templates on a bending rod.

    Parameters
    ----------
    beam
        Beam sensor with its camera.
    name
        First part of its topics.
    templates
        Whether the poses of the templates are written, too, on ``/template/NAME``.
    """

    kind = "beam"

    def __init__(self, beam: TrackedBeam, name: str = "beam", *, templates: bool = False) -> None:
        super().__init__(name)
        self.beam, self._templates = beam, templates
        self.topics = {f"/{name}/wrench": _WRENCH, f"/{name}/diagnostics": _DIAGNOSTICS}

    @property
    def camera(self) -> Camera:
        """Model of the camera."""
        return self.beam.camera

    @property
    def zeroed(self) -> bool:
        """Whether there are resting poses."""
        return self.beam.sensor.zero_reference is not None

    @property
    def zero_path(self) -> Path | None:
        """File of the resting poses, which may not exist yet."""
        return self.beam.sensor.setup.zero_path

    def zero(self, frames: Iterable[Frame]) -> BeamZero:
        """Take the resting poses from frames of an untouched rod.

        Parameters
        ----------
        frames
            Of the sensor's camera, in order of time.
        """
        return self.beam.zero(frames)

    def read(self, frame: Frame, sink: MeasurementSink | None = None) -> SensorReading[TrackedReading]:
        """Wrench and template poses of a frame; writes wrench and diagnostics.

        Parameters
        ----------
        frame
            Newer than the one before.
        sink
            Where they are written.
        """
        found = self.beam.read(frame)
        wrench = found.reading.wrench
        if sink is not None:
            sink.write_wrench(wrench, self.name)
            if self._templates:
                write_templates(sink, found.templates, self.camera)
        return SensorReading(found, wrench.reason)

    def blank(self, t_s: float, sink: MeasurementSink) -> None:
        """Write a stale wrench.

        Parameters
        ----------
        t_s
            Time [s].
        sink
            Where it is written.
        """
        nothing = np.full(3, np.nan)
        sink.write_wrench(
            Wrench(t_s, False, Reason.STALE, nothing, nothing, np.full((6, 6), np.nan), sink.frame), self.name
        )

    def close(self) -> None:
        """End the detector's thread; harmless when repeated."""
        self.beam.close()


class SceneReader(SensorReader["SceneReading"]):
    """Obstacles ahead, the motion of the floor and the platform's pose; with a foam sensor its force, too.

    Parameters
    ----------
    setup
        As read from ``scene.yaml``.
    name
        First part of its topics.
    rng
        Of the consensus search.
    foam_name
        First part of the foam sensor's topics; ``NAME_foam`` by default.
    mask
        Whether the obstacle mask is written, too.
    """

    kind = "scene"

    def __init__(
        self,
        setup: SceneSetup,
        name: str = "scene",
        rng: np.random.Generator | None = None,
        *,
        foam_name: str | None = None,
        mask: bool = False,
    ) -> None:
        super().__init__(name)
        self._setup, self._mask = setup, mask
        self._tracker = setup.tracker(rng)
        #: the foam sensor that the configuration names
        self.foam = None if setup.sensor is None else _zeroed_foam(setup.sensor)
        self._foam_name = foam_name or f"{name}_foam"
        self.topics = {f"/{name}/pose": _POSE, f"/{name}/diagnostics": _DIAGNOSTICS}

    @property
    def camera(self) -> Camera:
        """Model of the camera."""
        return self._setup.camera

    @property
    def zeroed(self) -> bool:
        """Whether its foam sensor, if it has one, has a zero reference."""
        return self.foam is None or self.foam.zero_reference is not None

    @property
    def zero_path(self) -> Path | None:
        """File of its foam sensor's zero reference."""
        return None if self.foam is None else self.foam.setup.zero_path

    def zero(self, frames: Iterable[Frame]) -> ZeroReference | None:
        """Take the zero reference of its foam sensor.

        Parameters
        ----------
        frames
            Of the sensor's camera, in order of time.
        """
        return None if self.foam is None else self.foam.zero(frames)

    def read(self, frame: Frame, sink: MeasurementSink | None = None) -> SensorReading[SceneReading]:
        """Everything around the foam in a frame; writes pose, diagnostics and events.

        Parameters
        ----------
        frame
            Newer than the one before.
        sink
            Where they are written.
        """
        from .scene.scene_record import write_scene

        profile = self.foam.read(frame) if self.foam is not None else None
        reading = self._tracker.update(frame, profile, self.odometry(frame.t_s))
        if sink is not None:
            write_scene(sink, reading, self.name, mask=self._mask)
            for event in reading.events:
                sink.write_event(event, self.name)
            if profile is not None:
                sink.write_force(profile, self._foam_name)
        return SensorReading(reading, reading.motion.reason, tuple(reading.events))

    def blank(self, t_s: float, sink: MeasurementSink) -> None:
        """Write diagnostics that say so; a pose that is not known is not written.

        Parameters
        ----------
        t_s
            Time [s].
        sink
            Where they are written.
        """
        message = ros.diagnostics(t_s, "odom", self.name, False, Reason.STALE.value, {})
        sink.write(f"/{self.name}/diagnostics", _DIAGNOSTICS, t_s, message)
        if self.foam is not None:
            sink.write_force(self.foam.blank(t_s, Reason.STALE), self._foam_name)


def _zeroed_foam(setup: FoamSetup) -> FoamSensor:
    from .foam.sensor import FoamSensor
    from .foam.strip.zero import ZeroReference

    zero = None
    if setup.zero_path.exists():
        zero = ZeroReference.load(setup.zero_path, len(setup.geometry.s_m))
    return FoamSensor(setup, zero)


def write_templates(sink: MeasurementSink, poses: Iterable[TemplatePose], camera: Camera) -> None:
    """Write the poses of the templates that were seen, on ``/template/NAME`` in the camera's frame.

    Parameters
    ----------
    sink
        Where they are written.
    poses
        Of one frame.
    camera
        Whose name is that of the frame of coordinates.
    """
    for pose in poses:
        if pose.T_camera_template is not None:
            sink.write_pose(
                pose.T_camera_template,
                pose.t_s,
                f"/template/{pose.name}",
                frame=camera.name,
                covariance=pose.covariance,
            )


def load_reader(kind: str, path: Path, name: str) -> SensorReader[Any]:
    """The reader of a sensor's file, for live use.

    Parameters
    ----------
    kind
        ``foam``, ``beam`` or ``scene``.
    path
        ``sensor.yaml`` or ``scene.yaml``.
    name
        First part of its topics.

    Raises
    ------
    InputError
        The file, or one that it names, cannot be used.
    """
    if kind == "foam":
        from .foam.finger import load_foam_sensor

        return FoamReader(load_foam_sensor(path), name)
    if kind == "beam":
        from .beam.tracked import TrackedBeam

        # A live camera must not wait for the detector.
        return BeamReader(TrackedBeam.load(path, threaded=True), name)
    from .scene.scene_file import SceneConfig

    return SceneReader(SceneConfig.load(path), name, np.random.default_rng(0))
