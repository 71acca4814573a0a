"""The sensors of a bridge behind one face: a frame in, messages out."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..core.camera.frame import Frame
from ..core.camera.model import Camera
from ..core.errors import StaleFrameError
from ..core.measurement import Reason
from ..io.ros import ros_messages as ros
from ..io.sinks.measurement_sink import MeasurementSink
from .markers import contact_markers

if TYPE_CHECKING:
    from ..core.robots import MobileBase
    from ..sensing.beam.tracked import TrackedBeam
    from ..sensing.foam.sensor import FoamSensor
    from ..sensing.scene.scene_file import SceneSetup

__all__ = ["BeamReader", "FoamReader", "Reader", "SceneReader", "load_reader"]

_WRENCH, _DIAGNOSTICS = "geometry_msgs/msg/WrenchStamped", "diagnostic_msgs/msg/DiagnosticArray"
_POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"


class Reader(Protocol):
    """A sensor of a bridge."""

    name: str
    topics: dict[str, str]  #: topics that it always publishes, and their types
    base: MobileBase | None  #: whose odometry is used, if any

    @property
    def camera(self) -> Camera:
        """Model of the camera."""

    @property
    def zeroed(self) -> bool:
        """Whether it can measure."""

    def zero(self, frames: Iterable[Frame]) -> None:
        """Take the zero from frames of an untouched sensor."""

    def read(self, frame: Frame, sink: MeasurementSink) -> Reason:
        """Measure, publish, and say whether to trust it."""

    def blank(self, t_s: float, sink: MeasurementSink) -> None:
        """Publish that there is nothing to measure."""

    def close(self) -> None:
        """End its threads."""


class FoamReader:
    """Force and shape of a foam strip, with contact events and arrows."""

    def __init__(self, sensor: FoamSensor, name: str) -> None:
        from ..sensing.push.events import ContactEvents

        self.name, self._sensor, self._events = name, sensor, ContactEvents()
        self.base: MobileBase | None = None
        self.topics = {f"/{name}/wrench": _WRENCH, f"/{name}/diagnostics": _DIAGNOSTICS}

    @property
    def camera(self) -> Camera:
        """Model of the camera."""
        return self._sensor.setup.camera

    @property
    def zeroed(self) -> bool:
        """Whether there is a zero reference."""
        return self._sensor.zero_reference is not None

    def zero(self, frames: Iterable[Frame]) -> None:
        """Take the zero from frames of an untouched strip."""
        self._sensor.zero(frames)

    def read(self, frame: Frame, sink: MeasurementSink) -> Reason:
        """Wrench, diagnostics, profile, contact, arrows and events."""
        from ..core.measurement import EventKind

        profile = self._sensor.read(frame)
        speed = _speed(self.base)
        sink.write_force(profile, self.name)
        arrows = contact_markers(profile, sink.frame, self.name)
        sink.write(f"/{self.name}/markers", "visualization_msgs/msg/MarkerArray", profile.t_s, arrows)
        for event in self._events.update(profile, speed_m_s=speed):
            # A front that stands still says nothing of the object unless the platform goes on.
            if event.kind is not EventKind.MOTION or speed is not None:
                sink.write_event(event, self.name)
        return profile.reason

    def blank(self, t_s: float, sink: MeasurementSink) -> None:
        """A stale profile."""
        sink.write_force(self._sensor.blank(t_s, Reason.STALE), self.name)

    def close(self) -> None:
        """It has no threads."""


class BeamReader:
    """Six axes from templates on a bending rod."""

    def __init__(self, beam: TrackedBeam, name: str) -> None:
        self.name, self._beam = name, beam
        self.base: MobileBase | None = None
        self.topics = {f"/{name}/wrench": _WRENCH, f"/{name}/diagnostics": _DIAGNOSTICS}

    @property
    def camera(self) -> Camera:
        """Model of the camera."""
        return self._beam.camera

    @property
    def zeroed(self) -> bool:
        """Whether there are resting poses."""
        return self._beam.sensor.zero_reference is not None

    def zero(self, frames: Iterable[Frame]) -> None:
        """Take the zero from frames of an untouched rod."""
        self._beam.zero(frames)

    def read(self, frame: Frame, sink: MeasurementSink) -> Reason:
        """Wrench and diagnostics."""
        wrench = self._beam.read(frame).reading.wrench
        sink.write_wrench(wrench, self.name)
        return wrench.reason

    def blank(self, t_s: float, sink: MeasurementSink) -> None:
        """A stale wrench."""
        from ..core.measurement import Wrench

        nothing = np.full(3, np.nan)
        sink.write_wrench(
            Wrench(t_s, False, Reason.STALE, nothing, nothing, np.full((6, 6), np.nan), sink.frame), self.name
        )

    def close(self) -> None:
        """End the detector's thread."""
        self._beam.close()


