"""Kernels for outlines in cells: distances from polygons, distance patches, contact and passage of a disc.

All lengths are in cells; points are (x, y), and cell (row, column) covers
``column..column + 1`` by ``row..row + 1``.
"""

from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel


@kernel
def segment_distance(px, py, ax, ay, bx, by):
    """Distance of a point from a segment."""
    dx, dy = bx - ax, by - ay
    length2 = dx * dx + dy * dy
    t = 0.0
    if length2 > 0.0:
        t = min(max(((px - ax) * dx + (py - ay) * dy) / length2, 0.0), 1.0)
    return math.hypot(px - ax - t * dx, py - ay - t * dy)


@kernel
def inside_polygon(px, py, polygon):
    """Whether a point is inside a polygon (even-odd rule)."""
    inside = False
    n = len(polygon)
    j = n - 1
    for i in range(n):
        yi, yj = polygon[i, 1], polygon[j, 1]
        if (yi > py) != (yj > py):
            x = polygon[i, 0] + (py - yi) / (yj - yi) * (polygon[j, 0] - polygon[i, 0])
            if px < x:
                inside = not inside
        j = i
    return inside


@kernel
def polygon_distance(px, py, polygon):
    """Distance of a point from a filled polygon; 0 inside."""
    if inside_polygon(px, py, polygon):
        return 0.0
    best = np.inf
    j = len(polygon) - 1
    for i in range(len(polygon)):
        x, y = px - polygon[j, 0], py - polygon[j, 1]
        dx, dy = polygon[i, 0] - polygon[j, 0], polygon[i, 1] - polygon[j, 1]
        along = x * dx + y * dy
        if along > 0.0:
            t = min(along / (dx * dx + dy * dy), 1.0)
            x, y = x - t * dx, y - t * dy
        best = min(best, x * x + y * y)
        j = i
    return math.sqrt(best)


@kernel
def segment_gap(ax, ay, bx, by, polygon):
    """Distance of a segment from a filled polygon; 0 if they intersect."""
    if inside_polygon(ax, ay, polygon):
        return 0.0
    best = np.inf
    n = len(polygon)
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        cx, cy, dx, dy = polygon[i, 0], polygon[i, 1], polygon[j, 0], polygon[j, 1]
        left_c = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        left_d = (bx - ax) * (dy - ay) - (by - ay) * (dx - ax)
        left_a = (dx - cx) * (ay - cy) - (dy - cy) * (ax - cx)
        left_b = (dx - cx) * (by - cy) - (dy - cy) * (bx - cx)
        if left_c * left_d < 0.0 and left_a * left_b < 0.0:
            return 0.0
        best = min(best, segment_distance(ax, ay, cx, cy, dx, dy), segment_distance(bx, by, cx, cy, dx, dy))
        best = min(best, segment_distance(cx, cy, ax, ay, bx, by))
    return best


@kernel
def square_gap(ax, ay, bx, by, column, row, inset, square):
    """Distance of a segment from the square of a cell less ``inset``; ``square`` (4, 2) is filled with its corners."""
    for corner in range(4):
        square[corner, 0] = column + (1.0 - inset if corner == 1 or corner == 2 else inset)
        square[corner, 1] = row + (1.0 - inset if corner >= 2 else inset)
    return segment_gap(ax, ay, bx, by, square)


@kernel
def clear_straight(occupied, outlines, starts, x, y, ends, radius):
    """Whether a disc can move straight from a point to each end with its radius as minimum clearance.

    Exact with respect to the squares of the occupied cells, the border of the map, and the filled outlines, which
    start at the indices ``starts``.
    """
    rows, columns = occupied.shape
    clear = np.zeros(len(ends), np.bool_)
    square = np.zeros((4, 2))
    for i in range(len(ends)):
        ex, ey = ends[i, 0], ends[i, 1]
        x0, x1, y0, y1 = min(x, ex), max(x, ex), min(y, ey), max(y, ey)
        free = x0 >= radius and y0 >= radius and x1 <= columns - radius and y1 <= rows - radius
        for k in range(len(starts) - 1):
            if free:
                outline = outlines[starts[k] : starts[k + 1]]
                low_x, high_x, low_y, high_y = extent(outline)
                near = low_x < x1 + radius and high_x > x0 - radius
                if near and low_y < y1 + radius and high_y > y0 - radius:
                    free = segment_gap(x, y, ex, ey, outline) >= radius
        r = int(y0 - radius)
        while free and r < y1 + radius:
            for c in range(int(x0 - radius), int(math.ceil(x1 + radius))):
                if not free or not occupied[r, c]:
                    continue
                if segment_distance(c + 0.5, r + 0.5, x, y, ex, ey) >= radius + 0.7072:
                    continue
                free = square_gap(x, y, ex, ey, c, r, 0.0, square) >= radius
            r += 1
        clear[i] = free
    return clear


