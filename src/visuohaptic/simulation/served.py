"""Simulated worlds for :func:`visuohaptic.io.remote.start_robot`: each function returns the parts of the robot.

Ground truth stays in the world's process; the robot's side receives only the given arguments.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..io.maps.occupancy_map import OccupancyMap
from .floor import FloorLaser, FloorObject, FloorSenses, FloorWorld
from .houses.house import FINER
from .tabletop import DeformableContainer, KitchenTable


def floor(
    map: str, start_m: Sequence[float], objects: Sequence[dict[str, Any]] = (), seed: int = 0
) -> dict[str, Any]:
    """A round platform on a floor with sliding objects.

    Parameters
    ----------
    map
        Map file; occupied cells are walls.
    start_m
        Pose of the platform: x, y [m], heading [rad].
    objects
        Fields of :class:`~visuohaptic.simulation.floor.FloorObject`.
    seed
        Seed of the sensor errors.
    """
    items = [FloorObject(**{**one, "footprint_m": np.array(one["footprint_m"])}) for one in objects]
    walls = OccupancyMap.load(map)
    world, fine = FloorWorld(walls, items, start_m), np.kron(walls.cells, np.ones((FINER, FINER), np.int8))
    scanned = OccupancyMap(fine, walls.resolution_m / FINER, walls.origin)
    return {
        "base": world.base,
        "senses": FloorSenses(world, np.random.default_rng(seed)),
        "laser": FloorLaser(world, scanned, np.random.default_rng([seed, 1])),
        "wait": world.step,
    }


def kitchen(
    stiffness_N_per_m: float = 3000.0, radius_m: float = 0.035, height_m: float = 0.2, seed: int = 0
) -> dict[str, Any]:
    """An arm with a gripper at a table, and a container between its fingers.

    Parameters
    ----------
    stiffness_N_per_m
        Stiffness of the container's wall, the same everywhere.
    radius_m, height_m
        Dimensions of the container.
    seed
        Seed of the errors of arm and sensors.
    """
    heights_m, depths_m = np.linspace(0.0, height_m, 3), np.linspace(0.0, 0.02, 25)
    force_N = stiffness_N_per_m * np.ones((3, 1)) * depths_m
    container = DeformableContainer("container", heights_m, np.full(3, radius_m), depths_m, force_N)
    table = KitchenTable(container, np.random.default_rng(seed))

    def wait(duration_s: float) -> None:
        for _ in range(max(1, round(duration_s * table.frame_rate_Hz))):
            table.advance(1.0 / table.frame_rate_Hz)

    return {
        "arm": table.arm,
        "gripper": table,
        "camera": table,
        "feel": table.feel,
        "weigh": table.weigh,
        "wait": wait,
    }
