"""Pose errors of a tracked template, as measured on rendered images of the rod."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from visuohaptic.core.camera import Pose


@dataclass(frozen=True, slots=True)
class PoseNoise:
    """Standard deviations of the pose of a planar template, in the axes of the camera."""

    lateral_m: float
    depth_m: float
    in_plane_rad: float
    tilt_rad: float

    @classmethod
    def of(cls, lateral_um: float, depth_um: float, in_plane_mdeg: float, tilt_mdeg: float) -> PoseNoise:
        """Convert from the units in which trackers are usually compared.

        Parameters
        ----------
        lateral_um, depth_um
            Standard deviation of the position across and along the optical axis [um].
        in_plane_mdeg, tilt_mdeg
            Standard deviation of the rotation about the optical axis and about the axes across it [mdeg].
        """
        mdeg = math.radians(1e-3)
        return cls(1e-6 * lateral_um, 1e-6 * depth_um, mdeg * in_plane_mdeg, mdeg * tilt_mdeg)

    @property
    def covariance(self) -> Float[np.ndarray, "6 6"]:
        """Standard deviations of (x, y, z, r_X, r_Y, r_Z) about the axes of the camera [m, rad]."""
        lateral, tilt = self.lateral_m, self.tilt_rad
        return np.diag(np.square([lateral, lateral, self.depth_m, tilt, tilt, self.in_plane_rad]))


#: Noise of a second-order template tracker on a 4 cm photo, f = 1800 px, image noise 5, tilt
#: 30 degrees, by distance [m]: measured on rendered images.
POSE_NOISE: Mapping[float, PoseNoise] = {
    0.2: PoseNoise.of(0.46, 4.9, 1.4, 3.5),
    0.3: PoseNoise.of(0.82, 13, 2.4, 6.2),
    0.6: PoseNoise.of(2.4, 84, 7, 17),
    1.2: PoseNoise.of(11, 539, 31, 77),
}


def noisy_pose(pose: Pose, covariance: Float[np.ndarray, "6 6"], rng: np.random.Generator) -> Pose:
    """A pose with an error of this covariance, in the axes of the target frame.

    Parameters
    ----------
    pose
        True pose.
    covariance
        Covariance (6, 6) of translation [m] and rotation vector [rad], in the axes of the target frame.
    rng
        Source of the noise.
    """
    error = rng.multivariate_normal(np.zeros(6), covariance, method="cholesky")
    turn = Pose.from_rotation_vector(error[3:], np.zeros(3)).rotation
    return Pose(turn @ pose.rotation, pose.translation_m + error[:3])
