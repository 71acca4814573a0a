"""The ROS ``camera_info`` YAML file as a schema."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from ..errors import InputError

if TYPE_CHECKING:
    from .model import Camera


class _Matrix(BaseModel):
    model_config = ConfigDict(extra="forbid")
    rows: int
    cols: int
    data: Annotated[list[FiniteFloat], Field(max_length=64)]

    def array(self, name: str, shape: tuple[int, int] | None = None) -> np.ndarray:
        expected = shape or (self.rows, self.cols)
        if (self.rows, self.cols) != expected or len(self.data) != self.rows * self.cols:
            raise InputError(
                "camera_info",
                f"found {self.rows} x {self.cols} with {len(self.data)} numbers, "
                f"expected {expected[0]} x {expected[1]}",
                field=name,
            )
        return np.array(self.data, dtype=np.float64).reshape(self.rows, self.cols)


class CameraInfoFile(BaseModel):
    """Fields of the file; those that this library does not use are accepted and ignored."""

    model_config = ConfigDict(extra="ignore")
    image_width: Annotated[int, Field(gt=0)]
    image_height: Annotated[int, Field(gt=0)]
    camera_name: str = "camera"
    camera_matrix: _Matrix
    distortion_model: str = "plumb_bob"
    distortion_coefficients: _Matrix | None = None
    row_delay_s: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0

    def to_camera(self) -> Camera:
        from .model import Camera

        if self.distortion_model not in ("plumb_bob", "rational_polynomial"):
            raise InputError(
                "camera_info",
                f"found {self.distortion_model!r}, expected plumb_bob or rational_polynomial",
                field="distortion_model",
            )
        distortion = np.zeros(5)
        if self.distortion_coefficients is not None:
            distortion = self.distortion_coefficients.array("distortion_coefficients").ravel()
        return Camera(
            self.image_width,
            self.image_height,
            self.camera_matrix.array("camera_matrix", (3, 3)),
            distortion,
            self.row_delay_s,
            self.camera_name,
        )


def camera_info_dict(camera: Camera) -> dict[str, Any]:
    """The file's content for a camera."""
    projection = np.hstack([camera.matrix, np.zeros((3, 1))])

    def matrix(values: np.ndarray) -> dict[str, Any]:
        values = np.atleast_2d(values)
        return {
            "rows": values.shape[0],
            "cols": values.shape[1],
            "data": [float(value) for value in values.ravel()],
        }

    distortion = camera.distortion if camera.distortion.size else np.zeros(5)
    return {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": camera.name,
        "camera_matrix": matrix(camera.matrix),
        "distortion_model": "rational_polynomial" if distortion.size == 8 else "plumb_bob",
        "distortion_coefficients": matrix(distortion),
        "rectification_matrix": matrix(np.eye(3)),
        "projection_matrix": matrix(projection),
        "row_delay_s": float(camera.row_delay_s),
    }
