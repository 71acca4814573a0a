"""Scenes for the planner's tests and benchmarks: figure 4.6 of the dissertation rebuilt, and random ones."""

from __future__ import annotations

import numpy as np

from visuohaptic.navigation.problem import MovableObject, PlanningProblem, RobotModel
from visuohaptic.objects import Estimate, HapticTag
from visuohaptic.recording import OccupancyMap

ROBOT = RobotModel(0.17)


def tag(**values: float | bool | int | None) -> HapticTag:
    """A tag from plain numbers, as in objects.yaml."""
    return HapticTag(
        **{
            name: Estimate(value, 0.0) if isinstance(value, float) else value  # type: ignore[arg-type]
            for name, value in values.items()
        }
    )


#: Table 4.1 of the dissertation, in its roles of figure 4.6.
STOOL = tag(static_friction_N=8.1, dynamic_friction_N=7.5, deformability=0.08, drift=0.03, explored=1)
TABLE = tag(static_friction_N=15.9, dynamic_friction_N=15.9, deformability=0.0, drift=0.03, explored=1)
TOWER = tag(static_friction_N=15.3, deformability=0.0, fixed=True, explored=1)
BIN = tag(static_friction_N=1.5, dynamic_friction_N=1.4, deformability=0.0, drift=0.03, explored=1)
FULL_BIN = tag(static_friction_N=6.5, dynamic_friction_N=6.1, deformability=0.0, drift=0.03, explored=1)


def box(x: float, y: float, width: float, depth: float | None = None, angle_rad: float = 0.0) -> np.ndarray:
    """Outline of a box about its centre."""
    half = np.array([width, width if depth is None else depth]) / 2
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half @ np.array([[c, s], [-s, c]]) + (x, y)


def with_objects(grid: OccupancyMap, objects: list[MovableObject]) -> OccupancyMap:
    """The map with every cell occupied whose centre is in an object, as a mapper would leave it."""
    from shapely import Polygon, contains_xy

    cells = grid.cells.copy()
    rows, columns = np.mgrid[0 : grid.shape[0], 0 : grid.shape[1]]
    centres = grid.world_from_cell(np.stack([rows, columns], axis=-1))
    for item in objects:
        cells[contains_xy(Polygon(item.footprint_m), centres[..., 0], centres[..., 1])] = 100
    return OccupancyMap(cells, grid.resolution_m, grid.origin)


def rooms(width_m: float, height_m: float, walls: list[tuple[float, float, float, float]]) -> OccupancyMap:
    """A closed room of 5 cm cells with walls given as x0, y0, x1, y1."""
    resolution_m = 0.05
    cells = np.zeros((round(height_m / resolution_m), round(width_m / resolution_m)), np.int8)
    cells[[0, -1]] = 100
    cells[:, [0, -1]] = 100
    for x0, y0, x1, y1 in walls:
        c0, r0, c1, r1 = (round(value / resolution_m) for value in (x0, y0, x1, y1))
        cells[r0:r1, c0:c1] = 100
    return OccupancyMap(cells, resolution_m)


def office(goal_m: tuple[float, float] = (2.45, 1.5)) -> PlanningProblem:
    """Figure 4.6: a stool in a gap, a table before a room, a tower that is fixed, bins that are in nobody's way."""
    grid = rooms(
        6.0,
        4.6,
        [
            (1.85, 0.0, 2.7, 0.45),  # the gap is from 0.45 to 1.25, the stool stands behind it
            (1.85, 1.25, 1.95, 3.7),
            (4.2, 2.6, 4.9, 2.7),  # the room in the top right, its door from 4.9 to 5.6
            (5.6, 2.6, 6.0, 2.7),
            (4.2, 2.6, 4.3, 4.6),
        ],
    )
    objects = [
        MovableObject("stool", box(2.22, 0.85, 0.35), STOOL),
        MovableObject("table", box(5.25, 2.4, 0.6, 0.4), TABLE),
        MovableObject("tower", box(3.2, 2.3, 0.2, 0.45), TOWER),
        MovableObject("bin", box(3.6, 0.4, 0.25), BIN),
        MovableObject("full bin", box(0.6, 3.4, 0.25), FULL_BIN),
    ]
    return PlanningProblem(
        with_objects(grid, objects), ROBOT, np.array([1.5, 0.9]), np.array(goal_m), tuple(objects)
    )


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
