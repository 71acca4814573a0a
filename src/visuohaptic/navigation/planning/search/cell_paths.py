"""Paths over the cells of a layer, and sampling of points along them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from ..arrays import Clearance, Field, Nodes, Path, Point, Shifts
from . import _travel_kernels
from ._push_search_kernels import descend
from ._travel_kernels import FAR, UNITS
from .search_domain import SearchDomain


def cheapest_cells(
    domain: SearchDomain,
    clearance: Clearance,
    start: Point,
    goal: Point,
    block: int,
    field: tuple[Nodes, Field] | None = None,
    beside: tuple[Shifts, Point] | None = None,
) -> tuple[Path, float]:
    """Columns and rows of the cheapest path over a layer and its cost [nodes at full speed]; empty without one.

    Parameters
    ----------
    domain
        Radius and speeds of the robot, passages.
    clearance
        The layer [cells].
    start, goal
        Start and goal from the layer's corner [cells].
    block
        Edge length of a node [cells].
    field
        Start nodes of the path and the costs from there [units], where known.
    beside
        Displacements of the bodies, and the layer's corner on the map: the path must then also be exactly collision-free
        from the start to its first cell and from its last cell to the goal.
    """

    radius, slow = domain.radius, domain.slow
    cells, costs = domain.seeds(clearance, start, reach=1 if block > 1 else 2, block=block)
    ends, end_costs = domain.seeds(clearance, goal, block=block)
    nowhere = np.zeros((0, 2)), float("inf")
    if beside is not None and cells.size and ends.size:
        shifts, low = beside
        columns = clearance.shape[1]
        first, last = (
            domain.clear_straight(
                shifts, point + low, np.column_stack([near % columns, near // columns]) + low + 0.5
            )
            for point, near in ((start, cells), (goal, ends))
        )
        cells, costs, ends, end_costs = cells[first], costs[first], ends[last], end_costs[last]
    none = np.zeros(0, np.int32)
    if not cells.size or not ends.size:
        return nowhere
    if field is None:
        # Around a known path, passages are not counted.
        labels = domain.labels(block) if beside is None else np.zeros((0, 0), np.int16)
        cost = _travel_kernels.travel_field(
            clearance, radius, slow, cells, costs, labels, domain.charges(block), none, 0, ends
        )
    else:
        cells, cost = field
    total = cost[ends].astype(np.int64) + end_costs
    if total.min() >= FAR:
        return nowhere
    path = descend(cost, clearance, cells, int(ends[int(total.argmin())]))
    return path, float(total.min()) / UNITS


def resampled(path: Path, count: int) -> Path:
    """The corners of a path and about ``count`` evenly spaced points between them.

    Parameters
    ----------
    path
        Corners of the path.
    count
        Approximate number of points.
    """
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    places = np.union1d(along, np.linspace(0.0, along[-1], max(count - len(path), 2)))
    return np.column_stack([np.interp(places, along, path[:, axis]) for axis in (0, 1)])


def unclear_steps(
    domain: SearchDomain, shifts: Shifts, clearance: Clearance, cells: Path, low: Int[np.ndarray, "2"]
) -> Int[np.ndarray, "n 2"]:
    """Cells (x, y) of a path that are reached by a diagonal step with insufficient clearance.

    Parameters
    ----------
    domain, shifts
        Static map and bodies, and the displacements of the bodies from their mapped positions [cells].
    clearance
        Clearance of the layer [cells].
    cells
        Cells of the path, from the layer's corner.
    low
        The layer's corner on the map (x, y) [cells].
    """
    places = cells.astype(int)
    clear = clearance[places[:, 1], places[:, 0]]
    diagonal = np.abs(np.diff(places, axis=0)).sum(axis=1) > 1
    # The middle of a diagonal step may be nearer to an obstacle's corner than both ends; other steps matter less.
    radius = domain.robot.radius_m / domain.map.resolution_m
    tight = np.flatnonzero(diagonal & (np.minimum(clear[1:], clear[:-1]) < np.hypot(radius, np.sqrt(0.5))))
    middle = cells + low + 0.5
    near = [
        k + 1 for k in tight.tolist() if not domain.clear_straight(shifts, middle[k], middle[k + 1][None])[0]
    ]
    return places[near]
