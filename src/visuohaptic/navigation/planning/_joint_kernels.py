"""Kernels of the joint graph: an object's place freed in a window, its reach, and short paths in the graph."""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel
from ..pushing._outline_kernels import extent, inside_polygon, polygon_distance, segment_distance

#: Crumbs of an object's cells are looked for so far around its outline [cells].
CRUMB_REACH = 1.25


@kernel
def cell_meets_polygon(row: int, column: int, polygon: np.ndarray) -> bool:
    """Whether a cell's square meets a polygon's inside."""
    x, y = column + 0.5, row + 0.5
    if inside_polygon(x, y, polygon):
        return True
    n = len(polygon)
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        ax, ay, bx, by = polygon[i, 0], polygon[i, 1], polygon[j, 0], polygon[j, 1]
        if segment_distance(x, y, ax, ay, bx, by) >= 0.7072:
            continue
        # Clip the edge by the square, a hair smaller: what only touches does not count.
        t0, t1 = 0.0, 1.0
        for axis in range(2):
            a = ax if axis == 0 else ay
            d = (bx - ax) if axis == 0 else (by - ay)
            low = (column if axis == 0 else row) + 1e-6
            high = low + 1.0 - 2e-6
            if d == 0.0:
                if a < low or a > high:
                    t0, t1 = 1.0, 0.0
            else:
                u, v = (low - a) / d, (high - a) / d
                t0, t1 = max(t0, min(u, v)), min(t1, max(u, v))
        if t0 < t1:
            return True
    return False


@kernel
def free_object(occupied: np.ndarray, polygon: np.ndarray, row0: int, column0: int) -> None:
    """Free an object's cells in a window that begins at (row0, column0).

    Those that its outline covers, and spurious components beside them - connected pieces that
    lie wholly within ``CRUMB_REACH`` - which no wall explains.
    """
    rows, columns = occupied.shape
    near = np.zeros((rows, columns), np.bool_)
    # Cells whose centre is farther than this from the outline's box are neither met nor near.
    reach = CRUMB_REACH + 1.0
    x_min, x_max, y_min, y_max = extent(polygon)
    top = max(0, int(y_min - reach) - row0)
    bottom = min(rows, int(y_max + reach) + 1 - row0)
    left = max(0, int(x_min - reach) - column0)
    right = min(columns, int(x_max + reach) + 1 - column0)
    for r in range(top, bottom):
        for c in range(left, right):
            if not occupied[r, c]:
                continue
            if cell_meets_polygon(r + row0, c + column0, polygon):
                occupied[r, c] = False
            else:
                near[r, c] = polygon_distance(c + column0 + 0.5, r + row0 + 0.5, polygon) <= CRUMB_REACH
    seen = np.zeros((rows, columns), np.bool_)
    stack = np.empty((rows * columns, 2), np.int32)
    for r in range(top, bottom):
        for c in range(left, right):
            if not near[r, c] or seen[r, c]:
                continue
            used, first = 1, 0
            stack[0, 0], stack[0, 1] = r, c
            seen[r, c] = True
            spurious_component = True
            while first < used:
                ur, uc = stack[first, 0], stack[first, 1]
                first += 1
                if ur == 0 or uc == 0 or ur == rows - 1 or uc == columns - 1:
                    spurious_component = False
                for vr in range(max(ur - 1, 0), min(ur + 2, rows)):
                    for vc in range(max(uc - 1, 0), min(uc + 2, columns)):
                        if occupied[vr, vc] and not near[vr, vc]:
                            spurious_component = False
                        elif occupied[vr, vc] and not seen[vr, vc]:
                            seen[vr, vc] = True
                            stack[used, 0], stack[used, 1] = vr, vc
                            used += 1
            if spurious_component:
                for i in range(used):
                    occupied[stack[i, 0], stack[i, 1]] = False


@kernel
def place_node(
    clearance: np.ndarray,
    radius: float,
    seed: np.ndarray,
    row0: int,
    column0: int,
    centre_x: float,
    centre_y: float,
) -> int:
    """Cell of the window for a node: free, of no region, nearest to the centre; -1 when there is none."""
    rows, columns = clearance.shape
    best, found = np.inf, -1
    for r in range(rows):
        for c in range(columns):
            if clearance[r, c] < radius or seed[r + row0, c + column0] >= 0:
                continue
            d = (c + column0 + 0.5 - centre_x) ** 2 + (r + row0 + 0.5 - centre_y) ** 2
            if d < best:
                best, found = d, r * columns + c
    return found


