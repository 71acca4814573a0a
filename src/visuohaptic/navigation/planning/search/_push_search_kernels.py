"""Kernels for pushes on a grid: collision-free push distance, blocks of the lattice, and push lengths that open a passage.

All lengths are in cells; points are (x, y), and cell (row, column) covers
``column..column + 1`` by ``row..row + 1``. A block is ``block`` x ``block`` cells.
"""

from __future__ import annotations

import math

import numpy as np

from ....core.kernels import kernel
from ...graph.tracing._path_kernels import longer_rows
from ...pushing._outline_kernels import extent, inside_polygon, polygon_distance
from ._travel_kernels import clearance_at, flood


@kernel
def descend(cost, clearance, seeds, cell):
    """Cells (x, y) from a seed to a cell, by steepest descent over the eight neighbours of a travel cost field."""
    columns = clearance.shape[1]
    path = np.empty((1024, 2))
    count = 0
    seed = np.zeros(len(cost), np.bool_)
    for i in range(len(seeds)):
        seed[seeds[i]] = True
    at = cell
    while at >= 0:
        if count == len(path):
            path = longer_rows(path)
        r, c = at // columns, at % columns
        path[count, 0], path[count, 1] = c, r
        count += 1
        steepest, down = 0.0, -1
        for rr in range(max(r - 1, 0), min(r + 2, clearance.shape[0])):
            for cc in range(max(c - 1, 0), min(c + 2, columns)):
                v = rr * columns + cc
                slope = float(cost[at] - cost[v]) / math.hypot(rr - r, cc - c) if v != at else 0.0
                if slope > steepest:
                    steepest, down = slope, v
        at = -1 if seed[at] else down
    found = np.empty((count, 2))
    for i in range(count):
        found[i, 0], found[i, 1] = path[count - 1 - i, 0], path[count - 1 - i, 1]
    return found


