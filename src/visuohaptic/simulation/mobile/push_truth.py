"""Ground truth of a simulated push: obstacles, platform and foam at one time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ..foam.strip import StripState


@dataclass(frozen=True, slots=True, eq=False)
class BodyTruth:
    """One movable obstacle at one time, in the world."""

    name: str
    x_m: float
    y_m: float
    yaw_rad: float
    tilt_rad: float  #: between its axis and the vertical
    velocity_m_s: Float[np.ndarray, "2"]
    turn_rate_rad_s: float
    force_foam_N: Float[np.ndarray, "2"]  #: of the foam on it, frame F


@dataclass(frozen=True, slots=True, eq=False)
class PushTruth:
    """Ground truth at one time."""

    t_s: float
    load_N: float  #: integral of the foam's pressure, measured by Eq. (3.1)
    force_foam_N: Float[np.ndarray, "2"]  #: of the foam on all bodies, frame F
    strip: StripState
    bodies: tuple[BodyTruth, ...]  #: movable obstacles
    force_on: dict[str, float]  #: magnitude of the foam's force by obstacle, for those in contact
    platform_pose: tuple[float, float, float]  #: (x [m], y [m], heading [rad])
    platform_velocity: tuple[float, float, float]  #: (forward, left [m/s], turn rate [rad/s])
    drive_N: float  #: forward force of the drive

    def body(self, name: str) -> BodyTruth:
        """The movable obstacle of a name.

        Parameters
        ----------
        name
            Name of a movable obstacle.

        Raises
        ------
        InputError
            There is no movable obstacle of this name.
        """
        for body in self.bodies:
            if body.name == name:
                return body
        raise InputError("PushTruth.body", f"found {name!r}, expected one of {[b.name for b in self.bodies]}")
