"""A laser scanner on the simulated floor: walls, and objects where they are now."""

from __future__ import annotations

import numpy as np

from ...core import LaserScan
from ...io.maps.occupancy_map import OccupancyMap
from ..mobile.laser import SimulatedLaser, with_outlines
from .floor_world import FloorWorld


class FloorLaser:
    """Scans from the true pose of the robot, which the scan does not contain.

    Parameters
    ----------
    world
        Robot and objects.
    walls
        Map of the walls, fine enough for the outlines of the objects.
    rng
        Source of noise and lost beams.
    """

    def __init__(self, world: FloorWorld, walls: OccupancyMap, rng: np.random.Generator) -> None:
        self._world, self._walls, self._rng = world, walls, rng

    def scan(self) -> LaserScan:
        """The scan at the present time."""
        outlines_m = [self._world.footprint_m(one.id) for one in self._world.objects]
        x, y, heading = map(float, self._world.pose_m())
        laser = SimulatedLaser(with_outlines(self._walls, outlines_m), None, self._rng)
        return laser.scan((x, y, heading), self._world.t_s)
