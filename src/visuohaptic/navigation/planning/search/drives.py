"""Drives between pushes: search over the lattice, refinement on the map, and string pulling."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..arrays import Field, Nodes, Path, Point, Shifts
from ._push_search_kernels import largest_in_blocks
from ._travel_kernels import string_pull
from .cell_paths import cheapest_cells, resampled, unclear_steps
from .push_states import Deadline, PushStep
from .search_domain import Corridor, SearchDomain

#: Maximum number of points of a grid path that one straight segment may span.
STRING_WINDOW = 80
#: Maximum number of rounds of corner cutting.
STRING_ROUNDS = 12
#: Number of nodes of a lattice path that are refined on the map at once.
PIECE = 60


class _Drive(NamedTuple):
    """Start and goal of a drive, and the configuration of the bodies during it."""

    shifts: Shifts  #: displacements of the bodies from their mapped positions [cells]
    start: Point  #: grid coordinates [cells]
    goal: Point


def pull_string(
    domain: SearchDomain, shifts: Shifts, start: Point, goal: Point, deadline: Deadline | None = None
) -> tuple[Path, float]:
    """Cheapest any-angle path between two points: lattice search, refinement on the map, then string pulling.

    A long path is processed piece by piece; corners are cut from the middle of each piece to the middle of the next.

    Parameters
    ----------
    domain, shifts
        See :func:`~visuohaptic.navigation.planning.search.cell_paths.unclear_steps`.
    start, goal
        Grid coordinates [cells].
    deadline
        Corner cutting ends at this time.

    Returns
    -------
    corners in grid coordinates, and the cost of driving along them, from
    :meth:`~visuohaptic.navigation.planning.search.search_domain.SearchDomain.driving_cost`; empty and infinite without a path
    """
    nowhere = np.zeros((0, 2)), float("inf")
    if np.hypot(*(goal - start)) < 1e-9:
        return start[None], 0.0
    drive = _Drive(shifts, start, goal)
    block, nodes, *_ = _drive(domain, drive)
    if not len(nodes):
        return nowhere
    parts = [_pulled_piece(domain, *piece, block) for piece in _pieces(domain, drive, nodes, block)]
    if not all(len(part) for part in parts):
        return nowhere
    if len(parts) > 1:
        halves = [half for part in parts for half in _halved(part)]
        joined = [np.concatenate(pair) for pair in zip(halves[1:-1:2], halves[2::2], strict=True)]
        parts = [halves[0], *joined, halves[-1]]
    pulled = [_without_corners(domain, shifts, part, deadline) for part in parts]
    path = np.concatenate(pulled)
    path = path[np.concatenate([[True], np.hypot(*np.diff(path, axis=0).T) > 1e-9])]
    return path, domain.driving_cost(shifts, path)


def drives_cost(
    domain: SearchDomain,
    steps: tuple[PushStep, ...],
    start: Point,
    most: float = float("inf"),
    field: tuple[Nodes, Field] | None = None,
) -> float:
    """Cost of a plan's drives on the map [cells at full speed]; infinite if one of them does not exist there.

    Parameters
    ----------
    domain
        Static map and bodies.
    steps
        Pushes in order.
    start
        Grid coordinates [cells].
    most
        Costs from this one on count as infinite [cells at full speed].
    field
        Field of the last drive on the relaxed lattice: its start nodes and costs [units].
    """
    ends, goal = _ends(domain, steps, start), domain.goal
    if not domain.clear_straight(ends[-1].shifts, goal, goal[None])[0]:
        return float("inf")
    if field is not None:
        _over_lattice(domain, ends[-1], field)
    # Mostly a lower bound of the cost on the map; above it by up to a per cent where few nodes lead round a corner.
    if sum(_over_lattice(domain, end)[1] for end in ends) >= most:
        return float("inf")
    total = 0.0
    for end in ends:
        total += _drive(domain, end, complete=not (steps and np.isfinite(most)))[2]
        if total >= most:
            return float("inf")
    return total


def lattice_cost(domain: SearchDomain, steps: tuple[PushStep, ...], start: Point) -> float:
    """Cost of a plan's drives on the lattice [cells at full speed]; infinite if one is known not to exist on the map along it.

    Parameters
    ----------
    domain, steps, start
        See :func:`drives_cost`.
    """
    total = 0.0
    for end in _ends(domain, steps, start):
        block, _, cost, _ = domain.drives.get(_key(*end), (domain.block, None, 0.0, None))
        along = block == domain.block and np.isfinite(cost)
        total += _over_lattice(domain, end)[1] if along else float("inf")
    return total


def drive_cost(domain: SearchDomain, shifts: Shifts, start: Point, goal: Point) -> float:
    """Cost of one drive on the map [cells at full speed]; infinite if it does not exist.

    Parameters
    ----------
    domain, shifts, start, goal
        See :func:`pull_string`.
    """
    return _drive(domain, _Drive(shifts, start, goal))[2]


def changed_drives_cost(
    domain: SearchDomain,
    steps: tuple[PushStep, ...],
    changed: tuple[PushStep, ...],
    start: Point,
    most: float,
) -> float:
    """:func:`drives_cost` of pushes with other lengths, along the drives of a known plan.

    Parameters
    ----------
    domain, steps, start, most
        See :func:`drives_cost`; the drives of ``steps`` exist.
    changed
        The same pushes with other lengths.
    """
    fits = domain.clear_straight(changed[-1].shifts_after, domain.goal, domain.goal[None])[0]
    total = 0.0 if fits else np.inf
    for old, new in zip(_ends(domain, steps, start), _ends(domain, changed, start), strict=True):
        if total >= most:
            return np.inf
        key = _key(*new)
        # A bounded search ends without a cost where its blocks are too coarse for the drive.
        if not np.isfinite(domain.drives.get(key, (0, None, np.inf))[2]):
            block, nodes, _, _ = _drive(domain, old)
            # From the start of the new drive to the old one, along the old one, and to the goal of the new one.
            first, last = (resampled(np.stack(pair), 2 + int(np.hypot(*(pair[1] - pair[0])))) // block
                           for pair in ((new[1], old[1]), (old[2], new[2])))  # fmt: skip
            nodes = np.concatenate([first, nodes, last])
            domain.drives[key] = block, nodes, *_cost_along(domain, new, nodes, block)
        total += domain.drives[key][2]
    return total


def drives_cells(domain: SearchDomain, steps: tuple[PushStep, ...], start: Point) -> list[Path]:
    """Points of every drive of a plan, one cell apart [cells].

    Parameters
    ----------
    domain, steps, start
        See :func:`drives_cost`.
    """
    return [_drive(domain, end)[3] for end in _ends(domain, steps, start)]


def _ends(domain: SearchDomain, steps: tuple[PushStep, ...], start: Point) -> list[_Drive]:
    """All drives of a plan."""
    shifts = [np.zeros((len(domain.bodies), 2)), *(step.shifts_after for step in steps)]
    begins = [start, *(step.retreat for step in steps)]
    return list(map(_Drive, shifts, begins, [*(step.approach for step in steps), domain.goal]))


def _key(*arrays: Float[np.ndarray, "..."]) -> tuple[bytes, ...]:
    return tuple(array.tobytes() for array in arrays)


def _over_lattice(
    domain: SearchDomain, drive: _Drive, field: tuple[Nodes, Field] | None = None
) -> tuple[Path, float]:
    """Blocks (x, y) of a drive over the lattice, and its cost [cells at full speed].

    A path of the relaxed lattice, whose field may be known, is that of the lattice unless it leads through nodes that differ.
    """
    key = _key(*drive)
    if key not in domain.paths:
        shifts, start, goal = drive
        layer, block = domain.lattice_with(shifts), domain.block
        nodes, cost = np.zeros((0, 2)), 0.0
        if field is not None:
            loose = domain.relaxed.lattice_with(shifts)
            nodes, cost = cheapest_cells(domain, loose, start, goal, block, field)
            at = tuple(nodes.astype(int).T[::-1])
            nodes = nodes[: len(nodes) * bool((layer[at] == loose[at]).all())]
        if not len(nodes):
            nodes, cost = cheapest_cells(domain, layer, start, goal, block)
        domain.paths[key] = nodes, cost * block
    return domain.paths[key]


def _drive(domain: SearchDomain, drive: _Drive, *, complete: bool = True) -> tuple[int, Path, float, Path]:
    """Block size, blocks (x, y) along which the drive exists on the map, its cost there, and its cells.

    The clearance of a block is that of its clearest cell. If the drive does not exist on the map along the lattice path,
    blocks of half the size are tried, down to single cells, provided that a ``complete`` search is requested.
    """

    key, (shifts, start, goal) = _key(*drive), drive
    known = domain.drives.get(key)
    if known is None or (complete and not np.isfinite(known[2])):
        block, cost, cells = domain.block, float("inf"), np.zeros((0, 2))
        nodes, _ = _over_lattice(domain, drive)
        while True:
            if len(nodes):
                cost, cells = _cost_along(domain, drive, nodes, block)
            if np.isfinite(cost) or not len(nodes) or block == 1 or not complete:
                break
            block //= 2
            layer = domain.clearance_with(shifts)
            layer = layer if block == 1 else largest_in_blocks(layer, block)
            nodes, _ = cheapest_cells(domain, layer, start, goal, block)
        domain.drives[key] = block, nodes if np.isfinite(cost) else nodes[:0], cost, cells
    return domain.drives[key]


def _cost_along(domain: SearchDomain, drive: _Drive, nodes: Path, block: int) -> tuple[float, Path]:
    """Cost on the map of a drive along a path over blocks, passages included, and the centres of its cells [cells]."""
    cost, parts = 0.0, [drive.start[None]]
    for part, piece in _pieces(domain, drive, nodes, block):
        found = _cells_along(domain, part, piece, block)
        if found is None:
            return float("inf"), np.zeros((0, 2))
        cost += found[3]
        parts.append(found[0] + found[2] + 0.5)
    labels = domain.labels(block)
    if labels.size:
        places = nodes.astype(int)
        on_path = labels[places[:, 1], places[:, 0]]
        left = on_path[:-1][(on_path[:-1] > 0) & (on_path[1:] == 0)]
        cost += sum(domain.passages[number - 1][2] for number in left) / domain.seconds(1.0)
    return cost, np.concatenate([*parts, drive.goal[None]])


def _pieces(domain: SearchDomain, drive: _Drive, nodes: Path, block: int) -> list[tuple[_Drive, Path]]:
    """Drives along the pieces of a path over blocks, each with its blocks; a piece ends at the clearest cell of a block."""
    shifts, start, goal = drive
    pieces = []
    for first in range(0, len(nodes), PIECE):
        piece = nodes[first : first + PIECE + 1]
        end = goal
        if first + PIECE + 1 < len(nodes):
            low = (piece[-1] * block).astype(int)
            layer = domain.part(domain.clearance, low, low + block, shifts, 1)
            end = low + np.array(np.unravel_index(int(layer.argmax()), layer.shape))[::-1] + 0.5
        pieces.append((_Drive(shifts, start, end), piece))
        start = end
        if end is goal:
            break
    return pieces


def _pulled_piece(domain: SearchDomain, drive: _Drive, nodes: Path, block: int) -> Path:
    """Cheapest subset of the points of the map path along a path over blocks; empty if there is no path."""
    found = _cells_along(domain, drive, nodes, block)
    if found is None:
        return np.zeros((0, 2))
    cells, clearance, low, _ = found
    path = np.concatenate([[drive.start - low], cells + 0.5, [drive.goal - low]])
    # Points about one block apart suffice for the longer straight lines.
    for window in (domain.block, STRING_WINDOW):
        path = path[string_pull(clearance, domain.radius, domain.slow, path, window)[0]]
    return path + low


def _halved(path: Path) -> tuple[Float[np.ndarray, "a 2"], Float[np.ndarray, "b 2"]]:
    """The two halves of a path, up to its middle and from there on."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    after = max(int(np.searchsorted(along, 0.5 * along[-1])), 1)
    middle = [np.interp(0.5 * along[-1], along, path[:, axis]) for axis in (0, 1)]
    return np.vstack([path[:after], middle]), np.vstack([middle, path[after:]])


