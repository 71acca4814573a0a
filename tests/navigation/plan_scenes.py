"""Scenes for the planner's tests and benchmarks: figure 4.6 of the dissertation rebuilt, and random ones."""

from __future__ import annotations

import numpy as np

from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.problem import MovableObject, PlanningProblem, RobotModel
from visuohaptic.rigs import BIN, FULL_BIN, ROBOT, STOOL, TABLE, TOWER, box, office, rooms, tag, with_objects

__all__ = [
    "BIN", "FULL_BIN", "ROBOT", "STOOL", "TABLE", "TOWER",
    "box", "office", "random_scene", "rooms", "tag", "with_objects",
]  # fmt: skip


def random_scene(
    rng: np.random.Generator, objects: int, cells: int, resolution_m: float = 0.1
) -> PlanningProblem:
    """Two rooms with a door or two, boxes of 3 x 3 cells in or near the doors; robot of 1.5 cells."""
    grid = np.zeros((cells, cells), np.int8)
    grid[[0, -1]] = 100
    grid[:, [0, -1]] = 100
    wall = int(rng.integers(cells // 3, 2 * cells // 3))
    grid[:, wall] = 100
    doors = []
    for _ in range(int(rng.integers(1, 3))):
        at = int(rng.integers(2, cells - 7))
        grid[at : at + int(rng.integers(4, 7)), wall] = 0
        doors.append(at + 2)
    for _ in range(int(rng.integers(0, 5))):
        r, c = rng.integers(2, cells - 4, 2)
        grid[r : r + int(rng.integers(1, 4)), c : c + int(rng.integers(1, 4))] = 100
    robot = RobotModel(1.5 * resolution_m)
    items: list[MovableObject] = []
    for index in range(objects):
        for _ in range(100):
            r = int(np.clip(doors[index % len(doors)] + rng.integers(-2, 3), 2, cells - 3))
            c = int(np.clip(wall + rng.integers(-2, 3), 2, cells - 3))
            if not grid[r - 1 : r + 2, c - 1 : c + 2].any():
                grid[r - 1 : r + 2, c - 1 : c + 2] = 99
                centre = (np.array([c, r]) + 0.5) * resolution_m
                items.append(MovableObject(f"box {index}", box(*centre, 3 * resolution_m), STOOL))
                break
    grid[grid == 99] = 100
    from scipy.ndimage import distance_transform_edt

    free = distance_transform_edt(grid == 0) >= 2.0
    columns = np.arange(cells)[None, :]
    ends = []
    for side in (free & (columns < wall - 2), free & (columns > wall + 2)):
        places = np.argwhere(side)
        if not len(places):
            return random_scene(rng, objects, cells, resolution_m)
        r, c = places[int(rng.integers(len(places)))]
        ends.append((np.array([c, r]) + 0.5) * resolution_m)
    return PlanningProblem(OccupancyMap(grid, resolution_m), robot, ends[0], ends[1], tuple(items))
