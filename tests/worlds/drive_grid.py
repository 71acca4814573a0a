"""Driving on a floor: Dijkstra on nodes with 16 neighbours, then string pulling on exact distances."""

from __future__ import annotations

import numpy as np
import shapely
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from .maps import Robot, World
from .plan_checks import Floor, cost_s_per_m, drive_seconds

__all__ = ["DriveGrid", "blocked", "grid_path", "pull_string"]

_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1))


class DriveGrid:
    """Nodes for the robot's centre and the cost of driving between them."""

    def __init__(self, world: World, step_m: float, walls: Floor) -> None:
        self.step_m, self.robot = step_m, world.robot
        self.shape = (round(world.size_m[1] / step_m), round(world.size_m[0] / step_m))
        rows, columns = np.mgrid[0 : self.shape[0], 0 : self.shape[1]]
        self.points = (np.column_stack([columns.ravel(), rows.ravel()]) + 0.5) * step_m
        self.clearance = walls.distance_m(self.points)
        index = np.arange(len(self.points)).reshape(self.shape)
        one, two, length = [], [], []
        for dy, dx in _STEPS:
            a = index[: self.shape[0] - dy, max(0, -dx) : self.shape[1] - max(0, dx)]
            b = index[dy:, max(0, dx) : self.shape[1] - max(0, -dx)]
            one.append(a.ravel())
            two.append(b.ravel())
            length.append(np.full(a.size, step_m * np.hypot(dy, dx)))
        free = self.clearance >= self.robot.radius_m
        self.one, self.two = np.concatenate(one), np.concatenate(two)
        keep = free[self.one] & free[self.two]
        self.one, self.two, self.length = self.one[keep], self.two[keep], np.concatenate(length)[keep]

    def clearance_with(self, bodies: list[shapely.Polygon]) -> np.ndarray:
        """Distance to walls and bodies at every node."""
        layer = self.clearance.copy()
        reach = 3.0 * self.robot.radius_m
        for body in bodies:
            x0, y0, x1, y1 = body.bounds
            near = (
                (self.points[:, 0] > x0 - reach)
                & (self.points[:, 0] < x1 + reach)
                & (self.points[:, 1] > y0 - reach)
                & (self.points[:, 1] < y1 + reach)
            )
            layer[near] = np.minimum(layer[near], shapely.distance(body, shapely.points(self.points[near])))
        return layer

    def field(self, clearance: np.ndarray, at_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Seconds from a point to every node, and the node before each."""
        cost = cost_s_per_m(clearance, self.robot)
        open_ = clearance >= self.robot.radius_m - 1e-9
        keep = open_[self.one] & open_[self.two]
        one, two = self.one[keep], self.two[keep]
        weight = self.length[keep] * 0.5 * (cost[one] + cost[two])
        near, seconds = self.near(clearance, at_m)
        n = len(self.points)
        rows = np.concatenate([one, two, np.full(len(near), n)])
        columns = np.concatenate([two, one, near])
        graph = csr_matrix(
            (np.concatenate([weight, weight, np.maximum(seconds, 1e-9)]), (rows, columns)), (n + 1, n + 1)
        )
        found, before = dijkstra(graph, indices=n, return_predecessors=True)
        return found, before

    def near(self, clearance: np.ndarray, at_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Free nodes within 1.6 steps of a point, and the seconds to them."""
        step = self.step_m
        column, row = np.floor(at_m / step).astype(int)
        rows = np.arange(max(0, row - 2), min(self.shape[0], row + 3))
        columns = np.arange(max(0, column - 2), min(self.shape[1], column + 3))
        nodes = (rows[:, None] * self.shape[1] + columns).ravel()
        far = np.hypot(*(self.points[nodes] - at_m).T)
        keep = (far < 1.6 * step) & (clearance[nodes] >= self.robot.radius_m - 1e-9)
        nodes, far = nodes[keep], far[keep]
        return nodes, far * cost_s_per_m(clearance[nodes], self.robot)


def blocked(world: World, step_m: float = 0.05) -> bool:
    """Whether the goal is unreachable over the nodes without moving a body."""
    grid = DriveGrid(world, step_m, Floor(world.walls, {}))
    layer = grid.clearance_with([body.polygon for body in world.bodies])
    near, _ = grid.near(layer, np.asarray(world.goal_m, dtype=float))
    seconds, _ = grid.field(layer, np.asarray(world.start_m, dtype=float))
    return not np.isfinite(seconds[near]).any()


def grid_path(grid: DriveGrid, layer: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The path over the nodes."""
    seconds, before = grid.field(layer, start)
    near, more = grid.near(layer, end)
    node = int(near[int((seconds[near] + more).argmin())])
    points = [end]
    while node < len(grid.points):
        points.append(grid.points[node])
        node = int(before[node])
    return np.array([*points, start])[::-1]


def pull_string(floor: Floor, path: np.ndarray, robot: Robot, rounds: int = 4) -> np.ndarray:
    """Best subsequence of the path's points under straight chords, repeated on points between its corners."""
    best = drive_seconds(floor, path, robot)
    for _ in range(rounds):
        cost, came = np.full(len(path), np.inf), np.zeros(len(path), dtype=int)
        cost[0] = 0.0
        for i in range(len(path) - 1):
            chords = _chords(floor, path[i], path[i + 1 :], robot) + cost[i]
            better = chords < cost[i + 1 :]
            cost[i + 1 :][better] = chords[better]
            came[i + 1 :][better] = i
        if not cost[-1] < best * (1.0 - 1e-4):
            break
        best, kept = float(cost[-1]), [len(path) - 1]
        while kept[-1]:
            kept.append(int(came[kept[-1]]))
        path = _between(path[kept[::-1]], 48)
    return path


def _chords(floor: Floor, start: np.ndarray, ends: np.ndarray, robot: Robot) -> np.ndarray:
    """Seconds of straight drives from a point to several; infinite where the robot does not fit."""
    lengths = np.hypot(*(ends - start).T)
    count = np.maximum(2, np.ceil(lengths / 0.02).astype(int) + 1)
    part = np.concatenate([np.linspace(0, 1, n) for n in count])
    of = np.repeat(np.arange(len(ends)), count)
    distance = floor.distance_m(start + part[:, None] * (ends - start)[of])
    value = cost_s_per_m(distance, robot)
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    sums = np.add.reduceat(value, first) - 0.5 * (value[first] + value[first + count - 1])
    seconds = np.where(lengths > 0, sums * lengths / (count - 1), 0.0)
    return np.where(np.minimum.reduceat(distance, first) >= robot.radius_m - 1e-6, seconds, np.inf)


def _between(path: np.ndarray, count: int) -> np.ndarray:
    """The corners of a path and points between them."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    places = np.union1d(along, np.linspace(0.0, along[-1], count))
    return np.column_stack([np.interp(places, along, path[:, axis]) for axis in (0, 1)])
