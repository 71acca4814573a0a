"""The visuo-haptic graph: the visual graph and what touch adds to it (Alt 2016, Sec. 4.2.1).

The visual graph is extended, never modified. A node of another kind is a small
class: see :class:`NodeType`, and ``node_types.py`` for those that there are.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Protocol

import numpy as np
from jaxtyping import Float, Int, Int32

from ...core.errors import InputError
from ..graph.navigation_graph import NavigationGraph
from ..graph.regions import Regions
from ..problem.planning_problem import RobotModel

__all__ = ["JointGraph", "JointNode", "JointPath", "NodeType"]

#: First entry of every node, and by entry: the other end, the edge; by edge: its cost.
_Rows = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class NodeType(Protocol):
    """What a kind of node says of itself; its local planner goes by the name ``planner``."""

    @property
    def id(self) -> str:
        """Name on the map."""

    @property
    def planner(self) -> str:
        """Local planner that is started when the robot enters the node's region."""

    @property
    def outline_m(self) -> Float[np.ndarray, "p 2"]:
        """Place on the floor, map frame."""

    @property
    def in_map(self) -> bool:
        """Whether the map shows it as occupied cells (an object), or not at all (glass)."""

    def task_s(self, robot: RobotModel) -> float:
        """Time of its task [s]; infinite when the passage is not to be taken.

        Parameters
        ----------
        robot
            The platform.
        """

    def failure_probability(self, robot: RobotModel) -> float:
        """Probability that the task fails.

        Parameters
        ----------
        robot
            The platform.
        """


@dataclass(frozen=True, slots=True, eq=False)
class JointNode:
    """One node that touch, or something else than the map, has added."""

    kind: NodeType
    number: int  #: node number in the joint graph: after those of the visual graph
    cell: tuple[int, int]  #: (row, column), (-1, -1) when the robot does not fit there even then
    neighbours: Int32[np.ndarray, "k"]  #: nodes of the visual graph
    drive_s: Float[np.ndarray, "k"]  #: time between them and the node, without the task
    task_s: float  #: ``t_mani``; half of it is on each edge
    region: Int32[np.ndarray, "c"]  #: cells (row * columns + column) assigned to the node
    blocked_edges: Int32[np.ndarray, "b"]  #: edges of the visual graph that run through a safety region

    @property
    def edge_s(self) -> Float[np.ndarray, "k"]:
        """Costs of its edges: driving and half of the task."""
        return self.drive_s + 0.5 * self.task_s


@dataclass(frozen=True, slots=True)
class JointPath:
    """A path through the joint graph."""

    nodes: tuple[int, ...]  #: visual nodes first by number, then joint nodes
    cost_s: float
    added: tuple[str, ...]  #: ids of the joint nodes on it


