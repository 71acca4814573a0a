"""Foam, beam and scene as nodes: images in, forces with validity and reason out."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import ClassVar

from pydantic import Field

from ...core.errors import InputError
from ...sensing.readers.load import load_reader
from ..bridge import check_sensor
from ..bridge_config import SensorSection, sensor_kind
from ..channel import SensorChannel
from .component import Component, Host, Status
from .parameters import NodeParameters

__all__ = ["BeamNode", "FoamNode", "SceneNode", "SensorParameters"]


class SensorParameters(NodeParameters):
    """Of the nodes foam, beam and scene."""

    config: str = Field("", min_length=1, description="sensor.yaml or scene.yaml of the sensor")
    image: str = Field(
        "image", description="image topic; sensor_msgs/CompressedImage where it ends in /compressed"
    )
    odometry: str = Field("", description="topic of nav_msgs/Odometry; empty for none")
    frame: str = Field("", description="frame_id of the messages; the node's name by default")
    zero_frames: int = Field(
        0, ge=0, le=10_000, description="take the zero reference from the first frames; 0: from the file"
    )
    queue: int = Field(2, ge=1, le=100, description="frames that wait while one is read")
    stale_s: float = Field(
        0.5, ge=0.01, le=60.0, description="without an image for so long, stale is published [s]"
    )


class _SensorNode(Component):
    sensor: ClassVar[str]
    parameter_model = SensorParameters

    def __init__(self, host: Host, parameters: SensorParameters) -> None:
        super().__init__(host, parameters)
        path = Path(parameters.config)
        kind = sensor_kind(path)
        if kind != self.sensor:
            raise InputError(path, f"found the sensor {kind}, expected {self.sensor}", field="kind")
        section = SensorSection(
            name=host.node.name,
            config=parameters.config,
            image=parameters.image,
            frame=parameters.frame or None,
            odometry=parameters.odometry or None,
            zero_frames=parameters.zero_frames,
            queue=parameters.queue,
        )
        reader = load_reader(path, section.name)
        self._stop = threading.Event()
        try:
            check_sensor(section, reader, path, self.sensor)
            self._channel = SensorChannel(
                host.node, section, reader, parameters.stale_s, self._stop, host.fail
            )
        except BaseException:
            reader.close()
            raise

    def activate(self) -> None:
        self._stop.clear()
        self._channel.start()

    def deactivate(self) -> None:
        self._stop.set()
        self._channel.join()

    def status(self) -> Status:
        report, frames = self._channel.report, self._channel.frames
        counts = {"frames": report.frames, "stale": report.stale, "lost": report.lost,
                  "left_out": frames.left_out, "damaged": frames.damaged}  # fmt: skip
        reasons = {f"frames_{reason}": count for reason, count in report.reasons.items()}
        silent = self._channel.silent
        return Status(not silent, "stale" if silent else "ok", counts | reasons)

    def close(self) -> None:
        self._stop.set()
        self._channel.close()


class FoamNode(_SensorNode):
    """A foam strip seen by a camera."""

    sensor, summary = "foam", "foam strip: Image in, WrenchStamped, contacts and profile out"


class BeamNode(_SensorNode):
    """A bending beam with templates."""

    sensor, summary = "beam", "bending beam: Image in, WrenchStamped out"


class SceneNode(_SensorNode):
    """Foam, beams and templates in one image."""

    sensor, summary = (
        "scene",
        "several sensors in one image, and the platform's motion: WrenchStamped, pose out",
    )
