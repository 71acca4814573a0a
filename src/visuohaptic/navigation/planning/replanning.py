"""Update of the problem after a successful push (Alt 2016, Sec. 4.2.1)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...core import HapticTag, InputError, rotation_2d
from ...io.maps.occupancy_map import FREE, OCCUPIED, OccupancyMap
from ..grid.cost_grid import OBSTACLE_FROM
from ..problem.planning_problem import PlanningProblem
from .arrays import Point
from .object_cells import clear_cells, fill_cells
from .search.search_domain import grid_from_world


def after_push(
    problem: PlanningProblem, id: str, displacement_m: Point, robot_m: Point, *, turn_rad: float = 0.0
) -> PlanningProblem:
    """The problem after a successful push: footprint and map cells moved, counter of explorations incremented.

    Parameters
    ----------
    problem
        Problem before the push.
    id
        Object that was pushed.
    displacement_m
        Measured displacement of the object, not the planned one.
    robot_m
        Current position of the robot.
    turn_rad
        Rotation of the object about its centroid.
    """
    obj = next((obj for obj in problem.objects if obj.id == id), None)
    if obj is None:
        names = ", ".join(obj.id for obj in problem.objects) or "none"
        raise InputError("problem", f"has no object '{id}', there are: {names}", field="objects")
    tag = obj.tag or HapticTag()
    turned = rotation_2d(turn_rad).T
    aside_m = np.array(obj.friction_offset_m) @ turned
    covariance = obj.friction_covariance_m2
    if covariance is not None:
        (xx, xy), (_, yy) = turned.T @ np.array(covariance) @ turned
        covariance = (float(xx), float(xy)), (float(xy), float(yy))
    moved = replace(
        obj,
        friction_covariance_m2=covariance,
        footprint_m=(obj.footprint_m - obj.centre_m) @ turned + obj.centre_m + np.asarray(displacement_m),
        friction_offset_m=(float(aside_m[0]), float(aside_m[1])),
        tag=tag.updated(explored=tag.explored + 1, fixed=False),
    )
    grid = problem.map
    blocked = grid.cells.view(np.uint8) >= OBSTACLE_FROM  # unknown cells, too
    walls = blocked.copy()
    clear_cells(walls, (grid_from_world(grid, other.footprint_m) for other in problem.objects))
    # Cells that it shared with its neighbours remain theirs.
    objects = tuple(moved if other.id == id else other for other in problem.objects)
    filled = np.zeros(grid.shape, dtype=bool)
    fill_cells(filled, *(grid_from_world(grid, other.footprint_m) for other in objects))
    cells = grid.cells.copy()
    cells[blocked & ~walls] = FREE
    cells[filled] = OCCUPIED
    return replace(
        problem,
        map=OccupancyMap(cells, grid.resolution_m, grid.origin),
        start_m=np.asarray(robot_m),
        start_yaw_rad=None,
        objects=objects,
    )