@dataclass(frozen=True, slots=True, eq=False)
class JointGraph:
    """The visual graph, its regions, and the nodes that were added."""

    visual: NavigationGraph
    regions: Regions
    robot: RobotModel
    added: tuple[JointNode, ...] = ()
    _scratch: dict[bool, _Rows] = field(default_factory=dict, repr=False)

    def node(self, id: str) -> JointNode:
        """The added node of an object.

        Parameters
        ----------
        id
            Id of the object.

        Raises
        ------
        InputError
            There is none of that name.
        """
        for node in self.added:
            if node.kind.id == id:
                return node
        names = ", ".join(node.kind.id for node in self.added) or "none"
        raise InputError("JointGraph", f"has no node '{id}', there are: {names}")

    def without(self, id: str) -> JointGraph:
        """The graph without a node, for instance of an obstacle that was not confirmed.

        Parameters
        ----------
        id
            Id of the object.
        """
        self.node(id)
        return replace(self, added=tuple(node for node in self.added if node.kind.id != id), _scratch={})

    def failed(self, id: str) -> JointGraph:
        """The graph after a failure: the edges of the node cost infinitely much.

        Parameters
        ----------
        id
            Id of the object.
        """
        return self._with_task(id, float("inf"))

    def cleared(self, id: str) -> JointGraph:
        """The graph after a success: the node becomes one of navigation, its edges lose half the task each.

        Parameters
        ----------
        id
            Id of the object.
        """
        return self._with_task(id, 0.0)

    def _worth(
        self, left: dict[str, tuple[float, np.ndarray]], at: Float[np.ndarray, "2"], id: str
    ) -> tuple[bool, float]:
        """What exploring next is worth: opening something separate above all, then gain per path length."""
        gain_s, centre = left[id]
        way_s = float(np.hypot(*(centre - at))) / self.robot.v_max_m_s
        if not np.isfinite(gain_s):
            return True, 1.0 / (way_s + 1.0)
        return False, (gain_s + 1.0) / (way_s + 1.0)

    def _with_task(self, id: str, task_s: float) -> JointGraph:
        self.node(id)
        return replace(
            self,
            added=tuple(replace(node, task_s=task_s) if node.kind.id == id else node for node in self.added),
            _scratch={},
        )

    def edges(self) -> tuple[Int32[np.ndarray, "m 2"], Float[np.ndarray, "m"]]:
        """All edges with costs: the visual ones in their order, those through safety regions infinite, then added ones."""
        cost = self.visual.edge_cost_s.copy()
        for node in self.added:
            cost[node.blocked_edges] = np.inf
        ends = [self.visual.edges]
        costs = [cost]
        for node in self.added:
            ends.append(
                np.column_stack([node.neighbours, np.full(len(node.neighbours), node.number, np.int32)])
            )
            costs.append(node.edge_s)
        return np.concatenate(ends).astype(np.int32), np.concatenate(costs)

    def shortest(self, start: int, goal: int, *, visual_only: bool = False) -> JointPath:
        """Cheapest path between two nodes by Dijkstra; infinite cost and no nodes when there is none.

        Parameters
        ----------
        start, goal
            Indices of the nodes.
        visual_only
            Whether added nodes are left out.
        """
        from heapq import heappop, heappush

        first, ends, edges, costs = self._csr(visual_only)
        best = {start: 0.0}
        came: dict[int, int] = {}
        queue = [(0.0, start)]
        while queue:
            cost, node = heappop(queue)
            if node == goal:
                break
            if cost > best[node]:
                continue
            for k in range(first[node], first[node + 1]):
                other, total = int(ends[k]), cost + float(costs[edges[k]])
                if total < best.get(other, np.inf):
                    best[other], came[other] = total, node
                    heappush(queue, (total, other))
        if goal not in best:
            return JointPath((), float("inf"), ())
        nodes = [goal]
        while nodes[-1] != start:
            nodes.append(came[nodes[-1]])
        nodes.reverse()
        names = {node.number: node.kind.id for node in self.added}
        return JointPath(tuple(nodes), best[goal], tuple(names[n] for n in nodes if n in names))

    def _csr(self, visual_only: bool) -> _Rows:
        if visual_only not in self._scratch:
            ends, costs = (self.visual.edges, self.visual.edge_cost_s) if visual_only else self.edges()
            self._scratch[visual_only] = (*adjacency(ends, self.visual.nodes + len(self.added)), costs)
        return self._scratch[visual_only]

    def benefit_s(self, id: str) -> float:
        """By how much a node shortens the path between any two of its neighbours [s]: Eq. (4.2), corrected.

        Infinite when it connects what was separate.

        Parameters
        ----------
        id
            Id of the object.
        """
        node = self.node(id)
        best = 0.0
        for i, a in enumerate(node.neighbours):
            for b in node.neighbours[i + 1 :]:
                visual = self.shortest(int(a), int(b), visual_only=True).cost_s
                joint = self.shortest(int(a), int(b)).cost_s
                if np.isfinite(joint) and visual > joint:
                    best = max(best, visual - joint)
        return best

    def exploration_order(self, robot_m: Float[np.ndarray, "2"], ids: Iterable[str]) -> list[str]:
        """Objects to explore one by one: the benefit per path length, nearest of equals first (Sec. 4.4).

        Parameters
        ----------
        robot_m
            Where the robot is: x, y [m], map frame.
        ids
            Ids of the objects.
        """
        left = {id: (self.benefit_s(id), self.node(id).kind.outline_m.mean(axis=0)) for id in ids}
        at = np.asarray(robot_m, dtype=np.float64)
        order: list[str] = []
        while left:
            best = max(left, key=partial(self._worth, left, at))
            at = left.pop(best)[1]
            order.append(best)
        return order


def adjacency(
    ends: Int32[np.ndarray, "m 2"], nodes: int
) -> tuple[Int[np.ndarray, "n+1"], Int[np.ndarray, "e"], Int[np.ndarray, "e"]]:
    """CSR form of an undirected graph: where each node's entries begin, the other ends, the edges."""
    source = np.concatenate([ends[:, 0], ends[:, 1]]).astype(np.int64)
    target = np.concatenate([ends[:, 1], ends[:, 0]]).astype(np.int64)
    edge = np.tile(np.arange(len(ends)), 2)
    order = source.argsort(kind="stable")
    first = np.zeros(nodes + 1, dtype=np.int64)
    np.cumsum(np.bincount(source, minlength=nodes), out=first[1:])
    return first, target[order], edge[order]
