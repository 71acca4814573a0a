"""The ROS ``camera_info`` YAML file as a schema."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from ..errors import InputError


class _Matrix(BaseModel):
    model_config = ConfigDict(extra="forbid")
    rows: int  #: of the matrix
    cols: int  #: of the matrix
    data: Annotated[list[FiniteFloat], Field(max_length=64)]  #: elements, row-major

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
    image_width: Annotated[int, Field(gt=0)]  #: [px]
    image_height: Annotated[int, Field(gt=0)]  #: [px]
    camera_name: str = "camera"  #: any text
    camera_matrix: _Matrix  #: focal lengths and principal point [px], row-major
    distortion_model: Literal["plumb_bob", "rational_polynomial"] = "plumb_bob"  #: 5 or 8 coefficients
    distortion_coefficients: _Matrix | None = None  #: in OpenCV's order; None: no distortion
    row_delay_s: Annotated[float, Field(ge=0, allow_inf_nan=False)] = (
        0.0  #: rolling shutter: delay between rows [s]
    )
    #: mapping from light to grey levels
    transfer_function: Literal["linear", "srgb", "unknown"] = "unknown"
