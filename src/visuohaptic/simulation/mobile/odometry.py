"""Odometry errors of a platform: wheel slip and gyroscope drift."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...core import BaseState, MobileBase, wrap_angle


@dataclass(frozen=True, slots=True)
class OdometryErrors:
    """Errors of odometry and IMU; standard deviations, sampled once per run unless stated otherwise."""

    scale: float = 0.01  #: of the distance driven, relative
    scale_turn: float = 0.003  #: of turns, relative (gyroscope)
    gyro_bias_rad_s: float = 1e-5  #: after zeroing at standstill
    walk_rad: float = 0.001  #: of the heading, per square root of a second of motion
    slip_m: float = 0.001  #: of the position along and across, per square root of a metre


class DriftingBase(MobileBase):
    """A ``robots.MobileBase`` whose state drifts from ground truth; commands are passed through.

    Both are equal at the start.

    Parameters
    ----------
    base
        Platform with exact odometry.
    rng
        Source of the errors.
    errors
        Their standard deviations.
    """

    def __init__(
        self, base: MobileBase, rng: np.random.Generator, errors: OdometryErrors | None = None
    ) -> None:
        self._base, self._rng = base, rng
        self.errors = errors or OdometryErrors()
        self._scale = 1.0 + self.errors.scale * float(rng.standard_normal())
        self._scale_turn = 1.0 + self.errors.scale_turn * float(rng.standard_normal())
        self._bias = self.errors.gyro_bias_rad_s * float(rng.standard_normal())
        self._true = self._reported = base.state()

    def drive(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """Set the velocities."""
        self._base.drive(speed_m_s, turn_rate_rad_s)

    def stop(self) -> None:
        """Stop."""
        self._base.stop()

    def state(self) -> BaseState:
        """Odometry with the accumulated errors."""
        true, last, reported = self._base.state(), self._true, self._reported
        dt = true.t_s - last.t_s
        if dt <= 0:
            return reported
        e, heading = self.errors, reported.heading_rad
        middle = 0.5 * (true.heading_rad + last.heading_rad)
        dx, dy = true.x_m - last.x_m, true.y_m - last.y_m
        ahead, left = (
            dx * math.cos(middle) + dy * math.sin(middle),
            dy * math.cos(middle) - dx * math.sin(middle),
        )
        way = math.hypot(ahead, left)
        slip = e.slip_m * math.sqrt(way) * self._rng.standard_normal(2)
        turn = wrap_angle(true.heading_rad - last.heading_rad)
        moving = way > 1e-6 or abs(turn) > 1e-6
        # A gyroscope is zeroed at standstill: it drifts only in motion.
        walk = (
            e.walk_rad * math.sqrt(dt) * float(self._rng.standard_normal()) + self._bias * dt
            if moving
            else 0.0
        )
        turned = self._scale_turn * turn + walk
        along, across = self._scale * ahead + slip[0], left + slip[1]
        mid = heading + 0.5 * turned
        self._true = true
        self._reported = BaseState(
            true.t_s,
            reported.x_m + along * math.cos(mid) - across * math.sin(mid),
            reported.y_m + along * math.sin(mid) + across * math.cos(mid),
            heading + turned,
            self._scale * true.speed_m_s,
            true.turn_rate_rad_s,
        )
        return self._reported
