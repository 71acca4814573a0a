"""Kernels for driving on a grid: clearance, travel cost field, connected cells, string pulling.

All lengths are in cells; points are (x, y), and cell (row, column) covers
``column..column + 1`` by ``row..row + 1``.
"""

from __future__ import annotations

import math

import numpy as np

from ....core.kernels import kernel
from ...graph.tracing._path_kernels import longer_rows
from ...pushing._outline_kernels import extent, polygon_distance

#: Integer units of travel cost per straight cell at full speed: rounding errors stay below 0.2 %.
UNITS = 256
FAR = np.int32(2**30)
#: Minimum cost of a step: straight, at full speed, at an angle of 45 degrees to the gradient.
MIN_STEP = int(UNITS / math.sqrt(2.0))


@kernel
def _slowness(clearance, radius, slow):
    """Cost (4.1) at a clearance of at least the radius: ``slow`` at the radius, 1 from three radii on."""
    return slow + min((clearance / radius - 1.0) * 0.5, 1.0) * (1.0 - slow)


@kernel
def nodes_around(clearance, x, y, radius, slow, reach, block):
    """Free nodes in a window of ``reach`` around a point (flat index), and the costs from the point to them [units]."""
    rows, columns = clearance.shape
    x, y = x / block, y / block
    c, r = int(math.floor(x)), int(math.floor(y))
    nodes = np.zeros((2 * reach + 1) ** 2, np.int32)
    costs = np.zeros((2 * reach + 1) ** 2, np.int32)
    count = 0
    for rr in range(max(r - reach, 0), min(r + reach + 1, rows)):
        for cc in range(max(c - reach, 0), min(c + reach + 1, columns)):
            d = clearance[rr, cc]
            if d >= radius:
                length = math.hypot(cc + 0.5 - x, rr + 0.5 - y)
                nodes[count] = rr * columns + cc
                costs[count] = int(length * _slowness(d, radius, slow) * UNITS + 0.5)
                count += 1
    return nodes[:count].copy(), costs[:count].copy()


@kernel
def reach_costs(clearance, cost, points, radius, slow, block):
    """Minimum cost [units] of reaching each point over the free blocks around it; FAR where none is free."""
    found = np.full(len(points), int(FAR), np.int64)
    for i in range(len(points)):
        nodes, costs = nodes_around(clearance, points[i, 0], points[i, 1], radius, slow, 1, block)
        for k in range(len(nodes)):
            found[i] = min(found[i], int(cost[nodes[k]]) + int(costs[k]))
    return found


@kernel
def mark_region(region, polygon, radius, label, block):
    """Label the blocks all of whose cell centres are nearer than ``radius`` to a polygon; existing labels are kept."""
    rows, columns = region.shape
    inside = radius - 0.7072 * (block - 1)
    x_min, x_max, y_min, y_max = extent(polygon)
    c0 = max(0, int(math.floor((x_min - radius) / block)))
    c1 = min(columns, int(math.ceil((x_max + radius) / block)) + 1)
    r0 = max(0, int(math.floor((y_min - radius) / block)))
    r1 = min(rows, int(math.ceil((y_max + radius) / block)) + 1)
    for r in range(r0, r1):
        for c in range(c0, c1):
            near = polygon_distance((c + 0.5) * block, (r + 0.5) * block, polygon) < inside
            if region[r, c] == 0 and near:
                region[r, c] = label


@kernel
def _cell_cost(clearance, radius, slow):
    """Cost (4.1) of a cell [units], -1 where the robot does not fit."""
    if clearance >= 3.0 * radius:
        return UNITS
    if clearance < radius:
        return -1
    return int(_slowness(clearance, radius, slow) * UNITS + 0.5)


