"""Camera model: projection of points to pixels, and viewing rays of pixels.

Pixel convention (OpenCV, ROS): ``u = (x, y)``, x to the right, y down, the
centre of the first pixel is (0, 0).
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Float

from ..errors import InputError
from ..files import check_image_size, load_yaml_model, save_yaml
from ..ranges import NON_NEGATIVE, check_choice, check_numbers, finite_array
from .pose import Pose

#: Mapping from light to grey levels: linear, power of about 1 / 2.2, or unknown.
TransferFunction = Literal["linear", "srgb", "unknown"]

_log = logging.getLogger(__name__)

#: Focal length of a field of view of 137 degrees, in image widths: wider lenses have no distortion of this kind.
_WIDEST = 0.2
#: Rays that come back to another pixel are none: where there is an inverse, it is found to 1e-6 px [px].
_FOLDED_px = 0.5
#: Supported numbers of distortion coefficients and their ROS names.
_DISTORTION_MODELS = {0: "plumb_bob", 4: "plumb_bob", 5: "plumb_bob", 8: "rational_polynomial"}


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """Pinhole camera with lens distortion and rolling-shutter timing.

    Distortion coefficients are in OpenCV's order (k1, k2, p1, p2, k3 [, k4, k5, k6]),
    as in ``sensor_msgs/CameraInfo``.

    Examples
    --------
    >>> camera = Camera.simple(640, 480, focal_px=500.0)
    >>> camera.project(np.array([0.1, 0.0, 1.0])) - camera.project(np.array([0.0, 0.0, 1.0]))  # 10 cm at 1 m
    array([50.,  0.])
    """

    width: int  #: image width [px]
    height: int  #: image height [px]
    matrix: Float[np.ndarray, "3 3"]  #: intrinsic matrix K
    distortion: Float[np.ndarray, "coefficients"] = field(default_factory=lambda: np.zeros(5))
    row_delay_s: float = 0.0  #: time between the exposure of two rows; 0 = global shutter
    name: str = "camera"
    transfer_function: TransferFunction = (
        "unknown"  #: mapping from light to grey levels; srgb: any gamma of about 2.2
    )

    def __post_init__(self) -> None:
        matrix = finite_array("Camera", self.matrix, 3, 3, field="matrix")
        distortion = np.atleast_1d(np.asarray(self.distortion, dtype=np.float64))
        check_image_size("Camera", self.width, self.height, field="width, height")
        if matrix[0, 0] <= 0 or matrix[1, 1] <= 0 or not np.allclose(matrix[2], [0, 0, 1]):
            raise InputError(
                "Camera",
                f"found {matrix.tolist()}, expected positive focal lengths and last row 0 0 1",
                field="matrix",
            )
        if matrix[[0, 1], [1, 0]].any():
            raise InputError(
                "Camera",
                f"found {matrix.tolist()} with skew, expected 0: OpenCV's and ROS's models have none",
                field="matrix",
                remedy="calibrate without it",
            )
        if distortion.size not in _DISTORTION_MODELS or not np.isfinite(distortion).all():
            raise InputError(
                "Camera",
                f"found {distortion.tolist()}, expected 0, 4, 5 or 8 finite coefficients",
                field="distortion",
            )
        check_numbers("Camera", NON_NEGATIVE, row_delay_s=self.row_delay_s)
        known = get_args(TransferFunction)
        check_choice("Camera", known, self.transfer_function, field="transfer_function")
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "distortion", distortion)

    @classmethod
    def simple(cls, width: int, height: int, focal_px: float, **more: Any) -> Camera:
        """Ideal camera with square pixels and the principal point in the centre.

        Parameters
        ----------
        width, height
            Image size [px].
        focal_px
            Focal length of both axes [px].
        more
            Other fields of the camera, such as ``distortion`` or ``row_delay_s``.
        """
        matrix = np.array([[focal_px, 0, (width - 1) / 2], [0, focal_px, (height - 1) / 2], [0, 0, 1.0]])
        return cls(width, height, matrix, **more)

    @property
    def focal_px(self) -> float:
        """Geometric mean of both focal lengths [px]."""
        return float(np.sqrt(self.matrix[0, 0] * self.matrix[1, 1]))

    def check_size(self, where: str, width: int, height: int) -> None:
        """Reject images whose size is not that of this camera.

        Parameters
        ----------
        where
            Source of the images, for the message.
        width, height
            Size of an image [px].

        Raises
        ------
        InputError
            The size differs from the camera's.
        """
        if (self.width, self.height) != (width, height):
            raise InputError(
                where,
                f"found images of {width} x {height}, expected {self.width} x {self.height} "
                f"of the camera {self.name!r}",
            )

    def project(self, points_camera_m: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 2"]:
        """Project points from the camera frame to pixels.

        Parameters
        ----------
        points_camera_m
            Points (x right, y down, z forward), shape (..., 3) [m].

        Returns
        -------
        array
            Pixels (x, y), shape (..., 2) [px]; NaN for points at or behind the camera.
        """
        import cv2

        points = np.asarray(points_camera_m, dtype=np.float64)
        flat = np.ascontiguousarray(points.reshape(-1, 3))
        visible = flat[:, 2] > 1e-9
        pixels = np.full((len(flat), 2), np.nan)
        if visible.any():
            found, _ = cv2.projectPoints(
                flat[visible], np.zeros(3), np.zeros(3), self.matrix, self.distortion
            )
            pixels[visible] = found.reshape(-1, 2)
        return pixels.reshape(*points.shape[:-1], 2)

    def rays(self, pixels: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 3"]:
        """Viewing rays ``u' = K^-1 u`` of undistorted pixels, scaled to z = 1.

        Parameters
        ----------
        pixels
            Pixels (x, y), shape (..., 2) [px].

        Returns
        -------
        array
            Directions in the camera frame, shape (..., 3), with z = 1.
        """
        pixels = np.asarray(pixels, dtype=np.float64)
        flat = np.ascontiguousarray(pixels.reshape(-1, 2))
        result = np.ones((len(flat), 3))
        if not self.distortion.any():
            result[:, :2] = (flat - self.matrix[:2, 2]) / self.matrix[[0, 1], [0, 1]]
        elif len(flat):
            import cv2

            # OpenCV's default of 5 iterations leaves up to 0.1 px at the corners of a wide lens.
            criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
            found = cv2.undistortPoints(
                flat.reshape(-1, 1, 2), self.matrix, self.distortion, None, None, None, criteria
            )
            result[:, :2] = found.reshape(-1, 2)
        return result.reshape(*pixels.shape[:-1], 3)

    def row_time_s(
        self, frame_time_s: float, rows: Float[np.ndarray, "*batch"]
    ) -> Float[np.ndarray, "*batch"]:
        """Exposure times of image rows.

        Parameters
        ----------
        frame_time_s
            Timestamp of the frame: time of its first row [s].
        rows
            Row numbers from the top, integer or fractional, any shape [px].

        Returns
        -------
        array
            Times, same shape as ``rows`` [s].
        """
        return frame_time_s + np.asarray(rows) * self.row_delay_s

    @classmethod
    def load(cls, path: Path | str) -> Camera:
        """Read a ROS ``camera_info`` YAML file (the format of ``camera_calibration``).

        The optional extension fields ``row_delay_s`` and ``transfer_function`` are read if present.

        Parameters
        ----------
        path
            ``camera.yaml`` or any camera_info file.

        Raises
        ------
        InputError
            Names the file and field, what was found, and what was expected.
        """
        from ._camera_info import CameraInfoFile

        info = load_yaml_model(path, CameraInfoFile)
        coefficients = info.distortion_coefficients
        try:
            found = cls(
                info.image_width,
                info.image_height,
                info.camera_matrix.array("camera_matrix", (3, 3)),
                np.zeros(5)
                if coefficients is None
                else coefficients.array("distortion_coefficients").ravel(),
                info.row_delay_s,
                info.camera_name,
                info.transfer_function,
            )
        except InputError as error:
            raise InputError(path, error.problem, field=error.field) from error
        for doubt in found._doubts():
            _log.warning("%s: %s", path, doubt)
        return found

    def _doubts(self) -> list[str]:
        """What a calibration for images of another size, in millimetres, or of too few corners, looks like."""
        (x, y), size = self.matrix[:2, 2], f"{self.width} x {self.height}"
        doubts = []
        if not (0 <= x < self.width and 0 <= y < self.height):
            doubts.append(
                f"camera_matrix: its principal point ({x:.4g}, {y:.4g}) is outside of {size}; is it of another size?"
            )
        if self.focal_px < _WIDEST * self.width:
            doubts.append(
                f"camera_matrix: its focal length is {self.focal_px:.3g} px on {size}; is it in millimetres?"
            )
        across, down = (np.linspace(0, length - 1, 9) for length in (self.width, self.height))
        border = np.array(
            [(u, v) for v in down for u in across if u in across[[0, -1]] or v in down[[0, -1]]]
        )
        off_px = float(np.nanmax(np.abs(self.project(self.rays(border)) - border)))
        if off_px > _FOLDED_px:
            doubts.append(
                f"distortion_coefficients: they have no inverse at the border of the image, where rays are {off_px:.0f} px off; "
                "calibrate with corners of the board there"
            )
        return doubts

    def save(self, path: Path | str) -> None:
        """Write a ROS ``camera_info`` YAML file.

        Parameters
        ----------
        path
            Output file; an existing file is replaced.
        """
        distortion = self.distortion if self.distortion.size else np.zeros(5)
        save_yaml(
            path,
            {
                "image_width": self.width,
                "image_height": self.height,
                "camera_name": self.name,
                "camera_matrix": _matrix_dict(self.matrix),
                "distortion_model": _DISTORTION_MODELS[distortion.size],
                "distortion_coefficients": _matrix_dict(distortion),
                "rectification_matrix": _matrix_dict(np.eye(3)),
                "projection_matrix": _matrix_dict(np.hstack([self.matrix, np.zeros((3, 1))])),
                "row_delay_s": float(self.row_delay_s),
                "transfer_function": self.transfer_function,
            },
        )

    @staticmethod
    def pose_of_view(eye_m: object, target_m: object, up: object = (0.0, 0.0, 1.0)) -> Pose:
        """``T_world_camera`` of a camera that looks at a given point.

        Parameters
        ----------
        eye_m
            Centre of projection in the world, shape (3,) [m].
        target_m
            Point at the centre of the view, in the world, shape (3,) [m].
        up
            World direction that points up in the image, shape (3,); not parallel to the viewing direction.
        """
        eye, target = np.asarray(eye_m, dtype=np.float64), np.asarray(target_m, dtype=np.float64)
        forward = (target - eye) / np.linalg.norm(target - eye)
        right = np.cross(forward, np.asarray(up, dtype=np.float64))
        right /= np.linalg.norm(right)
        return Pose(np.column_stack([right, np.cross(forward, right), forward]), eye)


def _matrix_dict(values: np.ndarray) -> dict[str, Any]:
    """A matrix in ``camera_info`` format; a vector as a single row."""
    rows, columns = np.atleast_2d(values).shape
    return {"rows": rows, "cols": columns, "data": [float(value) for value in values.ravel()]}
