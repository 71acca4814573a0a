"""Steps 1 to 7 for one node of the joint graph (Alt 2016, Sec. 4.2.1), in one call: windows are small, calls are not."""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel
from ..grid._distance_kernels import distance_rows, vertical_cells
from ..pushing._outline_kernels import extent
from ._joint_kernels import border_costs, bounded_ways, free_object, place_node, region_of_node
from .search._travel_kernels import FAR, travel_field

__all__ = ["node_in_window", "useful_neighbours"]

_BLOCKED = np.int8(100)


@kernel
def clearance_without(
    cells: np.ndarray,
    threshold: int,
    unknown_blocks: bool,
    outline: np.ndarray,
    wide: tuple[int, int, int, int],
    narrow: tuple[int, int, int, int],
) -> np.ndarray:
    """Steps 1 and 2: distances [cells] in the narrow window when the object is gone, from obstacles (their cells) in the wide one.

    Windows are first and past-the-last row, first and past-the-last column. Beyond the border of the map
    all is blocked where unknown cells block.
    """
    rows, columns = cells.shape
    r0, r1, c0, c1 = wide
    ring = 1 if unknown_blocks else 0
    top, bottom = ring * (r0 == 0), ring * (r1 == rows)
    left, right = ring * (c0 == 0), ring * (c1 == columns)
    height, width = r1 - r0 + top + bottom, c1 - c0 + left + right
    occupied = np.ones((height, width), np.bool_)
    for r in range(r0, r1):
        for c in range(c0, c1):
            value = cells[r, c]
            occupied[r - r0 + top, c - c0 + left] = value >= threshold or (unknown_blocks and value < 0)
    free_object(occupied, outline, r0 - top, c0 - left)
    blocked = np.zeros((height, width), np.int8)
    for r in range(height):
        for c in range(width):
            beyond = r < top or c < left or r >= height - bottom or c >= width - right
            if occupied[r, c] or beyond:
                blocked[r, c] = _BLOCKED
    vertical = np.zeros((height, width), np.uint16)
    vertical_cells(blocked, threshold, False, vertical)
    distance = np.zeros((height, width), np.float32)
    step = np.zeros((height, width), np.uint16)
    distance_rows(vertical, 1.0, np.zeros(1, np.uint16), False, distance, step)
    i0, i1, j0, j1 = narrow
    return distance[i0 - r0 + top : i1 - r0 + top, j0 - c0 + left : j1 - c0 + left].copy()


@kernel
def node_in_window(
    cells: np.ndarray,
    threshold: int,
    unknown_blocks: bool,
    outline: np.ndarray,
    wide: tuple[int, int, int, int],
    narrow: tuple[int, int, int, int],
    radius: float,
    slow: float,
    seed: np.ndarray,
    potential: np.ndarray,
    unit_ratio: float,
    most: int,
) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    """Steps 1 to 6: where the node is, its region, and what it costs to reach the nodes of the regions beside it.

    Parameters
    ----------
    cells
        Occupancy of the map, (rows, columns) int8.
    threshold
        Occupancy from which a cell is an obstacle.
    unknown_blocks
        Whether unknown cells are obstacles.
    outline
        Corners of the object (k, 2) [cells].
    wide, narrow
        Windows of the map, for obstacles and for the node: first and past-the-last row, first and past-the-last
        column.
    radius
        Of the robot [cells].
    slow
        Ratio of the maximum to the minimum speed.
    seed
        Node of each cell of the map, (rows, columns).
    potential
        Cost from each cell to its node [units of the map].
    unit_ratio
        Units of the travel field per unit of ``potential``.
    most
        Maximum number of neighbours.

    Returns
    -------
    cell of the node (flat, in the narrow window; -1 where there is none), cells of its region (flat, in the map),
    seeds of the neighbours, costs [units of the travel field]
    """
    inner = clearance_without(cells, threshold, unknown_blocks, outline, wide, narrow)
    i0, j0 = narrow[0], narrow[2]
    x_min, x_max, y_min, y_max = extent(outline)
    start = place_node(inner, radius, seed, i0, j0, 0.5 * (x_min + x_max), 0.5 * (y_min + y_max))
    if start < 0:
        return start, np.zeros(0, np.int32), np.zeros(0, np.int64), np.zeros(0, np.float64)
    mine = region_of_node(inner, radius, seed, i0, j0, start)
    rows, columns = inner.shape
    # The path to a neighbour leads through the node's own region and over the border, not along it.
    own = np.zeros((rows, columns), np.float32)
    region = np.empty(rows * columns, np.int32)
    count = 0
    for v in range(rows * columns):
        if not mine[v]:
            continue
        r, c = v // columns, v % columns
        region[count] = (r + i0) * seed.shape[1] + c + j0
        count += 1
        for rr in range(max(r - 1, 0), min(r + 2, rows)):
            for cc in range(max(c - 1, 0), min(c + 2, columns)):
                own[rr, cc] = inner[rr, cc]
    nothing = np.zeros((0, 0), np.int32)
    none = np.zeros(0, np.int32)
    begin = np.full(1, start, np.int32)
    cost = travel_field(own, radius, slow, begin, np.zeros(1, np.int32), nothing, none, none, 0, none)
    names, costs = border_costs(
        cost, mine, inner, radius, potential, seed, i0, j0, unit_ratio, int(FAR), most
    )
    return start, region[:count].copy(), names, costs


@kernel
def useful_neighbours(
    first: np.ndarray,
    ends: np.ndarray,
    edges: np.ndarray,
    costs: np.ndarray,
    neighbours: np.ndarray,
    drive: np.ndarray,
    significant: float,
    best: np.ndarray,
    heap_cost: np.ndarray,
    heap_node: np.ndarray,
) -> np.ndarray:
    """Step 7: neighbours with a path over the node that is shorter by a fraction than without it.

    Parameters
    ----------
    first, ends, edges
        The graph in CSR form: first half-edge of each node, other ends, edges.
    costs
        Of the edges.
    neighbours
        Nodes of the regions beside the added node.
    drive
        Cost from the added node to each neighbour.
    significant
        Fraction by which a path has to be shorter to count.
    best, heap_cost, heap_node
        Buffers of Dijkstra's search.
    """
    count = len(neighbours)
    kept = np.zeros(count, np.bool_)
    if count == 0:
        return kept
    furthest = drive[0]
    for i in range(1, count):
        furthest = max(furthest, drive[i])
    for i in range(count):
        bound = (drive[i] + furthest) * (1.0 + significant)
        around = bounded_ways(
            first, ends, edges, costs, neighbours[i], neighbours, bound, best, heap_cost, heap_node
        )
        for k in range(count):
            if k != i and drive[i] + drive[k] < (1.0 - significant) * around[k]:
                kept[k] = True
                kept[i] = True
    return kept