@kernel
def _bordered(cell, columns):
    """The flat index of a cell in a layer with a border of one cell."""
    return cell + 2 * (cell // columns) + columns + 3


@kernel
def travel_field(clearance, radius, slow, seeds, seed_cost, region, charge, cost_to_go, bound, targets):
    """Minimum any-angle travel cost from the seeds to every cell [units].

    Eikonal equation with the cost (4.1), 1 far from obstacles and ``slow`` at the radius, on the eight triangles around
    a cell (Ferguson and Stentz 2006, Field D*): between a straight neighbour s and an adjacent diagonal one d, the path
    through their edge costs ``s + sqrt(c^2 - (s - d)^2)``, c the mean cost of the straight step. Bucket queue over
    integer units, label correcting within a bucket; the width of a bucket is the minimum step cost.

    Parameters
    ----------
    clearance
        Distance to obstacles [cells].
    radius
        Radius of the robot [cells].
    slow
        v_max / v_min.
    seeds, seed_cost
        Start cells (flat index) and their initial costs [units].
    region, charge
        Where ``region`` is not empty, leaving a labelled cell (in the direction away from the seeds)
        for an unlabelled one costs an additional ``charge[label]`` [units].
    cost_to_go, bound
        Where ``cost_to_go`` is not empty, cells with cost + cost_to_go > bound are not expanded.
    targets
        If given, the search ends when the costs of all of them are final.
    """
    rows, columns = clearance.shape
    wide = columns + 2
    charged = region.size > 0
    # Cost of reaching a cell, and of the cell itself, -1 where the robot does not fit [units]; with a border of such cells.
    cost = np.empty(((rows + 2) * wide, 2), np.int32)
    labels = np.zeros(len(cost) if charged else 0, np.int16)
    for i in range(len(cost)):
        cost[i, 0], cost[i, 1] = FAR, -1
    for r in range(rows):
        for c in range(columns):
            cost[(r + 1) * wide + c + 1, 1] = _cell_cost(clearance[r, c], radius, slow)
            if charged:
                labels[(r + 1) * wide + c + 1] = region[r, c]
    limited = cost_to_go.size > 0
    top = 0
    for i in range(len(charge)):
        top = max(top, charge[i])
    for i in range(len(seed_cost)):
        top = max(top, seed_cost[i])
    count = 4  # buckets: a power of two, whose remainder is a mask
    while count < (int(slow * UNITS * 1.5) + top) // UNITS + 4:
        count *= 2
    last = count - 1
    heads = np.full(count, -1, np.int32)
    capacity = max(1024, rows * columns // 4)
    pool = np.empty((capacity, 3), np.int32)  # queued cells: cell, next entry of the bucket, cost
    used = 0
    free = -1
    waiting = 0
    for i in range(len(seeds)):
        s = _bordered(seeds[i], columns)
        if cost[s, 1] > 0 and seed_cost[i] < cost[s, 0]:
            cost[s, 0] = seed_cost[i]
            slot = (cost[s, 0] // UNITS) & last
            pool[used, 0] = s
            pool[used, 2] = cost[s, 0]
            pool[used, 1] = heads[slot]
            heads[slot] = used
            used += 1
            waiting += 1
    # Unsigned, as an index that may be negative costs a comparison: the neighbours, and whether they are in the same row.
    around, level_with, diagonal = np.empty(8, np.uint64), np.empty(8, np.bool_), np.empty(8, np.bool_)
    for k in range(8):
        dr, dc = (k + k // 4) // 3 - 1, (k + k // 4) % 3 - 1
        around[k], level_with[k], diagonal[k] = np.uint64(dr * wide + dc), dr == 0, dr != 0 and dc != 0
    above, below, left, right = around[1], around[6], around[3], around[4]
    level = 0
    while waiting > 0:
        slot = level & last
        while heads[slot] >= 0:
            entry = heads[slot]
            heads[slot] = pool[entry, 1]
            pool[entry, 1] = free
            free = entry
            waiting -= 1
            cell = pool[entry, 0]
            u = np.uint64(cell)
            reached = cost[u, 0]
            if pool[entry, 2] != reached:
                continue
            if limited and reached + cost_to_go[cell - 2 * (cell // wide) - columns - 1] > bound:
                continue
            own = labels[u] if charged else 0
            # Cost difference to the lower of the cells above and below, and of those left and right: 0 where neither is lower.
            upright, level_by = 0, 0
            if not charged or labels[u + above] == own:
                upright = max(upright, reached - cost[u + above, 0])
            if not charged or labels[u + below] == own:
                upright = max(upright, reached - cost[u + below, 0])
            if not charged or labels[u + left] == own:
                level_by = max(level_by, reached - cost[u + left, 0])
            if not charged or labels[u + right] == own:
                level_by = max(level_by, reached - cost[u + right, 0])
            for k in range(8):
                v = u + around[k]
                if cost[v, 0] <= reached + MIN_STEP or cost[v, 1] < 0:
                    continue
                both = cost[u, 1] + cost[v, 1]
                if diagonal[k]:
                    total = reached + ((both * 724) >> 10)  # sqrt(1/2) of it
                else:
                    total = reached + (both >> 1)
                    lower = upright if level_with[k] else level_by
                    if lower > 0 and 2 * lower * lower < (both * both) >> 2:
                        mean = 0.5 * both
                        total = reached + int(math.sqrt(mean * mean - float(lower) * lower) + 0.5)
                if charged and own > 0 and labels[v] == 0:
                    total += charge[own]
                if total < cost[v, 0]:
                    cost[v, 0] = total
                    if free >= 0:
                        entry = free
                        free = pool[entry, 1]
                    else:
                        if used == capacity:
                            pool = longer_rows(pool)
                            capacity = len(pool)
                        entry = used
                        used += 1
                    pool[entry, 0] = v
                    pool[entry, 2] = total
                    slot_v = (total // UNITS) & last
                    pool[entry, 1] = heads[slot_v]
                    heads[slot_v] = entry
                    waiting += 1
        level += 1
        if len(targets) > 0:
            open_targets = False
            for i in range(len(targets)):
                at = _bordered(targets[i], columns)
                open_targets = open_targets or cost[at, 0] >= level * UNITS
            if not open_targets:
                break
    found = np.empty(rows * columns, np.int32)
    for r in range(rows):
        for c in range(columns):
            found[r * columns + c] = cost[(r + 1) * wide + c + 1, 0]
    return found


@kernel
def clearance_at(clearance, x, y):
    """Clearance between cell centres, bilinear; 0 outside the map."""
    rows, columns = clearance.shape
    if x < 0.0 or y < 0.0 or x >= columns or y >= rows:
        return 0.0
    fx = min(max(x - 0.5, 0.0), columns - 1.0)
    fy = min(max(y - 0.5, 0.0), rows - 1.0)
    c, r = int(fx), int(fy)
    c1, r1 = min(c + 1, columns - 1), min(r + 1, rows - 1)
    u, v = fx - c, fy - r
    low = clearance[r, c] * (1.0 - u) + clearance[r, c1] * u
    high = clearance[r1, c] * (1.0 - u) + clearance[r1, c1] * u
    return low * (1.0 - v) + high * v


@kernel
def clearances_at(clearance, points):
    """Clearance at points between cell centres, bilinear; 0 outside the map."""
    found = np.zeros(len(points))
    for i in range(len(points)):
        found[i] = clearance_at(clearance, points[i, 0], points[i, 1])
    return found


@kernel
def segment_cost(clearance, radius, slow, x0, y0, x1, y1, forced, enough):
    """Integral of the cost (4.1) along a segment [cells at full speed]; infinite where it collides.

    ``forced`` treats a clearance below the radius as equal to the radius. Also infinite once the cost reaches ``enough``.
    """
    length = math.hypot(x1 - x0, y1 - y0)
    # Between samples the clearance is lower by at most spacing^2 / (8 radius).
    count = max(1, int(math.ceil(length / max(0.5, radius / 7.0))))
    dx, dy = (x1 - x0) / count, (y1 - y0) / count
    # A few samples first: most segments that collide do so far from their ends.
    for i in range(count if forced else 8, count, 16):
        if clearance_at(clearance, x0 + i * dx, y0 + i * dy) < radius - 1e-4:
            return np.inf
    total = 0.0
    for i in range(count + 1):
        d = clearance_at(clearance, x0 + i * dx, y0 + i * dy)
        if d < radius - 1e-4 and not forced:
            return np.inf
        weight = 0.5 if i == 0 or i == count else 1.0
        total += weight if d >= 3.0 * radius else weight * _slowness(max(d, radius), radius, slow)
        if (total + max(count - i - 0.5, 0.0)) * length >= enough * count:  # no sample costs less than 1
            return np.inf
    return total * length / count


@kernel
def string_pull(clearance, radius, slow, path, window):
    """Cheapest subset of a path's points that is connected by collision-free straight segments.

    A shortest-path problem over pairs of points at most ``window`` apart; steps
    between neighbours are always allowed, because they were free on the grid.

    Returns
    -------
    indices of the kept points, cost [cells at full speed]
    """
    n = len(path)
    best = np.full(n, np.inf)
    came = np.zeros(n, np.int32)
    best[0] = 0.0
    for j in range(1, n):
        first = max(0, j - window)
        # The point before the previous one first: its segment is often the cheapest, and limits the evaluation of the others.
        likely = max(first, came[j - 1])
        for k in range(first - 1, j):
            i = likely if k < first else k
            length = math.hypot(path[j, 0] - path[i, 0], path[j, 1] - path[i, 1])
            if k == likely or best[i] + length >= best[j]:
                continue
            x0, y0, x1, y1 = path[i, 0], path[i, 1], path[j, 0], path[j, 1]
            cost = segment_cost(clearance, radius, slow, x0, y0, x1, y1, False, best[j] - best[i])
            if not cost < np.inf and i == j - 1:
                cost = segment_cost(clearance, radius, slow, x0, y0, x1, y1, True, np.inf)
            # 1e-9 per kept point: among paths of equal cost, prefer fewer corners.
            total = best[i] + cost + 1e-9
            if total < best[j] or (total == best[j] and i < came[j]):
                best[j] = total
                came[j] = i
    count = 1
    j = n - 1
    while j > 0:
        j = came[j]
        count += 1
    kept = np.empty(count, np.int32)
    j = n - 1
    for i in range(count - 1, -1, -1):
        kept[i] = j
        j = came[j]
    return kept, best[n - 1]


@kernel
def flood(clearance, radius, seeds, targets):
    """Cells connected with the seeds, 8-connected, with at least the radius as clearance; not all once a target is found."""
    rows, columns = clearance.shape
    flat = clearance.ravel()
    found = np.zeros(rows * columns, np.bool_)
    stack = np.empty(rows * columns, np.int32)
    used = 0
    for s in seeds:
        if flat[s] >= radius and not found[s]:
            found[s] = True
            stack[used] = s
            used += 1
    while used > 0:
        used -= 1
        u = stack[used]
        for target in targets:
            if u == target:
                return found
        r, c = u // columns, u % columns
        for rr in range(max(r - 1, 0), min(r + 2, rows)):
            for cc in range(max(c - 1, 0), min(c + 2, columns)):
                v = rr * columns + cc
                if not found[v] and flat[v] >= radius:
                    found[v] = True
                    stack[used] = v
                    used += 1
    return found
