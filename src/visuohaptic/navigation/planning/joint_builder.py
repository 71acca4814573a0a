"""Extension of the visual graph by haptic nodes: the seven steps of Alt 2016, Sec. 4.2.1."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool, Float, Int

from ..graph.navigation_graph import NavigationGraph
from ..graph.regions import Regions
from ..grid.cost_grid import OBSTACLE_FROM, window_distance
from ..problem.node_types import NodeType
from ..problem.robot_model import RobotModel
from ..pushing._outline_kernels import distance_patch
from .arrays import Clearance, Nodes
from .joint_graph import JointGraph, JointNode, costs_between
from .object_cells import clear_cells, window_around
from .search import _travel_kernels
from .search._push_search_kernels import descend
from .search._travel_kernels import FAR, UNITS
from .search.search_domain import grid_from_world

#: Step 7: an edge is kept if it shortens the path between two neighbours by at least this fraction.
SIGNIFICANT = 0.05


def extend_graph(
    visual: NavigationGraph, regions: Regions, robot: RobotModel, kinds: Iterable[NodeType]
) -> JointGraph:
    """Add nodes to the visual graph by the seven steps of Sec. 4.2.1.

    Parameters
    ----------
    visual, regions
        Graph of the map from vision alone, with the regions of its nodes.
    robot
        Robot whose radius and speeds were used for the layers.
    kinds
        Manipulation, door, transparency and other nodes.

    Returns
    -------
    JointGraph
        With all nodes; a node that cannot be passed has no edges.
    """
    robot.check_disc("the joint graph is made")
    builder = _Builder(visual, regions, robot)
    added = tuple(builder.node(kind, visual.nodes + index) for index, kind in enumerate(kinds))
    return JointGraph(visual, regions, added)


class _Builder:
    """Arrays that are common to all nodes of one extension."""

    def __init__(self, visual: NavigationGraph, regions: Regions, robot: RobotModel) -> None:

        self.visual, self.regions = visual, regions
        self.map = regions.layers.map
        self.radius = robot.radius_m / self.map.resolution_m * (1 - 1e-9)
        self.slow = robot.v_max_m_s / robot.v_min_m_s
        self.unit_s = self.map.resolution_m / robot.v_max_m_s / UNITS
        columns = self.map.shape[1]
        self.seeds = visual.node_cells[:, 0].astype(np.int64) * columns + visual.node_cells[:, 1]

    def node(self, kind: NodeType, number: int) -> JointNode:
        """Steps 1 to 7 for one object."""
        if not kind.in_map:
            return self._safety(kind, number)
        import cv2

        outline = grid_from_world(self.map, kind.outline_m)
        # Cells blocked by the object are within one radius of it; cells with reduced speed within three.
        margin = self.radius + 3.0
        wide, narrow = (
            window_around(self.map.shape, outline, reach) for reach in (margin + 3.0 * self.radius, margin)
        )
        task_s = kind.task_s
        none = np.zeros(0, np.int32)
        nothing = JointNode(kind, number, (-1, -1), none, np.zeros(0), task_s, none, none)
        part, seeds = self.map.cells[wide], self.regions.seed[narrow]
        if not part.size:
            return nothing
        # 1 and 2: distances without the object.
        unknown_blocks = not self.regions.layers.unknown_is_free
        occupied = (part >= OBSTACLE_FROM) | (unknown_blocks & (part < 0))
        clear_cells(occupied, [outline - (wide[1].start, wide[0].start)])
        distance = window_distance(occupied, wide, self.map.shape, outside_blocks=unknown_blocks)
        (i0, i1), (j0, j1) = (
            (n.start - w.start, n.stop - w.start) for n, w in zip(narrow, wide, strict=True)
        )
        clearance = np.ascontiguousarray(distance[i0:i1, j0:j1])
        # 3 and 4: the node is nearest to the object's centre, its region is the connected component there.
        free = clearance >= self.radius
        own = free & (seeds < 0)
        if not own.any():
            return nothing
        corner = np.array([narrow[0].start, narrow[1].start])
        cells = np.argwhere(own) + corner
        middle = 0.5 * (outline.min(axis=0) + outline.max(axis=0))[::-1]
        start = cells[int(((cells + 0.5 - middle) ** 2).sum(axis=1).argmin())] - corner
        parts = cv2.connectedComponents(own.astype(np.uint8), connectivity=8)[1]
        mine = parts == parts[tuple(start)]
        rows, columns = np.nonzero(mine)
        region = ((rows + corner[0]) * self.map.shape[1] + columns + corner[1]).astype(np.int32)
        neighbours, drive_s, ways = self._neighbours(narrow, clearance, mine, start)
        row, column = (start + corner).tolist()
        return JointNode(
            kind, number, (row, column), neighbours, drive_s, task_s, region, none,
            ways, clearance, narrow,
        )  # fmt: skip

    def _neighbours(
        self,
        window: tuple[slice, slice],
        clearance: Clearance,
        mine: Bool[np.ndarray, "r c"],
        start: Int[np.ndarray, "2"],
    ) -> tuple[Nodes, Float[np.ndarray, "k"], tuple[Int[np.ndarray, "n 2"], ...]]:
        """Steps 5 to 7: nodes of adjacent regions to which an edge is worthwhile, the drives [s], the cells up to there."""
        import cv2

        # The path to a neighbour leads through the node's own region and across its border, not along it.
        reach = cv2.dilate(mine.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        begin = np.full(1, start[0] * mine.shape[1] + start[1], np.int32)
        none, seeds = np.zeros(0, np.int32), self.regions.seed[window]
        cost = _travel_kernels.travel_field(
            np.where(reach, clearance, np.float32(0.0)), self.radius, self.slow, begin, np.zeros(1, np.int32),
            np.zeros((0, 0), np.int16), none, none, 0, none,
        ).reshape(mine.shape)  # fmt: skip
        beside = reach & (clearance >= self.radius) & (seeds >= 0) & (cost < FAR)
        across = np.flatnonzero(beside)
        through_s = cost[beside] * self.unit_s + self.regions.potential[window][beside] * self.regions.unit_s
        # The cheapest way into each region.
        order = np.lexsort((through_s, seeds[beside]))
        names, first = np.unique(seeds[beside][order], return_index=True)
        drive_s, entered = through_s[order][first], across[order][first]
        neighbours = np.searchsorted(self.seeds, names).astype(np.int32)
        # 7: drives only. The search accounts for the cost of the task, and the dissertation's figure
        # shows nodes whose edges no plan would use.
        around_s = costs_between(
            self.visual.edges, self.visual.edge_cost_s, self.visual.nodes, neighbours,
            limit_s=2.0 * (1.0 + SIGNIFICANT) * float(drive_s.max(initial=0.0)),
        )  # fmt: skip
        shorter = drive_s[:, None] + drive_s < (1.0 - SIGNIFICANT) * around_s
        np.fill_diagonal(shorter, False)
        kept = shorter.any(axis=1)
        corner = np.array([window[0].start, window[1].start])
        ways = tuple(
            descend(cost.ravel(), clearance, begin, int(cell))[:, ::-1].astype(int) + corner
            for cell in entered[kept]
        )
        return neighbours[kept], drive_s[kept], ways

    def _safety(self, kind: NodeType, number: int) -> JointNode:
        """A node over free cells: its safety region replaces regions, edges through it are closed (Sec. 4.3.3)."""

        rows, columns = self.map.shape
        outline = grid_from_world(self.map, kind.outline_m)
        patch, r0, c0 = distance_patch(outline, self.radius)
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
        centre = np.floor(outline.mean(axis=0)).astype(int)
        cell, none = (int(centre[1]), int(centre[0])), np.zeros(0, np.int32)
        return JointNode(kind, number, cell, none, np.zeros(0), kind.task_s, cells, closed)