@kernel
def obstacle_distances(occupied, clearance, outlines, starts, points, limit):
    """Distance of each point from the nearest occupied square, filled outline or border of the map, at most ``limit``.

    ``clearance`` is that of the cells' centres from some of these obstacles: it limits the squares that are evaluated.
    """
    rows, columns = occupied.shape
    found = np.full(len(points), limit)
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        best = max(min(limit, x, y, columns - x, rows - y), 0.0)
        for k in range(len(starts) - 1):
            outline = outlines[starts[k] : starts[k + 1]]
            low_x, high_x, low_y, high_y = extent(outline)
            if low_x < x + best and high_x > x - best and low_y < y + best and high_y > y - best:
                best = min(best, polygon_distance(x, y, outline))
        r, c = min(max(int(y), 0), rows - 1), min(max(int(x), 0), columns - 1)
        off = math.hypot(x - c - 0.5, y - r - 0.5)
        reach = min(best, clearance[r, c] + off)
        for rr in range(max(int(y - reach), 0), min(int(y + reach) + 1, rows)):
            for cc in range(max(int(x - reach), 0), min(int(x + reach) + 1, columns)):
                if occupied[rr, cc]:
                    away_x, away_y = max(cc - x, x - cc - 1.0, 0.0), max(rr - y, y - rr - 1.0, 0.0)
                    best = min(best, math.hypot(away_x, away_y))
        found[i] = best
    return found


@kernel
def extent(polygon):
    """Minimum and maximum x, minimum and maximum y."""
    x_min, x_max, y_min, y_max = np.inf, -np.inf, np.inf, -np.inf
    for i in range(len(polygon)):
        x_min, x_max = min(x_min, polygon[i, 0]), max(x_max, polygon[i, 0])
        y_min, y_max = min(y_min, polygon[i, 1]), max(y_max, polygon[i, 1])
    return x_min, x_max, y_min, y_max


@kernel(error_model="numpy")
def distance_patch(polygon, reach):
    """Distance from a polygon of the cells around it, and the first row and column of the patch, possibly outside a map."""
    x_min, x_max, y_min, y_max = extent(polygon)
    c0, c1 = int(math.floor(x_min - reach)), int(math.ceil(x_max + reach)) + 1
    r0, r1 = int(math.floor(y_min - reach)), int(math.ceil(y_max + reach)) + 1
    patch = np.empty((r1 - r0, c1 - c0), np.float32)
    nearest = np.empty(c1 - c0)
    inside = np.empty(c1 - c0, np.bool_)
    # As polygon_distance, row by row and edge by edge, so that the loops over columns are vectorized.
    for r in range(r0, r1):
        py = r + 0.5
        for c in range(c1 - c0):
            nearest[c], inside[c] = np.inf, False
        j = len(polygon) - 1
        for i in range(len(polygon)):
            xi, yi, xj, yj = polygon[i, 0], polygon[i, 1], polygon[j, 0], polygon[j, 1]
            dx, dy, y = xi - xj, yi - yj, py - yj
            squared = max(dx * dx + dy * dy, 1e-300)
            crosses = -np.inf
            if (yi > py) != (yj > py):
                crosses = xi + (py - yi) / (yj - yi) * (xj - xi)
            for c in range(c1 - c0):
                px = c + c0 + 0.5
                x = px - xj
                t = min(max(x * dx + y * dy, 0.0) / squared, 1.0)
                u, v = x - t * dx, y - t * dy
                nearest[c] = min(nearest[c], u * u + v * v)
                inside[c] ^= px < crosses
            j = i
        for c in range(c1 - c0):
            patch[r - r0, c] = 0.0 if inside[c] else math.sqrt(nearest[c])
    return patch, r0, c0


@kernel
def disc_touches_at(polygon, dir_x, dir_y, radius, reach):
    """Distance from the origin at which a disc coming from ``-reach * dir`` touches a polygon; -1 if it passes.

    Each step is the distance that is certainly free, so that no contact is skipped.
    """
    at = reach
    for _ in range(500):
        gap = polygon_distance(-at * dir_x, -at * dir_y, polygon) - radius
        if gap < 1e-9:
            return at
        at -= gap
        if at < -reach:
            return -1.0
    return at
