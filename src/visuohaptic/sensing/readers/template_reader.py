"""A template tracker behind the interface of a sensor."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from ...core import Frame, Reason
from ...io.sinks.measurement_sink import MeasurementSink
from .beam_reader import write_templates
from .sensor_reader import SensorReader, SensorReading

if TYPE_CHECKING:
    from ...tracking.templates.template_tracker import TemplatePose, TemplateTracker

_POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"


class TemplateReader(SensorReader["tuple[TemplatePose, ...]"]):
    """Poses of templates; the reason of a frame is that of the first template that was not seen.

    Parameters
    ----------
    tracker
        Its templates and camera; closed with the reader.
    names
        Of the templates, whose topics ``/template/NAME`` are written for every frame.
    follow
        Called with the poses of every frame.
    """

    kind = "template"
    sensor: TemplateTracker

    def __init__(
        self,
        tracker: TemplateTracker,
        names: tuple[str, ...] = (),
        follow: Callable[[tuple[TemplatePose, ...]], None] = lambda poses: None,
    ) -> None:
        super().__init__("template")
        self.sensor, self._follow = tracker, follow
        self.topics = {f"/template/{name}": _POSE for name in names}

    def read(
        self, frame: Frame, sink: MeasurementSink | None = None
    ) -> SensorReading[tuple[TemplatePose, ...]]:
        """Poses of all templates; writes those that were seen.

        Parameters
        ----------
        frame
            Newer than the one before.
        sink
            Where the poses are written.
        """
        poses = self.sensor.update(frame)
        if sink is not None:
            write_templates(sink, poses, self.sensor.camera)
        self._follow(poses)
        return SensorReading(poses, next((pose.reason for pose in poses if not pose.valid), Reason.OK))

    def blank(self, t_s: float, sink: MeasurementSink) -> None:
        """A template that is not seen has no pose, and its topic falls silent."""

    def close(self) -> None:
        """End the detector's thread."""
        self.sensor.close()
