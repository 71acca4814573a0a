"""Template tracking as a node: images in, poses with covariance and transforms out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import Field

from ...core.camera.model import Camera
from ...sensing.readers.sensor_reader import SensorReader
from ...sensing.readers.template_reader import TemplateReader
from ...tracking.templates.template import load_templates
from ...tracking.templates.template_tracker import TemplatePose, TemplateTracker
from ..bridge_config import SensorSection
from .sensor_node import ImageNode, ImageParameters

__all__ = ["TemplateNode", "TemplateParameters"]


class TemplateParameters(ImageParameters):
    """Of the node template."""

    templates: str = Field(
        "", min_length=1, description="folder of templates: images with a dpi value, tags.yaml"
    )
    camera: str = Field("", min_length=1, description="camera.yaml, a ROS camera_info file")
    tf: bool = Field(True, description="publish the frames of the templates on /tf")


class TemplateNode(ImageNode):
    """Poses of known pictures and tags."""

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
