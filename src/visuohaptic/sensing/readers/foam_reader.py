"""The foam strip as a program runs it: force, shape and contact events."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ...core import EventKind, ForceProfile, Frame, Reason
from ...io.sinks.measurement_sink import MeasurementSink
from ..push.events import ContactEvents
from .sensor_reader import DIAGNOSTICS, WRENCH, SensorReader, SensorReading

if TYPE_CHECKING:
    from ..foam.sensor import FoamSensor


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
    sensor: FoamSensor

    def __init__(self, sensor: FoamSensor, name: str = "foam") -> None:
        super().__init__(name)
        self.sensor, self._events = sensor, ContactEvents()
        self.topics = {f"/{name}/wrench": WRENCH, f"/{name}/diagnostics": DIAGNOSTICS}

    @property
    def zero_path(self) -> Path:
        """File of the zero reference, which may not exist yet."""
        return self.sensor.setup.zero_path

    def read(self, frame: Frame, sink: MeasurementSink | None = None) -> SensorReading[ForceProfile]:
        """Force profile of a frame; writes wrench, diagnostics, profile, contact contour and events."""
        profile = self.sensor.read(frame)
        state = self.odometry(frame.t_s)
        speed = None if state is None else float(state.speed_m_s)
        # A front at rest determines nothing about the object unless the platform moves.
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
        """Write a stale profile."""
        sink.write_force(self.sensor.blank(t_s, Reason.STALE), self.name)