@kernel
def largest_in_blocks(clearance, block):
    """The maximum clearance of each block."""
    rows, columns = clearance.shape
    out = np.zeros(((rows + block - 1) // block, (columns + block - 1) // block), np.float32)
    best = np.zeros(columns, np.float32)  # of each column, over the rows of the blocks
    for row in range(len(out)):
        best[:] = 0.0
        for r in range(row * block, min((row + 1) * block, rows)):
            line = clearance[r]
            for c in range(columns):
                best[c] = max(best[c], line[c])
        for column in range(out.shape[1]):
            for c in range(column * block, min((column + 1) * block, columns)):
                out[row, column] = max(out[row, column], best[c])
    return out


@kernel
def block_patch(clearance, polygon, radius, reach, block):
    """Maximum of min(clearance, distance from a polygon) in the blocks around it, and the first row and column.

    Exact to one cell where it decides whether a robot fits; elsewhere the distance of the block's centre is used.
    """
    rows, columns = clearance.shape
    height, width = (rows + block - 1) // block, (columns + block - 1) // block
    x0, x1, y0, y1 = extent(polygon)
    c0 = min(width, max(0, int(math.floor((x0 - reach) / block))))
    c1 = max(c0, min(width, int(math.ceil((x1 + reach) / block)) + 1))
    r0 = min(height, max(0, int(math.floor((y0 - reach) / block))))
    r1 = max(r0, min(height, int(math.ceil((y1 + reach) / block)) + 1))
    patch = np.zeros((r1 - r0, c1 - c0), np.float32)
    corner = 0.7072 * (block - 1)
    for r in range(r0, r1):
        for c in range(c0, c1):
            centre = polygon_distance((c + 0.5) * block, (r + 0.5) * block, polygon)
            if block == 1 or centre > radius + corner or centre < radius - corner:
                patch[r - r0, c - c0] = centre
                continue
            best = 0.0
            # Corners first: the distance from a cell to the polygon is at most that of the block's centre plus the offset.
            for step in (block - 1, 1):
                for rr in range(r * block, min((r + 1) * block, rows), step):
                    for cc in range(c * block, min((c + 1) * block, columns), step):
                        if clearance[rr, cc] <= best:
                            continue
                        x, y = cc + 0.5 - (c + 0.5) * block, rr + 0.5 - (r + 0.5) * block
                        if best < centre or x * x + y * y > (best - centre) ** 2:
                            own = polygon_distance(cc + 0.5, rr + 0.5, polygon)
                            best = max(best, min(clearance[rr, cc], own))
            patch[r - r0, c - c0] = best
    return patch, r0, c0


@kernel
def _meets(points, dx, dy, others, first, last):
    """Whether any of the displaced points lies inside one of the other outlines."""
    for i in range(len(points)):
        if inside_polygon(points[i, 0] + dx, points[i, 1] + dy, others[first:last]):
            return True
    return False


@kernel
def _in_wall(occupied, x, y):
    """Whether a point lies in an occupied cell or outside the map."""
    r, c = int(math.floor(y)), int(math.floor(x))
    return r < 0 or c < 0 or r >= len(occupied) or c >= occupied.shape[1] or occupied[r, c]


@kernel
def free_push_length(
    occupied, clearance, outline, around, polygon, others, other_start, robot_x, robot_y, dir_x, dir_y, radius, limit,
):  # fmt: skip
    """Collision-free distance of an object and the robot behind it [cells], in steps of half a cell.

    ``outline`` holds points along the object's edge, slightly inside it; ``others`` the concatenated polygons of the
    other objects. A point that lies in an occupied cell at the start (the object leans on a wall) is ignored until it
    leaves the wall, so that the object may slide along the wall, but into no other. ``around`` holds points outside the
    edge; those that start in an obstacle are ignored as long, because a margin that does not exist cannot be kept.
    ``clearance`` is that of static obstacles, ``radius`` the clearance that the robot requires at samples half a cell apart.
    """
    n, m = len(outline), len(around)
    points = np.concatenate((outline, around))
    # Step at which each point must be checked next: until then every occupied cell is too far away.
    due, leans = np.zeros(n + m), np.ones(n + m, np.bool_)
    count = len(other_start) - 1
    x0, x1, y0, y1 = extent(polygon)
    left, right, low, high = extent(around)
    x0, x1, y0, y1 = min(x0, left), max(x1, right), min(y0, low), max(y1, high)
    moved = np.zeros_like(polygon)
    for step in range(int(math.ceil(2.0 * limit - 1e-6)) + 1):
        before, t = 0.5 * (step - 1), min(0.5 * step, limit)
        x, y = robot_x + t * dir_x, robot_y + t * dir_y
        if step and clearance_at(clearance, x, y) < radius:
            return before
        dx, dy = t * dir_x, t * dir_y
        for i in range(n + m):
            if due[i] > t:
                continue
            px, py = points[i, 0] + dx, points[i, 1] + dy
            hit = _in_wall(occupied, px, py)
            if leans[i]:
                for o in range(count if i >= n and not hit else 0):
                    hit = hit or inside_polygon(px, py, others[other_start[o] : other_start[o + 1]])
                leans[i] = hit
            elif hit:
                return before
            if not hit:
                due[i] = t + clearance[int(math.floor(py)), int(math.floor(px))] - 2.2
        for o in range(count if step else 0):
            first, last = other_start[o], other_start[o + 1]
            if polygon_distance(x, y, others[first:last]) < radius:
                return before
            ox0, ox1, oy0, oy1 = extent(others[first:last])
            if x0 + dx > ox1 or x1 + dx < ox0 or y0 + dy > oy1 or y1 + dy < oy0:
                continue
            if _meets(outline, dx, dy, others, first, last):
                return before
            for i in range(n, n + m):
                if not leans[i] and inside_polygon(points[i, 0] + dx, points[i, 1] + dy, others[first:last]):
                    return before
            for i in range(len(polygon)):
                moved[i, 0], moved[i, 1] = polygon[i, 0] + dx, polygon[i, 1] + dy
            for i in range(first, last):
                if inside_polygon(others[i, 0], others[i, 1], moved):
                    return before
    return limit


@kernel
def opening_lengths(without, polygon, dir_x, dir_y, radius, block, limit, from_x, from_y, goal_x, goal_y):
    """Push lengths at which the robot's side of an object is connected with other free space around the object.

    With the object in place, the free blocks around it form several components. Each blocked block has a push length
    after which it stays free. A component is connected at the minimum over all paths of the maximum length on the path.
    The goal's own block counts as a component where the object covers it. ``without`` is the clearance without the
    object, by blocks; ``limit`` the collision-free push distance.
    """
    rows, columns = without.shape
    x0, x1, y0, y1 = extent(polygon)
    c0 = max(0, int(math.floor((x0 - radius) / block)) - 2)
    c1 = min(columns, int(math.ceil((x1 + radius) / block)) + 3)
    r0 = max(0, int(math.floor((y0 - radius) / block)) - 2)
    r1 = min(rows, int(math.ceil((y1 + radius) / block)) + 3)
    height, width = r1 - r0, c1 - c0
    if height <= 0 or width <= 0:
        return np.zeros(0)
    needed = radius - 0.5 * (block - 1)
    # Push length after which a block stays free; infinite where it never does.
    last = np.full(height * width, np.inf)
    label, free = np.full(height * width, -1, np.int32), np.zeros((height, width), np.float32)
    for r in range(height):
        for c in range(width):
            if without[r + r0, c + c0] < radius:
                continue
            x, y = (c + c0 + 0.5) * block, (r + r0 + 0.5) * block
            u = r * width + c
            if polygon_distance(x, y, polygon) >= needed:
                label[u], free[r, c] = -2, 1.0  # at length 0
            t = limit
            while t >= 0.0:
                gap = polygon_distance(x - t * dir_x, y - t * dir_y, polygon) - needed
                if gap < 0.0:
                    break
                t -= max(gap, 0.1)
            last[u] = 0.0 if t < 0.0 else (np.inf if t == limit else t + 0.1)
    pieces = 0
    one, none = np.zeros(1, np.int32), np.zeros(0, np.int32)
    for seed in range(height * width):
        if label[seed] != -2:
            continue
        one[0] = seed
        connected = flood(free, 0.5, one, none)
        for u in range(height * width):
            if connected[u]:
                label[u] = pieces
        pieces += 1
    own = -1
    nearest = np.inf
    fr, fc = from_y / block - r0 - 0.5, from_x / block - c0 - 0.5
    for u in range(height * width):
        if label[u] >= 0:
            away = math.hypot(u // width - fr, u % width - fc)
            if away < nearest:
                nearest, own = away, label[u]
    gr, gc = int(math.floor(goal_y / block)) - r0, int(math.floor(goal_x / block)) - c0
    covered = 0 <= gr < height and 0 <= gc < width and label[gr * width + gc] == -1
    if own < 0 or (pieces < 2 and not covered):
        return np.zeros(0)
    # Minimum over all paths of the maximum on the path: relaxation until convergence.
    reached = np.full(height * width, np.inf)
    for u in range(height * width):
        if label[u] == own:
            reached[u] = last[u]
    changed = True
    while changed:
        changed = False
        for turn in range(2):
            for k in range(height * width):
                u = k if turn == 0 else height * width - 1 - k
                if not last[u] < reached[u]:
                    continue
                r, c = u // width, u % width
                for rr in range(max(r - 1, 0), min(r + 2, height)):
                    for cc in range(max(c - 1, 0), min(c + 2, width)):
                        value = max(last[u], reached[rr * width + cc])
                        if value < reached[u]:
                            reached[u] = value
                            changed = True
    found = np.full(pieces + 1, np.inf)
    for u in range(height * width):
        if label[u] >= 0 and label[u] != own:
            found[label[u]] = min(found[label[u]], reached[u])
    if covered:
        found[pieces] = reached[gr * width + gc]
    count = 0
    lengths = np.zeros(pieces + 1)
    for i in range(pieces + 1):
        if found[i] < np.inf:
            lengths[count] = found[i]
            count += 1
    return lengths[:count]
