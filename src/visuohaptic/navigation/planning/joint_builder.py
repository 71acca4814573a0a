"""Extends the visual graph by the nodes that touch adds: the seven steps of Alt 2016, Sec. 4.2.1."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from ..graph.navigation_graph import NavigationGraph
from ..graph.regions import Regions
from ..grid.cost_grid import OBSTACLE_FROM
from ..problem.planning_problem import RobotModel
from .joint_graph import JointGraph, JointNode, NodeType, adjacency
from .search.search_domain import grid_from_world

__all__ = ["extend_graph"]

#: Step 7: an edge stays when it shortens the path between two neighbours by at least this fraction.
SIGNIFICANT = 0.05
#: Neighbours of one node, at most.
MAX_NEIGHBOURS = 64


def extend_graph(
    visual: NavigationGraph, regions: Regions, robot: RobotModel, kinds: Iterable[NodeType]
) -> JointGraph:
    """Add nodes to the visual graph by the seven steps of Sec. 4.2.1.

    Parameters
    ----------
    visual, regions
        Graph of the map as it is seen, with the regions of its nodes.
    robot
        Its radius and speeds are those that the layers were made for.
    kinds
        Manipulation, door, transparency and other nodes.

    Returns
    -------
    JointGraph
        With every node; one that cannot be passed has no edges.
    """
    builder = _Builder(visual, regions, robot)
    added = tuple(builder.node(kind, visual.nodes + index) for index, kind in enumerate(kinds))
    return JointGraph(visual, regions, robot, added)


class _Builder:
    """Arrays that all nodes of one extension use."""

    def __init__(self, visual: NavigationGraph, regions: Regions, robot: RobotModel) -> None:
        from .search._travel_kernels import UNITS

        self.visual, self.regions, self.robot = visual, regions, robot
        self.map = regions.layers.map
        self.radius = robot.radius_m / self.map.resolution_m * (1 - 1e-9)
        self.slow = robot.v_max_m_s / robot.v_min_m_s
        self.unit_s = self.map.resolution_m / robot.v_max_m_s / UNITS
        columns = self.map.shape[1]
        self.seeds = visual.node_cells[:, 0].astype(np.int64) * columns + visual.node_cells[:, 1]
        self.first, self.ends, self.edges = adjacency(visual.edges, visual.nodes)
        self.best = np.full(visual.nodes, np.inf)
        self.heap_cost = np.zeros(2 * len(visual.edges) + 2)
        self.heap_node = np.zeros(2 * len(visual.edges) + 2, dtype=np.int64)

    def node(self, kind: NodeType, number: int) -> JointNode:
        """Steps 1 to 7 for one object."""
        if not kind.in_map:
            return self._safety(kind, number)
        from ._node_kernels import node_in_window, useful_neighbours

        outline = grid_from_world(self.map, kind.outline_m)
        # Cells that the object denies are within the radius of it; what slows the robot on them, three radii on.
        margin = self.radius + 3.0
        low, high = outline.min(axis=0).tolist(), outline.max(axis=0).tolist()
        wide = self._window(low, high, margin + 3.0 * self.radius)
        task_s = kind.task_s(self.robot)
        none = np.zeros(0, np.int32)
        nothing = JointNode(kind, number, (-1, -1), none, np.zeros(0), task_s, none, none)
        if wide[1] <= wide[0] or wide[3] <= wide[2]:
            return nothing
        narrow = self._window(low, high, margin)
        start, region, names, costs = node_in_window(  # 1 to 6
            self.map.cells, OBSTACLE_FROM, not self.regions.layers.unknown_is_free, outline, wide, narrow,
            self.radius, self.slow, self.regions.seed, self.regions.potential,
            self.regions.unit_s / self.unit_s, MAX_NEIGHBOURS,
        )  # fmt: skip
        if start < 0:
            return nothing
        neighbours = np.searchsorted(self.seeds, names)
        drive_s = costs * self.unit_s
        # 7: of driving alone. What the task costs is for the search to weigh, and the figure of the text
        # shows nodes whose edges no plan would take.
        kept = useful_neighbours(
            self.first, self.ends, self.edges, self.visual.edge_cost_s, neighbours, drive_s, SIGNIFICANT,
            self.best, self.heap_cost, self.heap_node,
        )  # fmt: skip
        row, column = divmod(int(start), narrow[3] - narrow[2])
        return JointNode(
            kind, number, (row + narrow[0], column + narrow[2]), neighbours[kept].astype(np.int32),
            drive_s[kept], task_s, region, none,
        )  # fmt: skip

    def _safety(self, kind: NodeType, number: int) -> JointNode:
        """A node over free cells: its safety region replaces regions, edges through it are closed (Sec. 4.3.3)."""
        from ..pushing._outline_kernels import distance_patch

        rows, columns = self.map.shape
        outline = grid_from_world(self.map, kind.outline_m)
        patch, r0, c0 = distance_patch(outline, self.radius + 1.0)
        rr, cc = np.argwhere(patch < self.radius).T + np.array([[r0], [c0]])
        on_map = (rr >= 0) & (rr < rows) & (cc >= 0) & (cc < columns)
        cells = (rr * columns + cc)[on_map].astype(np.int32)
        cells = cells[self.regions.seed.ravel()[cells] >= 0]
        closed = np.zeros(0, np.int32)
        if len(cells) and len(self.visual.path_cells):
            path = self.visual.path_cells[:, 0].astype(np.int64) * columns + self.visual.path_cells[:, 1]
            hit = np.flatnonzero(np.isin(path, cells))
            closed = np.unique(np.searchsorted(self.visual.path_start, hit, side="right") - 1).astype(
                np.int32
            )
        task_s = kind.task_s(self.robot)
        touching = np.unique(self.visual.edges[closed]).astype(np.int32)
        drive_s = np.zeros(0)
        if np.isfinite(task_s) and len(touching):
            # Passing is possible after its task: to each end of a closed edge along that edge, half of it.
            drive_s = np.array(
                [
                    self.visual.edge_cost_s[closed][(self.visual.edges[closed] == node).any(axis=1)].min() / 2
                    for node in touching
                ]
            )
        else:
            touching = touching[:0]
        centre = np.floor(outline.mean(axis=0)).astype(int)
        return JointNode(
            kind, number, (int(centre[1]), int(centre[0])), touching, drive_s, task_s, cells, closed
        )

    def _window(self, low: list[float], high: list[float], margin: float) -> tuple[int, int, int, int]:
        """First and past-the-last row, first and past-the-last column of a window about a box (x, y)."""
        rows, columns = self.map.shape
        return (
            max(math.floor(low[1] - margin), 0),
            min(math.ceil(high[1] + margin) + 1, rows),
            max(math.floor(low[0] - margin), 0),
            min(math.ceil(high[0] + margin) + 1, columns),
        )
