"""Checks a plan in exact polygons and measures its collisions, in metres, and its driving cost.

A plan is a list of tasks as plain data: ``kind``, ``path_m`` of the robot's centre, and for a push ``object``,
``displacement_m`` and ``goal_m``. A fault states its depth; whether it is acceptable is decided by the caller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import shapely
from shapely.affinity import translate
from shapely.geometry.base import BaseGeometry

from .maps import Robot, World

__all__ = ["Fault", "Floor", "check_plan", "cost_s_per_m", "drive_seconds", "swept"]

#: Steps along a drive in which its cost is summed [m].
STEP_M = 0.005


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault that would occur when a plan is executed exactly."""

    task: int
    what: str
    depth_m: float  #: how far it is from being right


class Floor:
    """Solid walls and the current position of every body."""

    def __init__(
        self,
        solid: Sequence[BaseGeometry],
        bodies: Mapping[str, shapely.Polygon],
        tree: shapely.STRtree | None = None,
    ) -> None:
        self.solid = list(solid)
        self.tree = tree or shapely.STRtree(self.solid)
        self.bodies = dict(bodies)

    @classmethod
    def of(cls, world: World) -> Floor:
        """The exact floor of a world."""
        return cls(world.walls, {body.id: body.polygon for body in world.bodies})

    @classmethod
    def of_cells(cls, cells: np.ndarray, resolution_m: float, bodies: Mapping[str, shapely.Polygon]) -> Floor:
        """A map's floor: its occupied and unknown cells are closed squares, merged along the rows."""
        parts = []
        for row, line in enumerate((cells >= 50) | (cells < 0)):
            edges = np.flatnonzero(np.diff(np.concatenate([[0], line.view(np.int8), [0]])))
            parts += [
                shapely.box(a * resolution_m, row * resolution_m, b * resolution_m, (row + 1) * resolution_m)
                for a, b in zip(edges[::2], edges[1::2], strict=True)
            ]
        return cls(parts, bodies)

    def distance_m(self, points_m: np.ndarray, without: str = "") -> np.ndarray:
        """Distance of points (n, 2) to the nearest wall or body, one body left out."""
        points = shapely.points(np.asarray(points_m, dtype=float).reshape(-1, 2))
        distance = np.full(len(points), np.inf)
        if self.solid:
            pairs, found = self.tree.query_nearest(points, return_distance=True, all_matches=False)
            distance[pairs[0]] = found
        for name, body in self.bodies.items():
            if name != without:
                distance = np.minimum(distance, shapely.distance(body, points))
        return distance

    def gap_m(self, shape: BaseGeometry, without: str = "") -> tuple[float, str]:
        """Distance of a shape to the nearest obstacle, and its name."""
        near, name = float("inf"), "nothing"
        if self.solid:
            near = float(
                self.tree.query_nearest(shape, return_distance=True, all_matches=False)[1].min(initial=np.inf)
            )
            name = "a wall"
        for other, body in self.bodies.items():
            if other != without and (found := float(body.distance(shape))) < near:
                near, name = found, other
        return near, name

    def overlap_m(self, shape: BaseGeometry, without: str = "") -> tuple[float, str]:
        """Penetration depth of a shape, and the obstacle; 0 if it is free."""
        others = [self.solid[i] for i in self.tree.query(shape, predicate="intersects")]
        names = ["a wall"] * len(others)
        for other, body in self.bodies.items():
            if other != without and body.intersects(shape):
                others.append(body)
                names.append(other)
        worst, name = 0.0, ""
        for part, what in zip(others, names, strict=True):
            low, high = 0.0, 0.5
            while high - low > 1e-4:
                middle = 0.5 * (low + high)
                if shape.buffer(-middle, join_style="mitre").intersects(part):
                    low = middle
                else:
                    high = middle
            if low > worst:
                worst, name = low, what
        return worst, name


