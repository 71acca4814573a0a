"""A platform that is led through a house: what it perceives of it are odometry that drifts, and laser scans."""

from __future__ import annotations

import math

import numpy as np

from ...core.geometry import compose_2d
from ...core.laser_scan import LaserScan
from ...core.robots import BaseState, MobileBase
from ...io.maps.occupancy_map import OccupancyMap
from ..mobile.laser import SimulatedLaser
from ..mobile.odometry import DriftingBase
from .house import House

__all__ = ["LedPlatform"]

#: Of a platform on its way [m/s].
SPEED_M_S = 0.3


class LedPlatform(MobileBase):
    """Where it is led it goes, exactly; what it knows of that are :meth:`odometry` and :meth:`scan`.

    Parameters
    ----------
    house
        Walls, and errors of the odometry.
    pose
        Where it truly is at first: x, y [m], heading [rad].
    rng
        Of the odometry's errors.
    laser_rng
        Of the laser's noise.
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
        """What the laser sees from now on.

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
            Ahead, to the left [m], turn [rad].
        """
        self.pose = compose_2d(self.pose, step)
        self.t_s += max(math.hypot(step[0], step[1]) / SPEED_M_S, 1e-3)
        self._drifting.state()

    def odometry(self) -> tuple[float, float, float]:
        """Where the wheels say that it is."""
        state = self._drifting.state()
        return state.x_m, state.y_m, state.heading_rad

    def scan(self) -> LaserScan:
        """What the laser sees from where it truly is."""
        return self._laser.scan(self.pose, self.t_s)

    def drive(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """It is led, and does not drive."""

    def stop(self) -> None:
        """It stands."""

    def state(self) -> BaseState:
        """Where it truly is."""
        return BaseState(self.t_s, *self.pose, 0.0, 0.0)
