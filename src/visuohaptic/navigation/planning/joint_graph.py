"""The visuo-haptic graph: the visual graph and its haptic extension (Alt 2016, Sec. 4.2.1).

The visual graph is extended, never modified; ``node_types.py`` has the kinds of nodes.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Float32, Int, Int32

from ...core.errors import InputError
from ..graph import NavigationGraph, Regions
from ..problem.node_types import NodeType


@dataclass(frozen=True, slots=True, eq=False)
class JointNode:
    """A node added to the visual graph."""

    kind: NodeType
    number: int  #: node number in the joint graph: after those of the visual graph
    cell: tuple[int, int]  #: (row, column), (-1, -1) if the robot does not fit there even without the object
    neighbours: Int32[np.ndarray, "k"]  #: nodes of the visual graph
    drive_s: Float[np.ndarray, "k"]  #: time between them and the node, without the task
    task_s: float  #: ``t_mani``; half of it is on each edge
    region: Int32[np.ndarray, "c"]  #: cells (row * columns + column) assigned to the node
    blocked_edges: Int32[np.ndarray, "b"]  #: edges of the visual graph through a safety region
    #: cells (row, column) from the node into the region of each neighbour
    ways: tuple[Int[np.ndarray, "n 2"], ...] = ()
    #: clearance without the object [cells] in a window around it, and rows and columns of that window
    clearance: Float32[np.ndarray, "r c"] = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    window: tuple[slice, slice] = (slice(0, 0), slice(0, 0))

    @property
    def edge_s(self) -> Float[np.ndarray, "k"]:
        """Costs of its edges: driving and half of the task."""
        return self.drive_s + 0.5 * self.task_s


@dataclass(frozen=True, slots=True, eq=False)
class JointGraph:
    """The visual graph, its regions, and the added nodes."""

    visual: NavigationGraph
    regions: Regions
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
            The graph has no node of that object.
        """
        for node in self.added:
            if node.kind.id == id:
                return node
        names = ", ".join(node.kind.id for node in self.added) or "none"
        raise InputError("JointGraph", f"has no node '{id}', there are: {names}")

    def edges(self) -> tuple[Int32[np.ndarray, "m 2"], Float[np.ndarray, "m"]]:
        """All edges with costs: the visual ones in order, infinite through safety regions, then the added ones."""
        cost = self.visual.edge_cost_s.copy()
        for node in self.added:
            cost[node.blocked_edges] = np.inf
        added = [np.column_stack([n.neighbours, np.full_like(n.neighbours, n.number)]) for n in self.added]
        costs = np.concatenate([cost, *(node.edge_s for node in self.added)])
        return np.concatenate([self.visual.edges, *added]).astype(np.int32), costs

    def benefit_s(self, id: str) -> float:
        """Maximum reduction of the path cost between any two of its neighbours by a node [s]: Eq. (4.2), corrected.

        Infinite if it connects separate components.

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
    """Costs of the cheapest paths between some nodes of an undirected graph [s]; infinite without a path.

    Parameters
    ----------
    edges, cost_s
        Nodes of each edge and its cost [s]; among parallel edges the cheapest counts.
    nodes
        Number of nodes.
    ends
        Nodes between which costs are computed.
    limit_s
        Higher costs are reported as infinite [s].
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
