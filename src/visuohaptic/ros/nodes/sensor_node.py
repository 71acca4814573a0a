"""Nodes for foam, beam, scene and templates: take images, publish forces with validity and reason, or poses."""

from __future__ import annotations

import threading
from abc import abstractmethod
from contextlib import ExitStack
from pathlib import Path
from typing import Any, ClassVar

from pydantic import Field

from ...core.camera.model import Camera
from ...core.errors import DeviceError
from ...sensing.readers.sensor_reader import SensorReader
from ...sensing.readers.template_reader import TemplateReader
from ...tracking import TemplatePose, TemplateTracker, load_templates
from ..bridge import open_reader
from ..bridge_config import SensorSection
from ..channel import SensorChannel
from .component import Component, Status
from .parameters import NodeParameters


class ImageParameters(NodeParameters):
    """Parameters of all nodes that use a camera."""

    image: str = Field(
        "image", description="image topic; sensor_msgs/CompressedImage where it ends in /compressed"
    )
    frame: str = Field("", description="frame_id of the messages; the node's name by default")
    queue: int = Field(2, ge=1, le=100, description="frames that wait while one is read")
    stale_s: float = Field(
        0.5, ge=0.01, le=60.0, description="without an image for so long, stale is published [s]"
    )


class SensorParameters(ImageParameters):
    """Parameters of the nodes foam, beam and scene."""

    config: str = Field("", min_length=1, description="sensor.yaml or scene.yaml of the sensor")
    odometry: str = Field("", description="topic of nav_msgs/Odometry; empty for none")
    zero_frames: int = Field(
        0, ge=0, le=10_000, description="take the zero reference from the first frames; 0: from the file"
    )


class ImageNode(Component):
    """Base of sensors that process a camera topic in a separate thread."""

    def configure(self) -> None:
        host, parameters = self.host, self.parameters
        given = parameters.model_dump(include=set(SensorSection.model_fields))
        section = SensorSection.model_validate({"name": host.node.name, "config": ""} | given)
        self._stop = threading.Event()
        with ExitStack() as opened:
            reader = opened.enter_context(self._reader(section))
            self._channel = SensorChannel(
                host.node, section, reader, parameters.stale_s, self._stop, host.fail
            )
            opened.pop_all()

    @abstractmethod
    def _reader(self, section: SensorSection) -> SensorReader[Any]:
        """The sensor."""

    def activate(self) -> None:
        if not self._channel.join():
            raise DeviceError(
                f"{self.host.node.name}: the last image is still being processed; activate it later"
            )
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


class _SensorNode(ImageNode):
    sensor: ClassVar[str]
    parameter_model = SensorParameters

    def _reader(self, section: SensorSection) -> SensorReader[Any]:
        return open_reader(section, Path(section.config), self.sensor)


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


class TemplateParameters(ImageParameters):
    """Parameters of the node template."""

    templates: str = Field(
        "", min_length=1, description="folder of templates: images with a dpi value, tags.yaml"
    )
    camera: str = Field("", min_length=1, description="camera.yaml, a ROS camera_info file")
    tf: bool = Field(True, description="publish the frames of the templates on /tf")


class TemplateNode(ImageNode):
    """Poses of known images and tags."""

    summary = "pictures and tags: Image in, PoseWithCovarianceStamped and tf out"
    parameter_model = TemplateParameters

    def _reader(self, section: SensorSection) -> SensorReader[Any]:
        camera = Camera.load(Path(self.parameters.camera))
        self._camera = camera.name
        templates = load_templates(Path(self.parameters.templates))
        names = tuple(template.name for template in templates)
        # A live camera must not wait for the detector.
        return TemplateReader(TemplateTracker(templates, camera, threaded=True), names, self._follow)

    def _follow(self, poses: tuple[TemplatePose, ...]) -> None:
        if self.parameters.tf:
            for pose in poses:
                if pose.valid and pose.T_camera_template is not None:
                    self.host.transform(pose.t_s, self._camera, pose.name, pose.T_camera_template)
