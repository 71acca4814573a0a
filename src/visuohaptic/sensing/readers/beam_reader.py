"""The bending rod as a program runs it: the wrench, and the poses of its templates."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...core import Camera, Frame, Reason, Wrench
from ...io.sinks.measurement_sink import MeasurementSink
from .sensor_reader import DIAGNOSTICS, WRENCH, SensorReader, SensorReading

if TYPE_CHECKING:
    from ...tracking.templates.template_tracker import TemplatePose
    from ..beam.tracked import TrackedBeam, TrackedReading


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
    sensor: TrackedBeam

    def __init__(self, beam: TrackedBeam, name: str = "beam", *, templates: bool = False) -> None:
        super().__init__(name)
        self.sensor, self._templates = beam, templates
        self.topics = {f"/{name}/wrench": WRENCH, f"/{name}/diagnostics": DIAGNOSTICS}

    @property
    def zero_path(self) -> Path | None:
        """File of the resting poses, which may not exist yet."""
        return self.sensor.sensor.setup.zero_path

    def read(self, frame: Frame, sink: MeasurementSink | None = None) -> SensorReading[TrackedReading]:
        """Wrench and template poses of a frame; writes wrench and diagnostics."""
        found = self.sensor.read(frame)
        wrench = found.reading.wrench
        if sink is not None:
            sink.write_wrench(wrench, self.name)
            if self._templates:
                write_templates(sink, found.templates, self.sensor.camera)
        return SensorReading(found, wrench.reason)

    def blank(self, t_s: float, sink: MeasurementSink) -> None:
        """Write a stale wrench."""
        nothing = np.full(3, np.nan)
        sink.write_wrench(
            Wrench(t_s, False, Reason.STALE, nothing, nothing, np.full((6, 6), np.nan), sink.frame), self.name
        )

    def close(self) -> None:
        """End the detector's thread; may be called repeatedly."""
        self.sensor.close()


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
