"""Proofs, independent of the planner, that a task has no plan: exhaustive search of a relaxed task.

The relaxation covers every push by which a body moves away from the robot: straight in any direction, of any
length, with the body turning or not. Bodies are the discs inscribed in their outlines, robot and bodies are smaller
by the rounding of positions to a grid, any body in reach of the robot may move by a cell in any direction in
which the robot is not ahead, and the robot may be anywhere in its part of the free space. If even then no sequence
leads to the goal, no plan exists. The converse does not hold.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np
import shapely

from .maps import World
from .plan_checks import Floor

__all__ = ["impossible"]

#: A point and the grid node nearest to it are at most half a diagonal apart.
HALF_DIAGONAL = 0.5 * 2**0.5


def impossible(world: World, *, step_m: float = 0.05, max_states: int = 6000) -> bool | None:
    """True where no plan exists; False where the relaxed task has a solution; None where it was too large.

    Without some of the movable bodies the task is easier again: none is tried first, then each alone, then pairs.
    """
    movable = [body for body in world.bodies if not body.fixed]
    fixed = tuple(body for body in world.bodies if body.fixed)
    verdict: bool | None = False
    for count, steps_m in ((0, (step_m,)), (1, (step_m, 0.5 * step_m)), (2, (step_m,))):
        for chosen in combinations(movable, count):
            for step in steps_m:  # a finer grid rounds less, and proves more
                verdict = _exhausted(replace(world, bodies=(*fixed, *chosen)), step, max_states)
                if verdict:
                    return True
    return verdict if len(movable) <= 2 else None


def _exhausted(world: World, step_m: float, max_states: int) -> bool | None:
    """Search of the relaxed task with all bodies of a world."""
    slack = HALF_DIAGONAL * step_m
    walls = Floor([*world.walls, *(body.polygon for body in world.bodies if body.fixed)], {})
    shape = (round(world.size_m[1] / step_m), round(world.size_m[0] / step_m))
    rows, columns = np.mgrid[0 : shape[0], 0 : shape[1]]
    points = (np.column_stack([columns.ravel(), rows.ravel()]) + 0.5) * step_m
    clearance = walls.distance_m(points).reshape(shape)
    radius_m = world.robot.radius_m - slack
    inner, outer, places = [], [], []
    for body in world.bodies:
        if body.fixed:
            continue
        circle = shapely.maximum_inscribed_circle(body.polygon)
        centre = np.array(circle.coords[0])
        inner.append(float(circle.length) - slack)
        outer.append(float(np.hypot(*(body.outline_m - centre).T).max()))
        places.append(tuple(int(v) for v in np.floor(centre[::-1] / step_m)))
    free = clearance >= radius_m
    xy = points.reshape(*shape, 2)

    def parts(state: tuple[tuple[int, int], ...]) -> np.ndarray:
        open_ = free.copy()
        for (row, column), r in zip(state, inner, strict=True):
            open_ &= (
                np.hypot(xy[..., 0] - xy[row, column, 0], xy[..., 1] - xy[row, column, 1]) >= r + radius_m
            )
        return cv2.connectedComponents(open_.astype(np.uint8), connectivity=8)[1]

    start, goal = (
        tuple(int(v) for v in np.floor(np.array(p)[::-1] / step_m)) for p in (world.start_m, world.goal_m)
    )
    first = tuple(places)
    label = parts(first)
    if label[start] == 0:
        return None
    # A state is the places of the bodies and the robot's part, named by its first cell.
    queue = [(first, label, int(label[start]))]
    seen = {(first, _first_cell(label, int(label[start])))}
    while queue:
        state, label, own = queue.pop()
        here = label == own
        if here[goal]:
            return False
        for index, (row, column) in enumerate(state):
            # Robot's centre to body's centre at contact, with both roundings and the body's inscribed disc off-centre.
            reach = world.robot.radius_m + outer[index] + 2 * slack
            off = xy[here] - xy[row, column]
            off = off[np.hypot(*off.T) <= reach]
            if not len(off):
                continue
            for dy in (-1, 0, 1):
                for dx in (-1, 0, 1):
                    there = (row + dy, column + dx)
                    if (dy == 0 and dx == 0) or not _fits(there, index, state, inner, clearance, xy):
                        continue
                    ahead = (off @ (dx, dy)) / np.hypot(dx, dy)
                    if ahead.min() > 2 * slack:
                        continue  # the robot cannot pull
                    after = (*state[:index], there, *state[index + 1 :])
                    new = parts(after)
                    near = cv2.dilate(here.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
                    for number in np.unique(new[near]):
                        key = (after, _first_cell(new, int(number)))
                        if number and key not in seen:
                            seen.add(key)
                            queue.append((after, new, int(number)))
                            if len(seen) > max_states:
                                return None
    return True


def _first_cell(label: np.ndarray, number: int) -> int:
    return int(np.argmax(label == number))


def _fits(
    place: tuple[int, int],
    index: int,
    state: tuple[tuple[int, int], ...],
    inner: list[float],
    clearance: np.ndarray,
    xy: np.ndarray,
) -> bool:
    if not (0 <= place[0] < clearance.shape[0] and 0 <= place[1] < clearance.shape[1]):
        return False
    if clearance[place] < inner[index]:
        return False
    return all(
        np.hypot(*(xy[place] - xy[other])) >= inner[index] + inner[k]
        for k, other in enumerate(state)
        if k != index
    )
