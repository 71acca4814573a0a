"""Collision checks of footprints on a costmap: does one fit at a pose, and would it block the passage around it?"""

from __future__ import annotations

import numpy as np

from ...core.kernels import kernel


@kernel
def distance_at(distance, grid, x, y):
    """Distance to the nearest obstacle at a point [m]; 0 outside the map.

    ``grid`` = (origin x, origin y, cos yaw, sin yaw, cells per metre).
    """
    dx, dy = x - grid[0], y - grid[1]
    column = int(np.floor((grid[2] * dx + grid[3] * dy) * grid[4]))
    row = int(np.floor((-grid[3] * dx + grid[2] * dy) * grid[4]))
    if row < 0 or column < 0 or row >= distance.shape[0] or column >= distance.shape[1]:
        return 0.0
    return float(distance[row, column])


@kernel
def fits(distance, grid, points, least, inside_m, reach_m, x, y, yaw):
    """Whether all ``points`` of a footprint at a pose are ``least`` away from obstacles.

    A circle of ``inside_m`` about the reference point lies in the footprint, and one of ``reach_m`` holds it.
    """
    centre = distance_at(distance, grid, x, y)
    if centre >= reach_m + least:
        return True
    if centre < inside_m:
        return False
    c, s = np.cos(yaw), np.sin(yaw)
    for i in range(points.shape[0]):
        px, py = x + c * points[i, 0] - s * points[i, 1], y + s * points[i, 0] + c * points[i, 1]
        if distance_at(distance, grid, px, py) < least:
            return False
    return True


@kernel
def samples_inside(distance, grid, points, least, inside_m, reach_m, x, y, yaw):
    """How many samples of a footprint at a pose are nearer to obstacles than ``least``."""
    if fits(distance, grid, points, least, inside_m, reach_m, x, y, yaw):
        return 0
    c, s = np.cos(yaw), np.sin(yaw)
    count = 1 if distance_at(distance, grid, x, y) < inside_m else 0
    for i in range(points.shape[0]):
        px, py = x + c * points[i, 0] - s * points[i, 1], y + s * points[i, 0] + c * points[i, 1]
        if distance_at(distance, grid, px, py) < least:
            count += 1
    return count


@kernel
def blocked_parts(distance, grid, ring, radius, x, y, yaw):
    """Number of runs of the closed ``ring`` where obstacles are nearer than ``radius``: Eq. (4.3)."""
    c, s = np.cos(yaw), np.sin(yaw)
    n = ring.shape[0]
    first = before = False
    count = 0
    for i in range(n):
        px, py = x + c * ring[i, 0] - s * ring[i, 1], y + s * ring[i, 0] + c * ring[i, 1]
        now = distance_at(distance, grid, px, py) < radius
        if i == 0:
            first = now
        if now and (i == 0 or not before):
            count += 1
        before = now
    if count > 1 and first and before:
        count -= 1
    return count


@kernel
def push_goals(
    distance,
    from_path,
    grid,
    points,
    ring,
    outline,
    least,
    inside_m,
    reach_m,
    radius,
    limit,
    yaw,
    x0,
    y0,
    goal,
    free,
):
    """Fill ``free`` (the footprint fits there) and ``goal`` (Eq. (4.3), and the path is unblocked) by cell."""
    rows, columns = distance.shape
    c, s = np.cos(yaw), np.sin(yaw)
    for row in range(rows):
        for column in range(columns):
            gx, gy = (column + 0.5) / grid[4], (row + 0.5) / grid[4]
            x = grid[0] + grid[2] * gx - grid[3] * gy
            y = grid[1] + grid[3] * gx + grid[2] * gy
            if (x - x0) ** 2 + (y - y0) ** 2 > limit * limit:
                continue
            if not fits(distance, grid, points, least, inside_m, reach_m, x, y, yaw):
                continue
            free[row, column] = True
            clear = True
            for i in range(outline.shape[0]):
                px, py = x + c * outline[i, 0] - s * outline[i, 1], y + s * outline[i, 0] + c * outline[i, 1]
                if distance_at(from_path, grid, px, py) < radius:
                    clear = False
                    break
            if clear and blocked_parts(distance, grid, ring, radius, x, y, yaw) <= 1:
                goal[row, column] = True


@kernel
def first_clash(distance, grid, points, least, inside_m, reach_m, poses, rows):
    """First of the first ``rows`` poses at which the footprint clashes; ``rows`` when none does.

    An object that stands at a wall begins with samples too near to it: what
    counts is that they do not become more, and none once it was free.
    """
    allowed = points.shape[0] + 1
    for i in range(rows):
        if i > 0 and poses[i, 0] == poses[i - 1, 0] and poses[i, 1] == poses[i - 1, 1]:
            continue
        near = samples_inside(
            distance, grid, points, least, inside_m, reach_m, poses[i, 0], poses[i, 1], poses[i, 2]
        )
        if near > allowed:
            return i
        allowed = near
    return rows


@kernel
def first_goal(
    distance, from_path, grid, points, ring, border, least, inside_m, reach_m, radius, objects, platforms
):
    """Row of the first pose that is a push goal when all before it are clear; -1 when there is none."""
    clash = first_clash(distance, grid, points, least, inside_m, reach_m, objects, objects.shape[0])
    for i in range(clash):
        x, y, yaw = objects[i, 0], objects[i, 1], objects[i, 2]
        if distance_at(distance, grid, platforms[i, 0], platforms[i, 1]) < radius:
            return -1
        if i == 0 or not fits(distance, grid, points, least, inside_m, reach_m, x, y, yaw):
            continue
        c, s = np.cos(yaw), np.sin(yaw)
        clear = True
        for j in range(border.shape[0]):
            px, py = x + c * border[j, 0] - s * border[j, 1], y + s * border[j, 0] + c * border[j, 1]
            if distance_at(from_path, grid, px, py) < radius:
                clear = False
                break
        if clear and blocked_parts(distance, grid, ring, radius, x, y, yaw) <= 1:
            return i
    return -1
