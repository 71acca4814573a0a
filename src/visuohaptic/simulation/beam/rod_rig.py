"""Templates on the simulated rod, seen by a camera: the setup of Alt 2016, Sec. 3.6.1 (beam)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ...core.camera.pose import Pose
from .rod import ElasticRod, RodState

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
