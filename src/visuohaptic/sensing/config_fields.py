"""Fields and sections common to the YAML files of all sensors."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from ..core.camera.pose import Pose

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Vector3 = Annotated[list[FiniteFloat], Field(min_length=3, max_length=3)]
Vector4 = Annotated[list[FiniteFloat], Field(min_length=4, max_length=4)]


class Section(BaseModel):
    """A section of a file; unknown fields are rejected."""

    model_config = ConfigDict(extra="forbid")


class PoseSection(Section):
    """A rigid transform: translation [m] and quaternion in ROS order (x, y, z, w)."""

    translation_m: Vector3
    quaternion_xyzw: Vector4

    def pose(self) -> Pose:
        """Convert to a pose.

        Raises
        ------
        InputError
            The quaternion is zero.
        """
        return Pose.from_quaternion(self.quaternion_xyzw, self.translation_m)
