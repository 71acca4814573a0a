"""A platform that is led through a house: perceives only drifting odometry and laser scans."""

from __future__ import annotations

import math

import numpy as np

from ...core import BaseState, LaserScan, MobileBase, compose_2d
from ...io.maps.occupancy_map import OccupancyMap
from ..mobile import DriftingBase, SimulatedLaser
from .house import House

#: Speed of the platform [m/s].
SPEED_M_S = 0.3


class GuidedPlatform(MobileBase):
    """Follows the lead exactly; perceives only :meth:`odometry` and :meth:`scan`.

    Parameters
    ----------
    house
        Walls, and errors of the odometry.
    pose
        True initial pose: x, y [m], heading [rad].
    rng
        Source of the odometry's errors.
    laser_rng
        Source of the laser's noise.
    """

    def __init__(
        self,
        house: House,
        pose: tuple[float, float, float],
        rng: np.random.Generator,
        laser_rng: np.random.Generator,
    ) -> None:
        self.t_s, self.pose = 0.0, pose
        self._drifting = DriftingBase(self, rng, house.odometry)
        self._laser_rng = laser_rng
        self.see(house.grid)

    def see(self, grid: OccupancyMap) -> None:
        """Set the world that the laser scans from now on.

        Parameters
        ----------
        grid
            The world as a map.
        """
        self._laser = SimulatedLaser(grid, None, self._laser_rng)

    def go(self, step: tuple[float, float, float]) -> None:
        """Move by a step in its own frame.

        Parameters
        ----------
        step
            Forward, to the left [m], rotation [rad].
        """
        self.pose = compose_2d(self.pose, step)
        self.t_s += max(math.hypot(step[0], step[1]) / SPEED_M_S, 1e-3)
        self._drifting.state()

    def odometry(self) -> tuple[float, float, float]:
        """Pose by odometry."""
        state = self._drifting.state()
        return state.x_m, state.y_m, state.heading_rad

    def scan(self) -> LaserScan:
        """Laser scan from the true pose."""
        return self._laser.scan(self.pose, self.t_s)

    def drive(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """Ignored: the platform is led and does not drive."""

    def stop(self) -> None:
        """Ignored: the platform stands."""

    def state(self) -> BaseState:
        """True pose."""
        return BaseState(self.t_s, *self.pose, 0.0, 0.0)
