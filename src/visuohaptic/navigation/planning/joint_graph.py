"""The visuo-haptic graph: the visual graph and what touch adds to it (Alt 2016, Sec. 4.2.1).

The visual graph is extended, never modified. A node of another kind is a small
class: see :class:`NodeType`, and ``node_types.py`` for those that there are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float, Int, Int32

from ...core.errors import InputError
from ..graph.navigation_graph import NavigationGraph
from ..graph.regions import Regions
from ..problem.planning_problem import RobotModel

__all__ = ["JointGraph", "JointNode", "NodeType", "costs_between"]


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


@dataclass(frozen=True, slots=True, eq=False)
class JointGraph:
    """The visual graph, its regions, and the nodes that were added."""

    visual: NavigationGraph
    regions: Regions
    robot: RobotModel
    added: tuple[JointNode, ...] = ()

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

    def benefit_s(self, id: str) -> float:
        """By how much a node shortens the path between any two of its neighbours [s]: Eq. (4.2), corrected.

        Infinite when it connects what was separate.

        Parameters
        ----------
        id
            Id of the object.
        """
        ends, visual, nodes = self.node(id).neighbours, self.visual, self.visual.nodes + len(self.added)
        before_s = costs_between(visual.edges, visual.edge_cost_s, nodes, ends)
        after_s = costs_between(*self.edges(), nodes, ends)
        known = np.isfinite(after_s) & (before_s > after_s)
        return float((before_s[known] - after_s[known]).max(initial=0.0))


def costs_between(
    edges: Int32[np.ndarray, "m 2"],
    cost_s: Float[np.ndarray, "m"],
    nodes: int,
    ends: Int[np.ndarray, "k"],
    *,
    limit_s: float = float("inf"),
) -> Float[np.ndarray, "k k"]:
    """Costs of the cheapest paths between some nodes of an undirected graph [s]; infinite where there is none.

    Parameters
    ----------
    edges, cost_s
        Nodes of each edge and its cost [s]; of parallel edges the cheapest counts.
    nodes
        How many there are.
    ends
        Nodes in question.
    limit_s
        What costs more is infinite [s].
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    low, high = edges.min(axis=1, initial=nodes), edges.max(axis=1, initial=0)
    order = np.lexsort((cost_s, high, low))
    low, high, cost_s = low[order], high[order], cost_s[order]
    first = np.isfinite(cost_s) & (low < high)
    first[1:] &= (low[1:] != low[:-1]) | (high[1:] != high[:-1])
    graph = csr_array((cost_s[first], (low[first], high[first])), shape=(nodes, nodes))
    return np.asarray(dijkstra(graph, directed=False, indices=ends, limit=limit_s)[:, ends])
