"""Proof that a convex footprint has no plan: no drive reaches the goal, or an object to push.

Poses are divided into boxes of places and headings. A box is closed if the part of the robot that is covered in all of
its poses overlaps an obstacle: every drive, also a sideward or backward one, leads through open boxes.
"""

from __future__ import annotations

import math

import numpy as np
import shapely
from jaxtyping import Bool, Int
from shapely.affinity import rotate, scale, translate

from ..arrays import Outline
from ..object_cells import window_around
from ..search.push_states import Deadline
from ..search.search_domain import SearchDomain
from . import _footprint_kernels as kernels
from .footprint_drives import FINE_M, FootprintDrives

#: Numbers of headings, tried in order, and the edge of a box times its number [m].
HEADINGS, EDGE_M = (72, 144), 1.44
#: Maximum number of boxes, of a byte each; with twice the headings and half the edge there are eight times as many.
MAX_BOXES, MORE = 50_000_000, 8


def proved_impossible(domain: SearchDomain, deadline: Deadline) -> bool:
    """Whether the robot's footprint reaches neither the goal nor a push, however it drives.

    Parameters
    ----------
    domain
        Static map and bodies.
    deadline
        Smaller boxes are tried if there is time for them.

    Returns
    -------
    ``False`` also where this is not known.
    """
    fine = FootprintDrives(domain).factor
    size_m = domain.map.resolution_m / fine
    if size_m > 1.01 * FINE_M:
        return False
    occupied = domain.occupied.repeat(fine, axis=0).repeat(fine, axis=1)
    for outline in (*domain.immovable_outlines, *(body.outline for body in domain.bodies)):
        _fill_inside(occupied, outline * fine)
    counts = np.pad(np.cumsum(occupied, axis=1, dtype=np.int32), ((0, 0), (1, 0)))
    pushes = [
        (*(fine * (body.centre + push.robot)), math.atan2(*push.direction[::-1]))
        for body in domain.bodies
        for push in body.with_oblique
    ]
    goals = np.array([(*(fine * domain.goal), math.nan), *pushes])
    goals = goals[((goals[:, :2] >= 0) & (goals[:, :2] < occupied.shape[::-1])).all(axis=1)]
    robot = shapely.Polygon(np.array(domain.robot.footprint_m) / size_m).convex_hull
    took_s = 0.0
    for count in HEADINGS:
        edge, left_s = max(1, round(EDGE_M / count / size_m)), deadline.left_s
        if left_s < MORE * took_s or occupied.size // edge**2 * count > MAX_BOXES:
            break
        if not kernels.reaches(counts, *_covered(robot, edge, count), edge, fine * domain.start, goals):
            return True
        took_s = left_s - deadline.left_s
    return False


def _fill_inside(occupied: Bool[np.ndarray, "r c"], outline: Outline) -> None:
    """Mark the cells that are inside of an outline entirely, in place."""
    rows, columns = window_around(occupied.shape, outline, 0.0)
    x, y = np.meshgrid(np.arange(columns.start, columns.stop), np.arange(rows.start, rows.stop))
    occupied[rows, columns] |= shapely.covers(shapely.Polygon(outline), shapely.box(x, y, x + 1, y + 1))


def _covered(
    robot: shapely.Polygon, edge: int, count: int
) -> tuple[Int[np.ndarray, "n 3"], Int[np.ndarray, "m"]]:
    """Cells that are covered in all poses of a box, for each heading: runs from its corner, and the first of each heading."""
    half = math.pi / count
    turned = [rotate(robot, angle, (0, 0), use_radians=True) for angle in (half, -half)]
    core = shapely.intersection_all([*turned, scale(robot, math.cos(half), math.cos(half), origin=(0, 0))])
    runs = [np.zeros((0, 3), np.int64)]
    for k in range(count):
        placed = rotate(core, 2.0 * half * k, (0, 0), use_radians=True)
        inner = shapely.intersection_all([translate(placed, x, y) for x in (0, edge) for y in (0, edge)])
        runs.append(kernels.hull_runs(shapely.get_coordinates(inner)) if inner.area > 0.0 else runs[0])
    return np.concatenate(runs), np.cumsum([0, *map(len, runs[1:])])