def _without_corners(domain: SearchDomain, shifts: Shifts, path: Path, deadline: Deadline | None) -> Path:
    """A path on the map with its corners cut by chords until the deadline."""

    low = np.maximum(np.floor(path.min(axis=0)).astype(int) - 2, 0)
    clearance = domain.part(domain.clearance, low, np.ceil(path.max(axis=0)).astype(int) + 2, shifts, 1)
    path = path - low
    kept, cost = string_pull(clearance, domain.radius, domain.slow, path, STRING_WINDOW)
    path = path[kept]
    for _ in range(STRING_ROUNDS):
        if deadline is not None and deadline.passed:
            break
        dense = resampled(path, STRING_WINDOW)
        kept, cost_now = string_pull(clearance, domain.radius, domain.slow, dense, STRING_WINDOW)
        if not cost_now < cost:
            break
        gain = 1.0 - cost_now / cost
        path, cost = dense[kept], cost_now
        if gain < 1e-3:
            break
    return path + low


def _cells_along(domain: SearchDomain, drive: _Drive, nodes: Path, block: int) -> Corridor | None:
    """Cells of a drive along a path over blocks, clearance around them, their common corner, and the cost."""
    shifts, start, goal = drive
    rows, columns = domain.clearance.shape
    # Chords stay within the bounding box of the path; the clearance accounts for obstacles outside.
    low_block = np.maximum(nodes.min(axis=0).astype(int) - 2, 0)
    low = low_block * block
    high = np.minimum((nodes.max(axis=0).astype(int) + 3) * block, (columns, rows))
    clearance = domain.part(domain.clearance, low, high, shifts, 1)
    corridor = np.zeros_like(clearance)
    for c, r in (nodes - low_block).astype(int).tolist():  # the path's blocks, and those around them
        around = np.s_[max(r - 1, 0) * block : (r + 2) * block, max(c - 1, 0) * block : (c + 2) * block]
        corridor[around] = clearance[around]
    while True:
        cells, cost = cheapest_cells(domain, corridor, start - low, goal - low, 1, beside=(shifts, low))
        closed = unclear_steps(domain, shifts, corridor, cells, low)
        if not len(closed):
            return (cells, clearance, low.astype(np.float64), cost) if len(cells) else None
        corridor[closed[:, 1], closed[:, 0]] = 0.0
