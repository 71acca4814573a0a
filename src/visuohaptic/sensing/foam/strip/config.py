"""The file ``sensor.yaml`` that describes one foam sensor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from ....core import Camera, InputError, Pose, load_yaml_model
from ...config_fields import PoseSection, Positive, Section, Vector3
from ..material.foam_material import FoamMaterial
from .geometry import StripGeometry

Point2 = Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)]


class StripSection(Section):
    """Shape of the back contour: straight, bent to a radius, or through points."""

    length_m: Positive | None = None  #: of the back contour
    radius_m: Positive | None = None  #: bends the strip around the robot
    points_m: Annotated[list[Point2], Field(min_length=4, max_length=2000)] | None = None  #: instead
    spacing_m: Positive = 0.003  #: between the measured points along the strip

    @model_validator(mode="after")
    def _one_shape(self) -> StripSection:
        if (self.points_m is None) == (self.length_m is None):
            raise ValueError("expected either length_m (with or without radius_m) or points_m")
        if self.points_m is not None and self.radius_m is not None:
            raise ValueError("radius_m goes with length_m, not with points_m")
        return self

    def geometry(self, width_m: float) -> StripGeometry:
        """Back contour, front contour and points of the strip.

        Parameters
        ----------
        width_m
            Width of the foam along the compression [m].
        """
        if self.points_m is not None:
            return StripGeometry.along(np.array(self.points_m), width_m, self.spacing_m)
        assert self.length_m is not None
        if self.radius_m is not None:
            return StripGeometry.bent(self.length_m, self.radius_m, width_m, self.spacing_m)
        return StripGeometry.straight(self.length_m, width_m, self.spacing_m)


class TrackingSection(Section):
    """Appearance of the contours and their search ranges."""

    foam_is: Literal["brighter", "darker", "either"] = "either"  #: than what is in front of it
    base_is: Literal["brighter", "darker", "either"] = "either"  #: the robot, compared with the foam
    reference_search_px: Positive = 12.0  #: around the expected position of the back contour
    bump_px: Positive = 3.0  #: a larger motion of the reference contour makes frames invalid


class StripeSection(Section):
    """A colour stripe along the front edge, on top of the foam."""

    model: str  #: NPZ written by ``StripeModel.save``
    width_m: Positive  #: width of the stripe; the tracked edge lies this far behind the front


class FingerSection(Section):
    """Mounting of the sensor on the finger of a gripper."""

    axis_foam: Vector3 = Field(
        default_factory=lambda: [1.0, 0.0, 0.0]
    )  #: direction in which the finger closes, frame F
    tag_id: Annotated[int, Field(ge=0)] = 0  #: AprilTag 36h11 on the finger
    tag_size_m: Positive = 0.02  #: side of its black square
    #: Maps tag coordinates (x right, y down, z into the tag) to F; without it no tag is detected.
    T_foam_tag: PoseSection | None = None
    tag_every: Annotated[int, Field(ge=1)] = 30  #: frames between comparisons of contour and tag
    tag_tolerance_m: Positive = 0.001  #: for a larger difference the tag is used, not the contour

    @model_validator(mode="after")
    def _direction(self) -> FingerSection:
        if not np.linalg.norm(self.axis_foam) > 1e-6:
            raise ValueError(f"axis_foam is {self.axis_foam}, expected a direction")
        return self


class FoamSensorConfig(Section):
    """Fields of ``sensor.yaml``; file names are relative to its folder."""

    kind: Literal["foam"] = "foam"
    camera: str  #: ROS camera_info, written by ``visuohaptic calibrate camera``
    foam: str  #: written by ``visuohaptic calibrate foam``
    strip: StripSection  #: straight by length_m, bent by length_m and radius_m, or points_m
    T_camera_foam: PoseSection  #: maps the strip's frame F to the camera
    boundary: Literal["tension", "enlarged", "local"] = "tension"  #: law at the ends of a contact
    tracking: TrackingSection = TrackingSection()  #: appearance of the contours
    zero: str = "zero.yaml"  #: written by ``visuohaptic sense foam --zero``
    stripe: StripeSection | None = None  #: a colour stripe along the front edge
    finger: FingerSection | None = None  #: the sensor is mounted on the finger of a gripper
    max_contact_speed_m_s: Positive = 0.1  #: a front that is pushed in faster is classified as an occluder
    max_gap_s: Positive = 0.5  #: a longer pause between two frames resets the motion

    @classmethod
    def load(cls, path: Path | str) -> FoamSetup:
        """Read the file and all files that it names.

        Parameters
        ----------
        path
            ``sensor.yaml``.

        Raises
        ------
        InputError
            A file or field is not valid.
        """
        path = Path(path)
        config = load_yaml_model(path, cls)
        camera = Camera.load(path.parent / config.camera)
        material = FoamMaterial.load(path.parent / config.foam)
        try:
            pose = config.T_camera_foam.pose()
            geometry = config.strip.geometry(material.width_m)
        except InputError as error:
            raise InputError(path, error.problem, field=error.field or error.where) from error
        return FoamSetup(config, camera, material, geometry, pose, path.parent / config.zero, path.parent)


class FoamSetup:
    """A configuration with all files that it names, loaded and validated.

    Parameters
    ----------
    config
        The file.
    camera
        Intrinsics and distortion.
    material
        Calibrated foam.
    geometry
        Points of the strip.
    T_camera_foam
        Pose of frame F in the camera.
    zero_path
        File of the zero reference, which need not exist yet.
    folder
        Folder of the configuration.
    """

    def __init__(
        self,
        config: FoamSensorConfig,
        camera: Camera,
        material: FoamMaterial,
        geometry: StripGeometry,
        T_camera_foam: Pose,
        zero_path: Path,
        folder: Path,
    ) -> None:
        self.config = config
        self.camera = camera
        self.material = material
        self.geometry = geometry
        self.T_camera_foam = T_camera_foam
        self.zero_path = zero_path
        self.folder = folder
