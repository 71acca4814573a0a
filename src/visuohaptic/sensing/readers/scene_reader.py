"""The scene ahead as a program runs it: obstacles, the floor's motion, and the foam's force where it is read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ...core import Frame, Reason
from ...io.ros import ros_messages as ros
from ...io.sinks.measurement_sink import MeasurementSink
from .sensor_reader import DIAGNOSTICS, SensorReader, SensorReading

if TYPE_CHECKING:
    from ..scene import SceneReading, SceneSensor


class SceneReader(SensorReader["SceneReading"]):
    """Obstacles ahead, the motion of the floor and the platform's pose; with a foam sensor its force, too.

    Parameters
    ----------
    sensor
        Scene sensor, with or without a foam sensor.
    name
        First part of its topics.
    foam_name
        First part of the foam sensor's topics; ``NAME_foam`` by default.
    mask
        Whether the obstacle mask is written, too.
    """

    kind = "scene"
    sensor: SceneSensor

    def __init__(
        self,
        sensor: SceneSensor,
        name: str = "scene",
        *,
        foam_name: str | None = None,
        mask: bool = False,
    ) -> None:
        super().__init__(name)
        self.sensor, self._mask = sensor, mask
        self.odometry = sensor.odometry or self.odometry
        sensor.odometry = lambda t_s: self.odometry(t_s)  # which may be set later
        self.foam = sensor.foam  #: the foam sensor that the configuration names
        self._foam_name = foam_name or f"{name}_foam"
        self.topics = {
            f"/{name}/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
            f"/{name}/diagnostics": DIAGNOSTICS,
        }

    @property
    def zero_path(self) -> Path | None:
        """File of its foam sensor's zero reference."""
        return None if self.foam is None else self.foam.setup.zero_path

    def read(self, frame: Frame, sink: MeasurementSink | None = None) -> SensorReading[SceneReading]:
        """Everything around the foam in a frame; writes pose, diagnostics and events."""
        from ..scene.scene_record import write_scene

        reading = self.sensor.read(frame)
        if sink is not None:
            write_scene(sink, reading, self.name, mask=self._mask)
            for event in reading.events:
                sink.write_event(event, self.name)
            if self.sensor.profile is not None:
                sink.write_force(self.sensor.profile, self._foam_name)
        return SensorReading(reading, reading.motion.reason, tuple(reading.events))

    def blank(self, t_s: float, sink: MeasurementSink) -> None:
        """Write diagnostics that say so; a pose that is not known is not written."""
        message = ros.diagnostics(t_s, "odom", self.name, False, Reason.STALE.value, {})
        sink.write(f"/{self.name}/diagnostics", DIAGNOSTICS, t_s, message)
        if self.foam is not None:
            sink.write_force(self.foam.blank(t_s, Reason.STALE), self._foam_name)
