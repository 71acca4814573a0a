"""Several rooms on a hallway, in place of the map of figure 4.1, with movable obstacles."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from ..io.maps.occupancy_map import OccupancyMap
from ..navigation.graph import Regions, assign_regions, build_graph
from ..navigation.grid.cost_grid import SpeedLimits, grid_layers
from ..navigation.problem.planning_problem import MovableObject
from ..rigs.virtual_office import BIN, ROBOT, STOOL, box, rooms, with_objects

#: Four movable obstacles; crate and stool are in doorways.
OBJECTS = (
    MovableObject("crate", box(7.15, 3.53, 0.5, 0.45), STOOL),
    MovableObject("stool", box(10.0, 5.45, 0.45, 0.45, 0.1), STOOL),
    MovableObject("bin", box(3.4, 1.6, 0.35), BIN),
    MovableObject("box", box(2.6, 7.3, 0.5, 0.4, 0.5), STOOL),
)


@cache
def building() -> OccupancyMap:
    """Seven rooms of a floor of 14 m x 9 m, a hallway of 1.8 m between them, fixed furniture."""
    t = 0.1
    south, north = 3.5, 5.4  # walls of the hallway
    walls = [
        # South side: doors at 1.5, 7.15 and 11.5.
        (0.0, south, 1.05, south + t), (1.95, south, 6.7, south + t), (7.6, south, 11.05, south + t),
        (11.95, south, 14.0, south + t),
        # North side: doors at 2.6, 6.3, 10.0 and 13.0.
        (0.0, north, 2.15, north + t), (3.05, north, 5.85, north + t), (6.75, north, 9.55, north + t),
        (10.45, north, 12.55, north + t), (13.45, north, 14.0, north + t),
        # Between the rooms.
        (4.6, 0.0, 4.6 + t, south), (9.3, 0.0, 9.3 + t, south),
        (4.4, north, 4.4 + t, 9.0), (8.1, north, 8.1 + t, 9.0), (11.9, north, 11.9 + t, 9.0),
        # Furniture and a pillar in the hallway.
        (0.0, 0.0, 1.6, 0.8), (2.9, 2.9, 4.6, 3.5), (4.7, 2.4, 5.4, 3.5), (8.0, 0.0, 9.3, 0.8),
        (10.0, 0.0, 11.6, 0.8), (13.2, 1.2, 14.0, 2.8), (0.0, 8.2, 1.4, 9.0), (3.4, 8.4, 4.4, 9.0),
        (5.8, 7.0, 7.0, 8.0), (8.2, 8.4, 10.1, 9.0), (12.8, 8.4, 14.0, 9.0), (4.5, 4.35, 4.75, 4.6),
    ]  # fmt: skip
    return rooms(14.0, 9.0, walls)


def regions_of(grid: OccupancyMap) -> Regions:
    """Layers, graph and regions for the platform of Sec. 4.4.

    Parameters
    ----------
    grid
        Map of the floor.
    """
    layers = grid_layers(grid, SpeedLimits(ROBOT.radius_m))
    return assign_regions(layers, build_graph(layers))


def outline(axes: Any, points_m: np.ndarray, **how: Any) -> None:
    """Draw a closed line.

    Parameters
    ----------
    axes
        Of matplotlib.
    points_m
        Corners (n, 2) [m].
    how
        Options of ``plot``.
    """
    axes.plot(*np.vstack([points_m, points_m[:1]]).T, **how)


def draw_map(axes: Any, grid: OccupancyMap) -> None:
    """Draw walls dark and free space white, in metres.

    Parameters
    ----------
    axes
        Of matplotlib.
    grid
        The map.
    """
    x, y, _ = grid.origin
    wide, high = grid.size_m
    shade = np.where(grid.cells >= 50, 0.35, np.where(grid.cells < 0, 0.85, 1.0))
    axes.imshow(shade, origin="lower", cmap="gray", vmin=0, vmax=1, extent=(x, x + wide, y, y + high),
                interpolation="nearest")  # fmt: skip
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.grid(visible=False)


def with_all() -> OccupancyMap:
    """The building with its four objects, as in the map of a robot."""
    return with_objects(building(), list(OBJECTS))