@kernel
def region_of_node(
    clearance: np.ndarray, radius: float, seed: np.ndarray, row0: int, column0: int, start: int
) -> np.ndarray:
    """Step 4: unassigned free cells connected to the node, as a mask of the window."""
    rows, columns = clearance.shape
    mine = np.zeros(rows * columns, np.bool_)
    stack = np.empty(rows * columns, np.int32)
    stack[0] = start
    mine[start] = True
    used = 1
    while used > 0:
        used -= 1
        r, c = stack[used] // columns, stack[used] % columns
        for vr in range(max(r - 1, 0), min(r + 2, rows)):
            for vc in range(max(c - 1, 0), min(c + 2, columns)):
                v = vr * columns + vc
                if not mine[v] and clearance[vr, vc] >= radius and seed[vr + row0, vc + column0] < 0:
                    mine[v] = True
                    stack[used] = v
                    used += 1
    return mine


@kernel
def border_costs(
    cost: np.ndarray,
    mine: np.ndarray,
    clearance: np.ndarray,
    radius: float,
    potential: np.ndarray,
    seed: np.ndarray,
    row0: int,
    column0: int,
    unit_ratio: float,
    far: int,
    most: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Steps 5 and 6: regions beside the node's own, and the cost to their nodes over the shared border.

    ``potential`` counts in units of the visual layers, ``unit_ratio`` of ours each.
    """
    rows, columns = clearance.shape
    names = np.empty(most, np.int64)
    costs = np.empty(most, np.float64)
    count = 0
    for r in range(rows):
        for c in range(columns):
            v = r * columns + c
            name = seed[r + row0, c + column0]
            if name < 0 or cost[v] >= far or clearance[r, c] < radius:
                continue
            beside = False
            for ur in range(max(r - 1, 0), min(r + 2, rows)):
                for uc in range(max(c - 1, 0), min(c + 2, columns)):
                    beside = beside or mine[ur * columns + uc]
            if not beside:
                continue
            total = cost[v] + potential[r + row0, c + column0] * unit_ratio
            k = 0
            while k < count and names[k] != name:
                k += 1
            if k == count:
                if count == most:
                    continue
                names[k], costs[k] = name, total
                count += 1
            else:
                costs[k] = min(costs[k], total)
    return names[:count], costs[:count]


@kernel
def bounded_ways(
    start: np.ndarray,
    ends: np.ndarray,
    edges: np.ndarray,
    costs: np.ndarray,
    source: int,
    targets: np.ndarray,
    bound: float,
    best: np.ndarray,
    heap_cost: np.ndarray,
    heap_node: np.ndarray,
) -> np.ndarray:
    """Costs from a node to some others in a CSR graph, up to a bound; infinite beyond.

    ``best`` must be infinite everywhere and is left so; it and the heaps are scratch.
    """
    touched = np.empty(len(best), np.int64)
    touched[0] = source
    reached = 1
    best[source] = 0.0
    heap_cost[0], heap_node[0] = 0.0, source
    size = 1
    while size > 0:
        cost, node = heap_cost[0], heap_node[0]
        size -= 1
        last_cost, last_node = heap_cost[size], heap_node[size]
        i = 0
        while True:
            child = 2 * i + 1
            if child >= size:
                break
            if child + 1 < size and heap_cost[child + 1] < heap_cost[child]:
                child += 1
            if heap_cost[child] >= last_cost:
                break
            heap_cost[i], heap_node[i] = heap_cost[child], heap_node[child]
            i = child
        heap_cost[i], heap_node[i] = last_cost, last_node
        if cost > best[node]:
            continue
        for k in range(start[node], start[node + 1]):
            other, total = ends[k], cost + costs[edges[k]]
            if total < best[other] and total <= bound:
                if best[other] == np.inf:
                    touched[reached] = other
                    reached += 1
                best[other] = total
                i = size
                size += 1
                while i > 0 and heap_cost[(i - 1) // 2] > total:
                    heap_cost[i], heap_node[i] = heap_cost[(i - 1) // 2], heap_node[(i - 1) // 2]
                    i = (i - 1) // 2
                heap_cost[i], heap_node[i] = total, other
    found = np.empty(len(targets))
    for i in range(len(targets)):
        found[i] = best[targets[i]]
    for i in range(reached):
        best[touched[i]] = np.inf
    return found
