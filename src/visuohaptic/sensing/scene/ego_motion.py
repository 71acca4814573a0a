"""Motion of the platform fused from floor, odometry and gyroscope: a small Kalman filter (Alt 2016, Sec. 3.5).

State: velocity of the sensor frame's origin (v_x, v_y) [m/s] and turn rate omega [rad/s], driven by
random accelerations. Each source measures their mean over a frame: the floor all three, the
odometry forward speed and turn rate, the gyroscope the turn rate. The origin of frame F is
in front of the platform's centre, so that a rotation moves it sideways.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core import POSITIVE, BaseState, Motion, Ranged, Reason, compose_2d
from .floor_motion import compose_covariance


@dataclass(frozen=True, slots=True)
class EgoMotionSettings(Ranged):
    """Uncertainties of the sources."""

    foam_ahead_m: float = 0.17  #: origin of frame F in front of the platform's centre
    #: standard deviation of the platform's acceleration
    acceleration_m_s2: float = field(default=1.0, metadata=POSITIVE)
    turn_acceleration_rad_s2: float = 4.0
    #: standard deviation of the odometry's speed
    odometry_m_s: float = field(default=0.003, metadata=POSITIVE)
    odometry_fraction: float = 0.02  #: and its part that is proportional to the speed (slip, wheel size)
    side_slip_m_s: float = 0.002  #: lateral speed that wheels allow
    odometry_rad_s: float = 0.01
    gyroscope_rad_s: float = field(default=0.005, metadata=POSITIVE)
    gate: float = 5.0  #: a source that deviates by more than this many standard deviations is ignored


class EgoMotionFilter:
    """Fuses the floor motion from the camera with odometry and gyroscope, each of which may be missing.

    Parameters
    ----------
    settings
        Standard deviations of the sources; defaults if None.

    Attributes
    ----------
    pose, pose_covariance
        (x, y, theta) of frame F since the start [m, rad].
    agree
        Whether all sources of the newest frame agreed; false during wheel slip.

    Examples
    --------
    >>> ego = EgoMotionFilter()
    >>> for i in range(31):
    ...     motion = ego.update(i / 30, odometry=BaseState(i / 30, 0, 0, 0, 0.1, 0.0))
    >>> round(float(ego.pose[0]), 2)
    0.1
    """

    def __init__(self, settings: EgoMotionSettings | None = None) -> None:
        self.settings = settings or EgoMotionSettings()
        self.pose: Float[np.ndarray, "3"] = np.zeros(3)
        self.pose_covariance: Float[np.ndarray, "3 3"] = np.zeros((3, 3))
        self.velocity: Float[np.ndarray, "3"] = np.zeros(3)
        self.covariance: Float[np.ndarray, "3 3"] = np.diag([1.0, 1.0, 4.0])
        self.agree = True
        self._t_s = math.nan

    def update(
        self,
        t_s: float,
        *,
        floor: Motion | None = None,
        odometry: BaseState | None = None,
        gyroscope_rad_s: float | None = None,
    ) -> Motion:
        """Motion since the last call; not valid without any source.

        Parameters
        ----------
        t_s
            Time of the frame [s].
        floor
            Motion from the camera since then; ignored if not valid.
        odometry
            Newest state of the base; its velocities are used.
        gyroscope_rad_s
            Turn rate, counter-clockwise.
        """
        if not math.isnan(self._t_s) and not t_s > self._t_s:
            return Motion(t_s, False, Reason.STALE, np.zeros(2), 0.0, np.full((3, 3), np.inf))
        if math.isnan(self._t_s):
            self._t_s = t_s
            return Motion(t_s, False, Reason.NOT_ZEROED, np.zeros(2), 0.0, np.full((3, 3), np.inf))
        dt, s = t_s - self._t_s, self.settings
        self._t_s = t_s
        change = np.array([s.acceleration_m_s2, s.acceleration_m_s2, s.turn_acceleration_rad_s2]) * dt
        self.covariance = self.covariance + np.diag(change**2)
        used, self.agree = False, True
        if odometry is not None:
            ahead = np.array([[1.0, 0, 0], [0, 1.0, -s.foam_ahead_m], [0, 0, 1.0]])
            sigma = np.hypot(s.odometry_m_s, s.odometry_fraction * odometry.speed_m_s)
            noise = np.diag([sigma, s.side_slip_m_s, s.odometry_rad_s]) ** 2
            used |= self._measure(np.array([odometry.speed_m_s, 0.0, odometry.turn_rate_rad_s]), ahead, noise)
        if gyroscope_rad_s is not None:
            turn = np.array([[0.0, 0.0, 1.0]])
            used |= self._measure(np.array([gyroscope_rad_s]), turn, np.array([[s.gyroscope_rad_s**2]]))
        if floor is not None and floor.valid:
            # The chord of a uniform rotation has the mean of both headings.
            half = compose_2d((0.0, 0.0, -0.5 * floor.rotation_rad), (*floor.translation_m, 0.0))
            rate = np.array([half[0], half[1], floor.rotation_rad]) / dt
            used |= self._measure(rate, np.eye(3), floor.covariance / dt**2, trusted=True)
        return self._move(t_s, dt, used)

    def _measure(
        self, value: np.ndarray, design: np.ndarray, noise: np.ndarray, *, trusted: bool = False
    ) -> bool:
        """One update; if a source with priority disagrees, the state is reset; others are ignored."""
        innovation = value - design @ self.velocity
        spread = design @ self.covariance @ design.T + noise
        if float(innovation @ np.linalg.solve(spread, innovation)) > len(value) * self.settings.gate**2:
            self.agree = False
            if not trusted:
                return False
            self.velocity, self.covariance = value.copy(), noise.copy()
            return True
        gain = self.covariance @ design.T @ np.linalg.inv(spread)
        self.velocity = self.velocity + gain @ innovation
        rest = np.eye(3) - gain @ design
        # Joseph's form stays symmetric and positive definite.
        self.covariance = rest @ self.covariance @ rest.T + gain @ noise @ gain.T
        return True

    def _move(self, t_s: float, dt: float, used: bool) -> Motion:
        way = self.velocity * dt
        moved = np.array(compose_2d((0.0, 0.0, 0.5 * way[2]), (way[0], way[1], 0.5 * way[2])))
        covariance = self.covariance * dt**2
        self.pose_covariance = compose_covariance(self.pose, self.pose_covariance, moved, covariance)
        self.pose = np.array(compose_2d(self.pose, moved))
        reason = Reason.OK if used else Reason.LOST
        return Motion(t_s, used, reason, moved[:2], float(moved[2]), covariance)