def swept(body: shapely.Polygon, shift_m: Sequence[float]) -> BaseGeometry:
    """Area swept by a shifted polygon: its start, its end and the parallelograms of its edges."""
    shift = np.asarray(shift_m, dtype=float)
    ring = np.array(body.exterior.coords)
    sides = np.stack([ring[:-1], ring[1:], ring[1:] + shift, ring[:-1] + shift], axis=1)
    parts = shapely.buffer(shapely.polygons(sides), 0.0)
    return shapely.union_all([body, translate(body, *shift), *parts])


def check_plan(
    floor: Floor, tasks: Sequence[Mapping[str, Any]], robot: Robot, start_m: Any, goal_m: Any
) -> list[Fault]:
    """All faults of a plan, in order; ``floor.bodies`` are afterwards where the plan leaves them.

    Clearances are those of the exact polygons that ``floor`` holds: no slack is given for cells.
    """
    faults: list[Fault] = []
    at = np.asarray(start_m, dtype=float)
    for number, task in enumerate(tasks):
        kind, path = task["kind"], np.asarray(task.get("path_m", ()), dtype=float).reshape(-1, 2)
        pushed = str(task.get("object", "")) if kind == "push" else ""
        if len(path):
            if (jump := float(np.hypot(*(path[0] - at)))) > 1e-4:
                faults.append(Fault(number, "begins where the robot is not", jump))
            at = path[-1]
        if kind in ("navigate", "push") and len(path) > 1:
            near, name = floor.gap_m(shapely.LineString(path), without=pushed)
            if near < robot.radius_m - 1e-6:
                faults.append(Fault(number, f"the robot is too near to {name}", robot.radius_m - near))
        if kind == "push":
            faults += _push_faults(floor, number, task, path, robot)
    if (off := float(np.hypot(*(at - np.asarray(goal_m, dtype=float))))) > 1e-4:
        faults.append(Fault(len(tasks), "ends where the goal is not", off))
    return faults


def _push_faults(
    floor: Floor, number: int, task: Mapping[str, Any], path: np.ndarray, robot: Robot
) -> list[Fault]:
    """Faults of the pushed body; moves it."""
    name = str(task["object"])
    body = floor.bodies[name]
    shift = np.asarray(task["displacement_m"], dtype=float)
    faults: list[Fault] = []
    depth, other = floor.overlap_m(swept(body, shift), without=name)
    if depth > 0:
        faults.append(Fault(number, f"{name} is pushed into {other}", depth))
    moved = translate(body, *shift)
    goal = np.asarray(task["goal_m"], dtype=float)
    if (off := float(np.hypot(moved.centroid.x - goal[0], moved.centroid.y - goal[1]))) > 1e-4:
        faults.append(Fault(number, "the goal of the push is not where it ends", off))
    if len(path) > 1:
        # From the approach pose to the last contact and back: the robot may touch the body, not enter it.
        entry = robot.radius_m - float(body.distance(shapely.Point(path[0])))
        last = robot.radius_m - float(moved.distance(shapely.LineString(path[1:])))
        for deep, what in ((entry, "begins"), (last, "ends")):
            if deep > 1e-6:
                faults.append(Fault(number, f"the push {what} inside {name}", deep))
    floor.bodies[name] = moved
    return faults


def cost_s_per_m(distance_m: np.ndarray, robot: Robot) -> np.ndarray:
    """Inverse speed at a clearance: 1 / v_min at the robot's radius, falling linearly to 1 / v_max at three radii."""
    part = np.clip((np.asarray(distance_m) / robot.radius_m - 1.0) / 2.0, 0.0, 1.0)
    return 1.0 / robot.v_min_m_s + part * (1.0 / robot.v_max_m_s - 1.0 / robot.v_min_m_s)


def drive_seconds(floor: Floor, path_m: np.ndarray, robot: Robot) -> float:
    """Duration of a drive: inverse speed along the path, by the trapezoidal rule in steps of 5 mm."""
    path = np.asarray(path_m, dtype=float)
    total = 0.0
    for a, b in pairwise(path):
        length = float(np.hypot(*(b - a)))
        count = max(2, int(np.ceil(length / STEP_M)) + 1)
        points = a + np.linspace(0, 1, count)[:, None] * (b - a)
        total += float(np.trapezoid(cost_s_per_m(floor.distance_m(points), robot), dx=length / (count - 1)))
    return total
