"""Costs of the places where pushed objects end: areas of the problem, and the routes of the navigation graph.

A cost belongs to a cell; an object has the largest one along its outline and at its centre.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool

from ...io.maps.occupancy_map import OCCUPIED, OccupancyMap
from ..graph.navigation_graph import build_graph
from ..grid.cost_grid import cell_distance, grid_layers
from ..problem.planning_problem import PlanningProblem
from .arrays import Clearance, Outline, Point, Shifts
from .object_cells import fill_cells
from .search.bodies import grid_from_world

if TYPE_CHECKING:
    from .search import Body, SearchDomain


def place_costs(
    problem: PlanningProblem,
    on_route_s: float,
    occupied: Bool[np.ndarray, "rows columns"],
    fixed: tuple[Outline, ...],
) -> Clearance | None:
    """Cost of an object that ends in each cell [s]; ``None`` if no place is better than another.

    Parameters
    ----------
    problem
        Map, robot and areas.
    on_route_s
        Cost of a place nearer than the robot's radius to an edge of the navigation graph among what does not move [s].
    occupied, fixed
        Occupied cells that are no objects, and outlines of what does not move [cells].
    """
    if not problem.areas and not on_route_s:
        return None
    costs = np.zeros(occupied.shape, np.float32)
    preferred = np.zeros(occupied.shape, dtype=bool)
    for area in problem.areas:
        inside = np.zeros(occupied.shape, dtype=bool)
        fill_cells(inside, grid_from_world(problem.map, area.outline_m))
        if area.prefer:
            preferred |= inside
        else:
            costs[inside] += area.cost_s
    outside_s = max((area.cost_s for area in problem.areas if area.prefer), default=0.0)
    costs[~preferred] += outside_s
    if on_route_s:
        static = occupied.copy()
        fill_cells(static, *fixed)
        grid = OccupancyMap(static.astype(np.int8) * OCCUPIED, problem.map.resolution_m, problem.map.origin)
        cells = build_graph(grid_layers(grid, problem.robot)).path_cells
        route = np.zeros(occupied.shape, dtype=bool)
        route[cells[:, 0], cells[:, 1]] = True
        reach = problem.robot.radius_m / problem.map.resolution_m
        costs[cell_distance(route, reach + 1.0, outside_blocks=False) < reach] += on_route_s
    return costs


def place_s(domain: SearchDomain, body: Body, shift: Point) -> float:
    """Cost of the place of a body [s].

    Parameters
    ----------
    domain
        Map with the costs.
    body
        The body.
    shift
        Its displacement from the mapped position [cells].
    """
    if domain.places is None:
        return 0.0
    rows, columns = domain.places.shape
    x, y = np.floor(np.concatenate([body.samples, body.centre[None]]) + shift).astype(int).T
    return float(domain.places[np.clip(y, 0, rows - 1), np.clip(x, 0, columns - 1)].max())


def places_s(domain: SearchDomain, shifts: Shifts) -> float:
    """Cost of the places of all bodies that were moved [s].

    Parameters
    ----------
    domain
        Map with the costs.
    shifts
        Displacements of the bodies from their mapped positions [cells].
    """
    if domain.places is None:
        return 0.0
    moved = np.flatnonzero(shifts.any(axis=1))
    return sum(place_s(domain, domain.bodies[k], shifts[k]) for k in moved.tolist())
