"""Rigid transformations in 3D."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..errors import InputError
from ..geometry import so3_exp, so3_log


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Rigid transformation ``T_target_source``: ``x_target = R x_source + t``.

    Names contain both frames: ``T_camera_foam`` maps foam coordinates to the
    camera frame.

    Examples
    --------
    >>> T_world_camera = Pose.from_rotation_vector([0.0, 0.0, np.pi / 2], [1.0, 0.0, 0.0])
    >>> np.round(T_world_camera.apply(np.array([1.0, 0.0, 0.0])), 9)
    array([1., 1., 0.])
    >>> np.round((T_world_camera.inverse() @ T_world_camera).translation_m, 9) + 0.0
    array([0., 0., 0.])
    """

    rotation: Float[np.ndarray, "3 3"]  #: R, orthonormal, det +1
    translation_m: Float[np.ndarray, "3"]  #: t [m]

    def __post_init__(self) -> None:
        rotation = np.asarray(self.rotation, dtype=np.float64)
        translation = np.asarray(self.translation_m, dtype=np.float64)
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise InputError(
                "Pose", f"found shapes {rotation.shape} and {translation.shape}, expected (3, 3) and (3,)"
            )
        if not all(map(math.isfinite, translation.tolist())):
            raise InputError("Pose", f"translation {translation} is not finite")
        if not _is_rotation(rotation):
            raise InputError("Pose", "rotation is not orthonormal with determinant +1")
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation_m", translation)

    @classmethod
    def identity(cls) -> Pose:
        """The identity transformation."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_quaternion(cls, quaternion_xyzw: object, translation_m: object) -> Pose:
        """Pose from a quaternion in ROS order.

        Parameters
        ----------
        quaternion_xyzw
            Quaternion (x, y, z, w), shape (4,); need not be normalised.
        translation_m
            Translation, shape (3,) [m].

        Raises
        ------
        InputError
            The quaternion does not consist of 4 finite numbers, or is zero.
        """
        from scipy.spatial.transform import Rotation

        quaternion = np.asarray(quaternion_xyzw, dtype=np.float64)
        norm = np.linalg.norm(quaternion) if quaternion.shape == (4,) else 0.0
        if not (np.isfinite(norm) and norm > 1e-9):
            raise InputError(
                "Pose.from_quaternion", f"found {quaternion.tolist()}, expected 4 numbers x y z w, not all 0"
            )
        return cls(Rotation.from_quat(quaternion).as_matrix(), np.asarray(translation_m, dtype=np.float64))

    @classmethod
    def from_rotation_vector(cls, rotation_vector_rad: object, translation_m: object) -> Pose:
        """Pose from a rotation vector.

        Parameters
        ----------
        rotation_vector_rad
            Axis times angle, shape (3,) [rad].
        translation_m
            Translation, shape (3,) [m].
        """
        vector = np.asarray(rotation_vector_rad, dtype=np.float64)
        return cls(so3_exp(vector), np.asarray(translation_m, dtype=np.float64))

    @classmethod
    def from_matrix(cls, matrix: Float[np.ndarray, "4 4"]) -> Pose:
        """Pose from a homogeneous matrix.

        Parameters
        ----------
        matrix
            Matrix with rotation and translation [m], shape (4, 4) or (3, 4).
        """
        return cls(np.asarray(matrix)[:3, :3], np.asarray(matrix)[:3, 3])

    @property
    def matrix(self) -> Float[np.ndarray, "4 4"]:
        """Homogeneous matrix."""
        result = np.eye(4)
        result[:3, :3] = self.rotation
        result[:3, 3] = self.translation_m
        return result

    @property
    def quaternion_xyzw(self) -> Float[np.ndarray, "4"]:
        """Unit quaternion in ROS order (x, y, z, w), w >= 0."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_matrix(self.rotation).as_quat(canonical=True)

    @property
    def fields(self) -> dict[str, list[float]]:
        """Section of a configuration file: the arguments of :meth:`from_quaternion`, as plain numbers."""
        return {
            "translation_m": self.translation_m.tolist(),
            "quaternion_xyzw": self.quaternion_xyzw.tolist(),
        }

    def inverse(self) -> Pose:
        """``T_source_target``."""
        return Pose(self.rotation.T, -self.rotation.T @ self.translation_m)

    def __matmul__(self, other: Pose) -> Pose:
        """Composition: ``T_a_b @ T_b_c`` is ``T_a_c``."""
        return Pose(self.rotation @ other.rotation, self.rotation @ other.translation_m + self.translation_m)

    def apply(self, points_m: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Transform points from the source frame to the target frame.

        Parameters
        ----------
        points_m
            Points in the source frame, shape (..., 3) [m].

        Returns
        -------
        array
            The points in the target frame, shape (..., 3) [m].
        """
        return np.asarray(points_m) @ self.rotation.T + self.translation_m

    def angle_to(self, other: Pose) -> float:
        """Angle of the rotation from this orientation to another, 0 to pi [rad].

        Parameters
        ----------
        other
            Pose in the same target frame.
        """
        return float(np.linalg.norm(so3_log(self.rotation.T @ other.rotation)))

    def interpolated(self, other: Pose, fraction: float) -> Pose:
        """Pose on the straight path to another one, with uniform rotation about one axis.

        Parameters
        ----------
        other
            End of the path, in the same target frame.
        fraction
            Part of the path, 0 to 1.
        """
        turned = so3_exp(fraction * so3_log(self.rotation.T @ other.rotation))
        place_m = (1.0 - fraction) * self.translation_m + fraction * other.translation_m
        return Pose(self.rotation @ turned, place_m)


def _is_rotation(matrix: Float[np.ndarray, "3 3"]) -> bool:
    """Orthonormal to 1e-6, with determinant +1; in plain floats, which takes a fifth of the time of arrays."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    return (
        # NaN is not less than anything.
        abs(a * a + b * b + c * c - 1) < 1e-6
        and abs(d * d + e * e + f * f - 1) < 1e-6
        and abs(g * g + h * h + i * i - 1) < 1e-6
        and abs(a * d + b * e + c * f) < 1e-6
        and abs(a * g + b * h + c * i) < 1e-6
        and abs(d * g + e * h + f * i) < 1e-6
        and a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0
    )
