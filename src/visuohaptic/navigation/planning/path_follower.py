"""Path following with a differential drive by Samson's control law at 50 Hz, slower where the clearance is small."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core import POSITIVE, BaseState, InputError, wrap_angle
from ..grid.cost_grid import SpeedLimits
from .arrays import Point


@dataclass(frozen=True, slots=True)
class FollowLimits(SpeedLimits):
    """Speeds, distances and gains of the control law."""

    radius_m: float = field(default=0.17, metadata=POSITIVE)
    turn_max_rad_s: float = field(default=1.2, metadata=POSITIVE)
    acceleration_m_s2: float = field(default=0.25, metadata=POSITIVE)  #: deceleration assumed for braking
    tolerance_m: float = field(default=0.02, metadata=POSITIVE)  #: of the goal
    corner_rad: float = 0.3  #: at sharper corners the robot stops and rotates
    offset_gain_per_m2: float = 30.0  #: k_e: turn rate per speed and cross-track error
    heading_gain_per_s: float = 3.0  #: k_theta: turn rate per heading error

    def speed_m_s(self, clearance_m: float) -> float:
        """Allowed speed [m/s] at a clearance: the inverse of the travel cost of Eq. (4.1).

        Parameters
        ----------
        clearance_m
            Distance to the nearest obstacle [m].
        """
        return float(1.0 / self.cost_s_per_m(np.array(max(clearance_m, self.radius_m))))


class PathFollower:
    """Path following by Samson's law: velocities from odometry, one call per period.

    The platform drives along straight segments and is steered by its cross-track
    error e and heading error theta, omega = -k_e v e sin(theta) / theta - k_theta theta
    (Samson 1992). It brakes before sharp corners and rotates there at standstill, so
    that it deviates from the path only by its tracking error; pure pursuit
    would cut corners.

    Parameters
    ----------
    path_m
        Corners of the path, in the frame of the odometry.
    limits
        Speeds and distances.
    clearance
        Distance to the nearest obstacle [m] at a point (x, y); unlimited by default.
    heading_rad
        Final heading at the goal.
    """

    def __init__(
        self,
        path_m: Float[np.ndarray, "k 2"],
        limits: FollowLimits | None = None,
        *,
        clearance: Callable[[Point], float] | None = None,
        heading_rad: float | None = None,
    ) -> None:
        path = np.asarray(path_m, dtype=np.float64)
        if path.ndim != 2 or path.shape[1] < 2 or len(path) < 1 or not np.isfinite(path).all():
            raise InputError(
                "PathFollower", f"found shape {path.shape}, expected finite corners k x 2", field="path_m"
            )
        path = path[:, :2]
        keep = np.concatenate([[True], np.hypot(*np.diff(path, axis=0).T) > 1e-6])
        self._path = path[keep]
        self._limits = limits if limits is not None else FollowLimits()
        self._clearance = clearance if clearance is not None else (lambda _: math.inf)
        self._heading_rad = heading_rad
        self._part = 0
        self._turning = True
        self.done = False

    @property
    def goal_m(self) -> Point:
        """End of the path."""
        return self._path[-1]

    @property
    def rest_m(self) -> Float[np.ndarray, "k 2"]:
        """Remaining corners of the path."""
        return self._path[min(self._part + 1, len(self._path) - 1) :]

    def command(self, state: BaseState) -> tuple[float, float]:
        """Forward speed [m/s] and turn rate [rad/s] for the next period; (0, 0) when done.

        Parameters
        ----------
        state
            Pose and speed by odometry.
        """
        if self.done:
            return 0.0, 0.0
        limits, place = self._limits, np.array([state.x_m, state.y_m])
        while self._part < len(self._path) - 1:
            begin, end = self._path[self._part], self._path[self._part + 1]
            ahead = (end - begin) / np.hypot(*(end - begin))
            rest = float((end - place) @ ahead)
            last = self._part == len(self._path) - 2
            corner = 0.0 if last else self._corner(self._part)
            stop = last or corner > limits.corner_rad
            if rest > (0.3 * limits.tolerance_m if stop else 0.01):
                return self._along(state, place - begin, ahead, rest, corner, stop)
            self._part += 1
            self._turning = self._turning or stop
        return self._arrived(state, place)

    def _along(
        self, state: BaseState, gone: Point, ahead: Point, rest: float, corner: float, stop: bool
    ) -> tuple[float, float]:
        limits, place = self._limits, np.array([state.x_m, state.y_m])
        error = wrap_angle(state.heading_rad - math.atan2(ahead[1], ahead[0]))
        if self._turning or abs(error) > 0.8:
            # Rotation at standstill; it ends well below the angle of a sharp corner.
            self._turning = abs(error) > 0.03
            if self._turning:
                return 0.0, self._turn(-error)
        side = ahead[0] * gone[1] - ahead[1] * gone[0]
        clear_m = (self._clearance(place), self._clearance(place + min(rest, 0.3) * ahead))
        speed = min(limits.speed_m_s(float(value)) for value in clear_m)
        if stop or corner > 0.05:  # stop at the goal and at sharp corners, slow down before others
            slowest = 0.02 if stop else limits.v_min_m_s
            speed = min(speed, max(math.sqrt(2.0 * limits.acceleration_m_s2 * max(rest, 0.0)), slowest))
        speed *= max(0.0, math.cos(error))
        sinc = math.sin(error) / error if abs(error) > 1e-6 else 1.0
        turn = -limits.offset_gain_per_m2 * speed * side * sinc - limits.heading_gain_per_s * error
        return speed, max(-limits.turn_max_rad_s, min(limits.turn_max_rad_s, turn))

    def _arrived(self, state: BaseState, place: Point) -> tuple[float, float]:
        limits = self._limits
        off = self._path[-1] - place
        away = float(np.hypot(*off))
        if away > limits.tolerance_m:
            # Ended beside the goal, after slip: drive straight to it, slowly.
            error = wrap_angle(math.atan2(off[1], off[0]) - state.heading_rad)
            speed = 0.0 if abs(error) > 0.2 else min(limits.v_min_m_s, max(away, 0.01))
            return speed, self._turn(error)
        if self._heading_rad is not None:
            error = wrap_angle(self._heading_rad - state.heading_rad)
            if abs(error) > 0.02:
                return 0.0, self._turn(error)
        self.done = True
        return 0.0, 0.0

    def _corner(self, part: int) -> float:
        """Angle between a segment and the next [rad]."""
        a, b = self._path[part + 1] - self._path[part], self._path[part + 2] - self._path[part + 1]
        return abs(wrap_angle(math.atan2(b[1], b[0]) - math.atan2(a[1], a[0])))

    def _turn(self, error: float) -> float:
        """Turn rate for an angle error ``error``; brakes in time."""
        limits = self._limits
        rate = min(limits.turn_max_rad_s, limits.heading_gain_per_s * abs(error))
        return math.copysign(max(rate, 0.03), error)
