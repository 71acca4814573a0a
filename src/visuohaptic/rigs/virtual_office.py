"""Reconstruction of Figure 4.6 of the dissertation, with the haptic tags of its Table 4.1."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core import Estimate, HapticTag, rotation_2d, save_yaml, to_dict
from ..io.maps.occupancy_map import OccupancyMap
from ..navigation.problem.planning_problem import MovableObject, PlanningProblem, RobotModel

ROBOT = RobotModel(0.17)


def tag(**values: float | bool | int | None) -> HapticTag:
    """Create a tag from plain numbers, as in ``objects.yaml``.

    Parameters
    ----------
    values
        Fields of the tag; floats become estimates with unspecified uncertainty.
    """
    given: dict[str, Any] = {
        name: Estimate(value, 0.0) if isinstance(value, float) else value for name, value in values.items()
    }
    return HapticTag(**given)


#: Table 4.1 of the dissertation, for the roles of Figure 4.6.
STOOL = tag(static_friction_N=8.1, dynamic_friction_N=7.5, deformability=0.08, drift=0.03, explored=1)
TABLE = tag(static_friction_N=15.9, dynamic_friction_N=15.9, deformability=0.0, drift=0.03, explored=1)
TOWER = tag(static_friction_N=15.3, deformability=0.0, fixed=True, explored=1)
BIN = tag(static_friction_N=1.5, dynamic_friction_N=1.4, deformability=0.0, drift=0.03, explored=1)
FULL_BIN = tag(static_friction_N=6.5, dynamic_friction_N=6.1, deformability=0.0, drift=0.03, explored=1)


def box(
    x: float, y: float, width: float, depth: float | None = None, angle_rad: float = 0.0
) -> Float[np.ndarray, "4 2"]:
    """Outline of a box about its centre.

    Parameters
    ----------
    x, y
        Centre [m].
    width, depth
        Size [m]; a square by default.
    angle_rad
        Rotation [rad].
    """
    half = np.array([width, width if depth is None else depth]) / 2
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    out: np.ndarray = corners @ rotation_2d(angle_rad).T + (x, y)
    return out


def with_objects(grid: OccupancyMap, objects: list[MovableObject]) -> OccupancyMap:
    """Mark every cell whose centre is inside an object as occupied, like a mapping system.

    Parameters
    ----------
    grid
        Map of the building.
    objects
        Movable objects.
    """
    from shapely import Polygon, contains_xy

    cells = grid.cells.copy()
    rows, columns = np.mgrid[0 : grid.shape[0], 0 : grid.shape[1]]
    centres = grid.world_from_cell(np.stack([rows, columns], axis=-1))
    for item in objects:
        cells[contains_xy(Polygon(item.footprint_m), centres[..., 0], centres[..., 1])] = 100
    return OccupancyMap(cells, grid.resolution_m, grid.origin)


def rooms(width_m: float, height_m: float, walls: list[tuple[float, float, float, float]]) -> OccupancyMap:
    """A closed room of 5 cm cells with walls given as x0, y0, x1, y1.

    Parameters
    ----------
    width_m, height_m
        Size [m].
    walls
        Walls as (x0, y0, x1, y1) [m].
    """
    resolution_m = 0.05
    cells = np.zeros((round(height_m / resolution_m), round(width_m / resolution_m)), np.int8)
    cells[[0, -1]] = 100
    cells[:, [0, -1]] = 100
    for x0, y0, x1, y1 in walls:
        c0, r0, c1, r1 = (round(value / resolution_m) for value in (x0, y0, x1, y1))
        cells[r0:r1, c0:c1] = 100
    return OccupancyMap(cells, resolution_m)


def office(goal_m: tuple[float, float] = (2.45, 1.5)) -> PlanningProblem:
    """Figure 4.6: a stool in a gap, a table in front of a room, a fixed tower, and bins that block nothing.

    Parameters
    ----------
    goal_m
        Goal (x, y) [m].
    """
    grid = rooms(
        6.0,
        4.6,
        [
            (1.85, 0.0, 2.7, 0.45),  # the gap is from 0.45 to 1.25, the stool is behind it
            (1.85, 1.25, 1.95, 3.7),
            (4.2, 2.6, 4.9, 2.7),  # the room in the top right, its door from 4.9 to 5.6
            (5.6, 2.6, 6.0, 2.7),
            (4.2, 2.6, 4.3, 4.6),
        ],
    )
    objects = [
        MovableObject("stool", box(2.25, 0.85, 0.35), STOOL),
        MovableObject("table", box(5.25, 2.4, 0.6, 0.4), TABLE),
        MovableObject("tower", box(3.2, 2.3, 0.2, 0.45), TOWER),
        MovableObject("bin", box(3.6, 0.4, 0.25), BIN),
        MovableObject("full bin", box(0.6, 3.4, 0.25), FULL_BIN),
    ]
    return PlanningProblem(
        with_objects(grid, objects), ROBOT, np.array([1.5, 0.9]), np.array(goal_m), tuple(objects)
    )


def write_office_example(folder: Path | str) -> Path:
    """Write the office as input files of the plan verb: map, objects with their tags, robot.

    Parameters
    ----------
    folder
        Output folder.
    """
    folder, problem = Path(folder), office()
    folder.mkdir(parents=True, exist_ok=True)
    problem.map.save(folder / "office.yaml")
    objects = [
        {
            "id": item.id,
            "footprint_m": item.footprint_m.tolist(),
            "haptic_tag": {}
            if item.tag is None
            else {k: v for k, v in to_dict(item.tag).items() if v is not None},
        }
        for item in problem.objects
    ]
    save_yaml(folder / "objects.yaml", {"objects": objects})
    save_yaml(folder / "robot.yaml", to_dict(problem.robot))
    return folder