class SceneReader:
    """Obstacles ahead, the floor that passes, and the platform's way; with a foam sensor its force, too."""

    def __init__(self, setup: SceneSetup, name: str, rng: np.random.Generator | None = None) -> None:
        self.name, self._setup = name, setup
        self.base: MobileBase | None = None
        self._tracker = setup.tracker(rng)
        self._foam = None if setup.sensor is None else _zeroed_foam(setup.sensor)
        self.topics = {f"/{name}/pose": _POSE, f"/{name}/diagnostics": _DIAGNOSTICS}

    @property
    def camera(self) -> Camera:
        """Model of the camera."""
        return self._setup.camera

    @property
    def zeroed(self) -> bool:
        """Whether its foam sensor, if it has one, has a zero reference."""
        return self._foam is None or self._foam.zero_reference is not None

    def zero(self, frames: Iterable[Frame]) -> None:
        """Zero its foam sensor."""
        if self._foam is not None:
            self._foam.zero(frames)

    def read(self, frame: Frame, sink: MeasurementSink) -> Reason:
        """Pose and diagnostics; with a foam sensor what that measures."""
        from ..sensing.scene.scene_record import write_scene

        profile = self._foam.read(frame) if self._foam is not None else None
        reading = self._tracker.update(frame, profile, _state(self.base))
        write_scene(sink, reading, self.name)
        for event in reading.events:
            sink.write_event(event, self.name)
        if profile is not None:
            sink.write_force(profile, f"{self.name}_foam")
        return reading.motion.reason

    def blank(self, t_s: float, sink: MeasurementSink) -> None:
        """Diagnostics that say so; a pose that is not known is not published."""
        message = ros.diagnostics(t_s, "odom", self.name, False, Reason.STALE.value, {})
        sink.write(f"/{self.name}/diagnostics", _DIAGNOSTICS, t_s, message)
        if self._foam is not None:
            sink.write_force(self._foam.blank(t_s, Reason.STALE), f"{self.name}_foam")

    def close(self) -> None:
        """It has no threads."""


def _zeroed_foam(setup: Any) -> FoamSensor:
    from ..sensing.foam.sensor import FoamSensor
    from ..sensing.foam.strip.zero import ZeroReference

    zero = None
    if setup.zero_path.exists():
        zero = ZeroReference.load(setup.zero_path, len(setup.geometry.s_m))
    return FoamSensor(setup, zero)


def _state(base: MobileBase | None) -> Any:
    """Odometry where there is some now: without it a scene is tracked by the floor alone."""
    if base is None:
        return None
    try:
        return base.state()
    except StaleFrameError:
        return None


def _speed(base: MobileBase | None) -> float | None:
    state = _state(base)
    return None if state is None else float(state.speed_m_s)


def load_reader(kind: str, path: Path, name: str) -> Reader:
    """The sensor of a file.

    Raises
    ------
    InputError
        The file, or one that it names, cannot be used.
    """
    if kind == "foam":
        from ..sensing.foam.finger import load_foam_sensor

        return FoamReader(load_foam_sensor(path), name)
    if kind == "beam":
        from ..sensing.beam.tracked import TrackedBeam

        # A live camera must not wait for the detector.
        return BeamReader(TrackedBeam.load(path, threaded=True), name)
    from ..sensing.scene.scene_file import SceneConfig

    return SceneReader(SceneConfig.load(path), name, np.random.default_rng(0))
