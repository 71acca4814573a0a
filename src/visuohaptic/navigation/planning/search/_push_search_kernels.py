"""Kernels of pushing on a grid: collision-free push distance, and where a push clears a passage.

All lengths are in cells, points are (x, y) with cell (row, column) covering
``column..column + 1`` and ``row..row + 1``.
"""

from __future__ import annotations

import math

import numpy as np

from ....core.kernels import kernel
from ...pushing._outline_kernels import inside_polygon, polygon_distance
from ._travel_kernels import clearance_at


@kernel
def free_push_steps(
    occupied: np.ndarray,
    clearance: np.ndarray,
    outline: np.ndarray,
    around: np.ndarray,
    polygon: np.ndarray,
    others: np.ndarray,
    other_start: np.ndarray,
    other_points: np.ndarray,
    robot_x: float,
    robot_y: float,
    dir_x: float,
    dir_y: float,
    radius: float,
    limit: int,
) -> int:
    """How many whole cells an object and the robot behind it can move.

    ``outline`` holds points along the object's edge, a little inside; ``others`` the
    polygons of the other objects one after the other, ``other_points`` such points of theirs. One that lies in an
    occupied cell at the start (the object leans on a wall) is not looked at, so
    that the object may slide along the wall. ``around`` holds points outside the
    edge that are not looked at either where they begin in something: room that
    is not there need not be kept. ``clearance`` is that without the object.
    """
    rows, columns = occupied.shape
    k = len(outline)
    leans = np.zeros(k, np.bool_)
    for i in range(k):
        r, c = int(math.floor(outline[i, 1])), int(math.floor(outline[i, 0]))
        if r < 0 or c < 0 or r >= rows or c >= columns or occupied[r, c]:
            leans[i] = True
    moved = polygon.copy()
    count = len(other_start) - 1
    kept = np.empty((len(around), 2))
    roomy = 0
    for i in range(len(around)):
        px, py = around[i, 0], around[i, 1]
        r, c = int(math.floor(py)), int(math.floor(px))
        begins = r < 0 or c < 0 or r >= rows or c >= columns or occupied[r, c]
        for o in range(count):
            begins = begins or inside_polygon(px, py, others[other_start[o] : other_start[o + 1]])
        if not begins:
            kept[roomy, 0], kept[roomy, 1] = px, py
            roomy += 1
    boxes = np.empty((count, 4))
    for o in range(count):
        part = others[other_start[o] : other_start[o + 1]]
        boxes[o, 0], boxes[o, 1] = part[:, 0].min(), part[:, 1].min()
        boxes[o, 2], boxes[o, 3] = part[:, 0].max(), part[:, 1].max()
    x0, y0, x1, y1 = polygon[:, 0].min(), polygon[:, 1].min(), polygon[:, 0].max(), polygon[:, 1].max()
    near = np.zeros(count, np.bool_)
    for step in range(1, 2 * limit + 1):
        t = 0.5 * step
        x, y = robot_x + t * dir_x, robot_y + t * dir_y
        if clearance_at(clearance, x, y) < radius - 0.05:
            return (step - 1) // 2
        dx, dy = t * dir_x, t * dir_y
        close = False
        for o in range(count):
            near[o] = (
                x0 + dx <= boxes[o, 2]
                and x1 + dx >= boxes[o, 0]
                and y0 + dy <= boxes[o, 3]
                and y1 + dy >= boxes[o, 1]
            )
            close = close or near[o]
        for i in range(k):
            px, py = outline[i, 0] + t * dir_x, outline[i, 1] + t * dir_y
            r, c = int(math.floor(py)), int(math.floor(px))
            if r < 0 or c < 0 or r >= rows or c >= columns:
                return (step - 1) // 2
            if not leans[i] and occupied[r, c]:
                return (step - 1) // 2
            for o in range(count):
                if near[o] and inside_polygon(px, py, others[other_start[o] : other_start[o + 1]]):
                    return (step - 1) // 2
        for i in range(roomy):
            px, py = kept[i, 0] + t * dir_x, kept[i, 1] + t * dir_y
            r, c = int(math.floor(py)), int(math.floor(px))
            if r < 0 or c < 0 or r >= rows or c >= columns or occupied[r, c]:
                return (step - 1) // 2
            for o in range(count):
                if inside_polygon(px, py, others[other_start[o] : other_start[o + 1]]):
                    return (step - 1) // 2
        if not close:
            continue
        for i in range(len(polygon)):
            moved[i, 0] = polygon[i, 0] + t * dir_x
            moved[i, 1] = polygon[i, 1] + t * dir_y
        for o in range(len(other_points)):
            if inside_polygon(other_points[o, 0], other_points[o, 1], moved):
                return (step - 1) // 2
    return limit


@kernel
def opening_steps(
    without: np.ndarray,
    beyond: np.ndarray,
    goal_cells: np.ndarray,
    polygon: np.ndarray,
    dir_x: float,
    dir_y: float,
    radius: float,
    steps: int,
) -> np.ndarray:
    """For each push length, whether it may connect the robot with what is ``beyond``.

    Necessary, not sufficient: some cell that the object frees must touch the
    goal's component, or be the goal's own cell. A push that fails this needs
    another push after it.
    """
    rows, columns = without.shape
    c0 = max(0, int(math.floor(polygon[:, 0].min() - radius)))
    c1 = min(columns, int(math.ceil(polygon[:, 0].max() + radius)) + 1)
    r0 = max(0, int(math.floor(polygon[:, 1].min() - radius)))
    r1 = min(rows, int(math.ceil(polygon[:, 1].max() + radius)) + 1)
    opens = np.zeros(steps + 1, np.bool_)
    moved = polygon.copy()
    for r in range(r0, r1):
        for c in range(c0, c1):
            if without[r, c] < radius or polygon_distance(c + 0.5, r + 0.5, polygon) >= radius:
                continue
            u = r * columns + c
            touches = False
            for g in goal_cells:
                touches = touches or g == u
            for rr in range(max(r - 1, 0), min(r + 2, rows)):
                for cc in range(max(c - 1, 0), min(c + 2, columns)):
                    touches = touches or beyond[rr * columns + cc]
            if not touches:
                continue
            for step in range(1, steps + 1):
                if opens[step]:
                    continue
                for i in range(len(polygon)):
                    moved[i, 0] = polygon[i, 0] + step * dir_x
                    moved[i, 1] = polygon[i, 1] + step * dir_y
                if polygon_distance(c + 0.5, r + 0.5, moved) >= radius:
                    opens[step] = True
    return opens
