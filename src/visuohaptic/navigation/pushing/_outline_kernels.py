"""Kernels on outlines in cells: distances from polygons, patches of them, and where a disc touches.

All lengths are in cells, points are (x, y) with cell (row, column) covering
``column..column + 1`` and ``row..row + 1``.
"""

from __future__ import annotations

import math

import numpy as np

from ...core.kernels import kernel


@kernel
def segment_distance(px: float, py: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Distance of a point from a segment."""
    dx, dy = bx - ax, by - ay
    length2 = dx * dx + dy * dy
    t = 0.0
    if length2 > 0.0:
        t = min(max(((px - ax) * dx + (py - ay) * dy) / length2, 0.0), 1.0)
    return math.hypot(px - ax - t * dx, py - ay - t * dy)


@kernel
def inside_polygon(px: float, py: float, polygon: np.ndarray) -> bool:
    """Even-odd rule."""
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
def polygon_distance(px: float, py: float, polygon: np.ndarray) -> float:
    """Distance of a point from a filled polygon; 0 inside."""
    if inside_polygon(px, py, polygon):
        return 0.0
    best = np.inf
    n = len(polygon)
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        d = segment_distance(px, py, polygon[i, 0], polygon[i, 1], polygon[j, 0], polygon[j, 1])
        best = min(best, d)
    return best


@kernel
def extent(polygon: np.ndarray) -> tuple[float, float, float, float]:
    """Smallest and largest x, smallest and largest y."""
    x_min, x_max, y_min, y_max = np.inf, -np.inf, np.inf, -np.inf
    for i in range(len(polygon)):
        x_min, x_max = min(x_min, polygon[i, 0]), max(x_max, polygon[i, 0])
        y_min, y_max = min(y_min, polygon[i, 1]), max(y_max, polygon[i, 1])
    return x_min, x_max, y_min, y_max


@kernel
def distance_patch(rows: int, columns: int, polygon: np.ndarray, reach: float) -> tuple[np.ndarray, int, int]:
    """Distance of the cells around a polygon from it, and the first row and column of the patch."""
    x_min, x_max, y_min, y_max = extent(polygon)
    c0 = min(columns, max(0, int(math.floor(x_min - reach))))
    c1 = max(c0, min(columns, int(math.ceil(x_max + reach)) + 1))
    r0 = min(rows, max(0, int(math.floor(y_min - reach))))
    r1 = max(r0, min(rows, int(math.ceil(y_max + reach)) + 1))
    patch = np.empty((r1 - r0, c1 - c0), np.float32)
    for r in range(r0, r1):
        for c in range(c0, c1):
            patch[r - r0, c - c0] = polygon_distance(c + 0.5, r + 0.5, polygon)
    return patch, r0, c0


@kernel
def disc_touches_at(polygon: np.ndarray, dir_x: float, dir_y: float, radius: float, reach: float) -> float:
    """How far from the origin a disc stops that comes from ``-reach * dir`` towards a polygon; -1 when it passes.

    Steps by the distance that is surely free, so that nothing is jumped over.
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
