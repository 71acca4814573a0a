"""Noise of depth cameras as a function of distance, with published constants."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError


@dataclass(frozen=True, slots=True)
class DepthNoise:
    """Standard deviation of a depth [m]: ``sqrt(sigma_k(z)^2 + tracking^2)``, Alt 2016, Eq. (5.1).

    ``sigma_k(z) = constant + quadratic (z - offset)^2``.
    """

    quadratic_per_m: float  #: coefficient of the squared depth [1/m]
    constant_m: float = 0.0  #: standard deviation at the offset [m]
    offset_m: float = 0.0  #: depth of minimum noise [m]
    tracking_m: float = 0.01  #: standard deviation of pose and calibration errors, sigma_t [m]
    baseline_m: float = 0.0  #: x of the projector or second eye in the camera frame; 0: none [m]
    baseline_known: bool = True  #: whether it is that of the camera, or to be inferred
    edge_rad: float = (
        0.0035  #: half the matching window, the angle around edges in which depths are mixed [rad]
    )
    source: str = ""  #: source of the constants

    def sigma_m(self, depth_m: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Standard deviation at depths [m].

        Parameters
        ----------
        depth_m
            Depths along the optical axis [m].
        """
        device = self.constant_m + self.quadratic_per_m * (np.asarray(depth_m) - self.offset_m) ** 2
        return np.sqrt(device**2 + self.tracking_m**2)

    def edge_px(self, focal_px: float) -> int:
        """Margin around depth edges in which readings are unreliable, at least one pixel [px].

        Parameters
        ----------
        focal_px
            Focal length [px].
        """
        return max(1, round(self.edge_rad * focal_px))

    def window_px(self, focal_px: float, stride: int = 1) -> float:
        """Width of the matching window, within which readings are correlated [px].

        Parameters
        ----------
        focal_px
            Focal length [px].
        stride
            Subsampling of the image: every n-th pixel of the camera is kept.
        """
        return (2 * self.edge_px(stride * focal_px) + 3) / stride


#: Noise models by the sensor name in ``sequence.yaml``.
SENSOR_NOISE: dict[str, DepthNoise] = {
    "kinect": DepthNoise(0.5 * 2.9e-3, baseline_m=0.075, source="Khoshelham 2012, as in Alt 2016, Eq. (5.1)"),
    "kinect_axial": DepthNoise(
        1.9e-3,
        constant_m=1.2e-3,
        offset_m=0.4,
        baseline_m=0.075,
        source="Nguyen, Izadi, Lovell 2012, Eq. (1)",
    ),
    # Stereo with a random pattern: z^2 x 0.08 px / (focal x baseline) at 848 px width and 50 mm.
    # Stereo matching extends foreground edges by half of its window, much more than a Kinect (2 of 580 px).
    "realsense_d435": DepthNoise(
        3.8e-3, baseline_m=0.05, edge_rad=0.0087, source="Intel, tuning guide of the D400 series"
    ),
    "simulated": DepthNoise(0.5 * 2.9e-3, baseline_m=0.075, source="simulation.depth_camera"),
}


def sensor_noise(name: str) -> DepthNoise:
    """Noise model of a camera by its name; common spellings are accepted.

    Parameters
    ----------
    name
        Name as in ``sequence.yaml``, for example ``kinect`` or ``Intel RealSense D435i``.

    Raises
    ------
    InputError
        The name is unknown.
    """
    plain = name.lower().replace("-", "_").replace(" ", "_")
    if plain in SENSOR_NOISE:
        return SENSOR_NOISE[plain]
    for part, known in (("435", "realsense_d435"), ("kinect", "kinect"), ("xtion", "kinect")):
        if part in plain:
            return SENSOR_NOISE[known]
    raise InputError("sensor_noise", f"found {name!r}, expected one of {', '.join(SENSOR_NOISE)}")
