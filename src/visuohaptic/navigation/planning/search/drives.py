"""Drives between pushes: over the lattice, along that on the map, and shortened by string pulling."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32, Int32

from .push_states import END_SLACK, PushStep, seed_cells
from .search_domain import SearchDomain, lower_clearance

__all__ = ["drives_exist", "pull_string"]


#: Points of a grid path that one straight segment may span.
STRING_WINDOW = 80
#: Corners are cut at most so many times.
STRING_ROUNDS = 12
#: ... of paths shorter than this [points]; those through a whole building are pulled piece by piece.
LONG_DRIVE = 1000


def pull_string(
    domain: SearchDomain,
    shifts: Float[np.ndarray, "bodies 2"],
    start: Float[np.ndarray, "2"],
    goal: Float[np.ndarray, "2"],
) -> tuple[Float[np.ndarray, "k 2"], float]:
    """Cheapest any-angle path between two points: over the lattice, along it on the map, then string pulling.

    Parameters
    ----------
    domain
        Static map and bodies.
    shifts
        Of the bodies from where the map has them [cells].
    start, goal
        Grid coordinates [cells].

    Returns
    -------
    corners in grid coordinates, cost [cells at full speed]; empty and infinite when there is none
    """
    from ._travel_kernels import string_pull

    if np.hypot(*(goal - start)) < 1e-9:
        return start[None], 0.0
    places = domain.drives.get((shifts.tobytes(), start.tobytes(), goal.tobytes()))
    # What only showed that a drive exists keeps no more room than it needs: good enough where it is long.
    if places is None or len(places) < LONG_DRIVE:
        found = _cells_on_map(domain, shifts, start, goal, domain.reach)
        if found is None:
            return np.zeros((0, 2)), float("inf")
        cells, clearance, low = found
    else:
        clearance, low = _window(domain, shifts, places // domain.block, domain.reach)
        cells = places - low
    cells = cells[:: domain.block] + 0.5
    path = np.concatenate([[start - low], cells, [goal - low]])
    radius, slow = domain.radius, domain.slow
    path, cost = _pulled(clearance, radius, slow, path)
    for _ in range(STRING_ROUNDS if len(cells) < LONG_DRIVE else 0):
        # The path over cells has eight directions only; chords between points along it cut its corners.
        kept, cost_now = string_pull(
            clearance, radius, slow, dense := _resampled(path, STRING_WINDOW), STRING_WINDOW
        )
        if not cost_now < cost:
            break
        gain = 1.0 - cost_now / cost
        path, cost = dense[kept], cost_now
        if gain < 1e-3:
            break
    distinct = np.ones(len(path), dtype=bool)
    distinct[1:] = np.hypot(*np.diff(path, axis=0).T) > 1e-9
    return path[distinct] + low, float(cost)


def drives_exist(
    domain: SearchDomain,
    steps: tuple[PushStep, ...],
    start: Float[np.ndarray, "2"],
    goal: Float[np.ndarray, "2"],
) -> bool:
    """Whether the drives of a plan exist on the map, where blocks are as clear as their clearest cell.

    Parameters
    ----------
    domain
        Static map and bodies.
    steps
        Pushes in order.
    start, goal
        Grid coordinates [cells].
    """
    at, shifts = start, np.zeros((len(domain.bodies), 2))
    for step in steps:
        if not _drive_exists(domain, shifts, at, step.approach):
            return False
        at, shifts = step.retreat, step.shifts_after
    return _drive_exists(domain, shifts, at, goal)


def _drive_exists(
    domain: SearchDomain,
    shifts: Float[np.ndarray, "bodies 2"],
    start: Float[np.ndarray, "2"],
    goal: Float[np.ndarray, "2"],
) -> bool:
    key = (shifts.tobytes(), start.tobytes(), goal.tobytes())
    if key not in domain.drives:
        found = _cells_on_map(domain, shifts, start, goal, domain.radius + 2.0)
        domain.drives[key] = None if found is None else found[0] + found[2]
    return domain.drives[key] is not None


def _cells_on_map(
    domain: SearchDomain,
    shifts: Float[np.ndarray, "bodies 2"],
    start: Float[np.ndarray, "2"],
    goal: Float[np.ndarray, "2"],
    reach: float,
) -> tuple[Float[np.ndarray, "k 2"], Float32[np.ndarray, "r c"], Float[np.ndarray, "2"]] | None:
    """Cells of a drive in a window of the map, the clearance there, and the cell (x, y) that it begins at."""
    import cv2

    blocks = _cheapest_cells(domain, domain.lattice_with(shifts), start, goal, domain.block)
    if not len(blocks):
        return None
    clearance, low = _window(domain, shifts, blocks, reach)
    if domain.block == 1:
        return blocks - low, clearance, low
    # Along the path over blocks, and two blocks beside it.
    low_block = (low / domain.block).astype(int)
    near = np.zeros((np.array(clearance.shape) // domain.block + 2).tolist(), np.uint8)
    near[tuple((blocks - low_block).astype(int).T[::-1])] = 1
    near = cv2.dilate(near, np.ones((5, 5), np.uint8))
    rows, columns = clearance.shape
    wide = near.repeat(domain.block, axis=0).repeat(domain.block, axis=1)[:rows, :columns]
    cells = _cheapest_cells(
        domain, np.where(wide > 0, clearance, np.float32(0.0)), start - low, goal - low, 1
    )
    return (cells, clearance, low) if len(cells) else None


def _cheapest_cells(
    domain: SearchDomain,
    clearance: Float32[np.ndarray, "r c"],
    start: Float[np.ndarray, "2"],
    goal: Float[np.ndarray, "2"],
    block: int,
) -> Float[np.ndarray, "k 2"]:
    """Columns and rows of the cheapest path over a layer, from start to goal; empty without one."""
    from ._travel_kernels import FAR, UNITS, clearance_at, travel_field

    radius, slow = domain.radius, domain.slow
    cells, costs = seed_cells(clearance, start, radius, slow, UNITS, reach=2, block=block)
    ends, end_costs = seed_cells(clearance, goal, radius, slow, UNITS, reach=1, block=block)
    if block == 1:
        cells, costs = _straight(domain, clearance, start, cells, costs)
        ends, end_costs = _straight(domain, clearance, goal, ends, end_costs)
        if clearance_at(clearance, *goal) < domain.radius - END_SLACK:
            return np.zeros((0, 2))
    none = np.zeros(0, np.int32)
    if not cells.size or not ends.size:
        return np.zeros((0, 2))
    cost, came = travel_field(
        clearance, radius, slow, cells, costs, np.zeros((0, 0), np.int32), none, none, 0, ends
    )
    total = cost[ends].astype(np.int64) + end_costs
    if total.min() >= FAR:
        return np.zeros((0, 2))
    cell = int(ends[int(total.argmin())])
    columns = clearance.shape[1]
    found = []
    while cell >= 0:
        found.append((cell % columns, cell // columns))
        cell = int(came[cell])
    return np.array(found[::-1], dtype=np.float64)


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


def _window(
    domain: SearchDomain,
    shifts: Float[np.ndarray, "bodies 2"],
    blocks: Float[np.ndarray, "k 2"],
    reach: float,
) -> tuple[Float32[np.ndarray, "r c"], Float[np.ndarray, "2"]]:
    """Clearance on the map around a path over blocks, up to ``reach``, and the cell (x, y) that it begins at."""
    block, (rows, columns) = domain.block, domain.clearance.shape
    grow = int(domain.reach / block) + 1
    low = np.maximum(blocks.min(axis=0).astype(int) - grow, 0) * block
    high = np.minimum((blocks.max(axis=0).astype(int) + 1 + grow) * block, (columns, rows))
    part = domain.clearance[low[1] : high[1], low[0] : high[0]].copy()
    for body, shift in zip(domain.bodies, shifts, strict=True):
        outline = body.outline + shift
        if (outline.max(axis=0) > low - reach).all() and (outline.min(axis=0) < high + reach).all():
            lower_clearance(part, outline - low, reach)
    return part, low.astype(np.float64)


def _pulled(
    clearance: Float32[np.ndarray, "r c"], radius: float, slow: float, path: Float[np.ndarray, "k 2"]
) -> tuple[Float[np.ndarray, "q 2"], float]:
    """A path pulled twice: a second look joins pieces that were cut by the window."""
    from ._travel_kernels import string_pull

    for _ in range(2):
        kept, cost = string_pull(clearance, radius, slow, path, STRING_WINDOW)
        path = path[kept]
    return path, float(cost)


def _resampled(path: Float[np.ndarray, "k 2"], count: int) -> Float[np.ndarray, "n 2"]:
    """The corners of a path and about ``count`` points between them, evenly along it."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    places = np.union1d(along, np.linspace(0.0, along[-1], max(count - len(path), 2)))
    return np.column_stack([np.interp(places, along, path[:, axis]) for axis in (0, 1)])
