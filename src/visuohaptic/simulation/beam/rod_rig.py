"""Templates on the simulated rod, seen by a camera: the setup of Alt 2016, Sec. 3.6.1 (beam)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core.camera.pose import Pose
from .rod import ElasticRod, RodState


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

#: A print that faces up along Z: its x along X, its y along -Y, its z (into the paper) along -Z.
_FACE_UP = Pose(np.diag([1.0, -1.0, -1.0]), np.zeros(3))


def _mounts() -> dict[str, tuple[float, Pose]]:
    # Not well aligned, and above the rod: the zero reference has to compensate both.
    return {
        "middle": (0.5, Pose.from_rotation_vector([0.02, -0.03, 0.05], [0.001, -0.002, 0.006]) @ _FACE_UP),
        "tip": (1.0, Pose.from_rotation_vector([-0.04, 0.02, -0.03], [-0.002, 0.001, 0.007]) @ _FACE_UP),
    }


@dataclass(frozen=True, slots=True, eq=False)
class RodRig:
    """A rod, a reference template on its base, templates along it, and a camera that looks along -Z."""

    rod: ElasticRod = field(default_factory=ElasticRod)
    #: pose of each template: xi, and its pose in the cross section at xi
    mounts: Mapping[str, tuple[float, Pose]] = field(default_factory=_mounts)
    reference: str = "reference"
    #: the reference template in the frame S of the sensor
    T_sensor_reference: Pose = field(
        default_factory=lambda: Pose.from_rotation_vector([0.0, 0.0, 0.1], [-0.04, 0.01, 0.004]) @ _FACE_UP
    )
    distance_m: float = 0.3  #: from the camera to the centre of the rod
    tilt_rad: float = 0.0  #: of the camera about the rod's axis

    @property
    def T_camera_sensor(self) -> Pose:
        """The camera above the rod: its x along X, its y along -Y, its axis along -Z."""
        c, s = math.cos(self.tilt_rad), math.sin(self.tilt_rad)
        look = np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]])
        rotation = np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]]) @ look
        middle = np.array([0.5 * self.rod.length_m, 0.0, 0.0])
        return Pose(rotation, np.array([0.0, 0.0, self.distance_m]) - rotation @ middle)

    def poses(self, state: RodState, T_camera_sensor: Pose | None = None) -> dict[str, Pose]:
        """``T_camera_template`` of every template, the reference first.

        Parameters
        ----------
        state
            Shape of the rod.
        T_camera_sensor
            Pose of the sensor in the camera frame; that of the rig by default.
        """
        view = self.T_camera_sensor if T_camera_sensor is None else T_camera_sensor
        found = {self.reference: view @ self.T_sensor_reference}
        for name, (xi, mount) in self.mounts.items():
            found[name] = view @ state.pose(xi) @ mount
        return found


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
