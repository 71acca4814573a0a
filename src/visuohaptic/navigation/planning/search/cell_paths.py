"""Paths over the cells of a layer, and points along them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32, Int16, Int32

from .push_states import END_SLACK, seed_cells
from .search_domain import SearchDomain

__all__ = ["cheapest_cells", "resampled"]


def cheapest_cells(
    domain: SearchDomain,
    clearance: Float32[np.ndarray, "r c"],
    start: Float[np.ndarray, "2"],
    goal: Float[np.ndarray, "2"],
    block: int,
    field: tuple[Int32[np.ndarray, "k"], Int32[np.ndarray, "n"]] | None = None,
    labels: Int16[np.ndarray, "r c"] | None = None,
) -> tuple[Float[np.ndarray, "k 2"], float]:
    """Columns and rows of the cheapest path over a layer and its cost [nodes at full speed]; empty without one.

    Parameters
    ----------
    domain
        Radius and speeds of the robot, passages.
    clearance
        The layer [cells].
    start, goal
        From its corner [cells].
    block
        Edge of a node [cells].
    field
        Nodes that the path begins at, and costs from there [units], where they are known.
    labels
        Of passages on the layer.
    """
    from ._push_search_kernels import descend
    from ._travel_kernels import FAR, UNITS, clearance_at, travel_field

    radius, slow = domain.radius, domain.slow
    cells, costs = seed_cells(clearance, start, radius, slow, UNITS, reach=1 if block > 1 else 2, block=block)
    ends, end_costs = seed_cells(clearance, goal, radius, slow, UNITS, reach=1, block=block)
    if block == 1 and field is None:
        cells, costs = _straight(domain, clearance, start, cells, costs)
        ends, end_costs = _straight(domain, clearance, goal, ends, end_costs)
        if clearance_at(clearance, *goal) < domain.radius - END_SLACK:
            return np.zeros((0, 2)), float("inf")
    none = np.zeros(0, np.int32)
    if not cells.size or not ends.size:
        return np.zeros((0, 2)), float("inf")
    if field is None:
        region, charge = (
            (np.zeros((0, 0), np.int16), none) if labels is None else (labels, domain.charges(block))
        )
        cost = travel_field(clearance, radius, slow, cells, costs, region, charge, none, 0, ends)
    else:
        cells, cost = field
    total = cost[ends].astype(np.int64) + end_costs
    if total.min() >= FAR:
        return np.zeros((0, 2)), float("inf")
    path = descend(cost, clearance, cells, int(ends[int(total.argmin())]))
    return path, float(total.min()) / UNITS


def _straight(
    domain: SearchDomain,
    clearance: Float32[np.ndarray, "r c"],
    point: Float[np.ndarray, "2"],
    cells: Int32[np.ndarray, "k"],
    costs: Int32[np.ndarray, "k"],
) -> tuple[Int32[np.ndarray, "k"], Int32[np.ndarray, "k"]]:
    """Those cells beside a point that are reached from it straight and clear of everything.

    All of them where the robot does not fit at the point itself, as where it starts too near to something.
    """
    from ._travel_kernels import clearance_at, segment_cost

    if clearance_at(clearance, *point) < domain.radius:
        return cells, costs

    columns = clearance.shape[1]
    clear = [
        np.isfinite(
            segment_cost(
                clearance,
                domain.radius,
                domain.slow,
                *point,
                cell % columns + 0.5,
                cell // columns + 0.5,
                False,
            )
        )
        for cell in cells.tolist()
    ]
    return cells[clear], costs[clear]


def resampled(path: Float[np.ndarray, "k 2"], count: int) -> Float[np.ndarray, "n 2"]:
    """The corners of a path and about ``count`` points between them, evenly along it.

    Parameters
    ----------
    path
        Its corners.
    count
        Of the points, about.
    """
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    places = np.union1d(along, np.linspace(0.0, along[-1], max(count - len(path), 2)))
    return np.column_stack([np.interp(places, along, path[:, axis]) for axis in (0, 1)])
