"""Expected benefit of exploring an object, given those explored before it (Alt 2016, Eq. (4.2)).

Symbols: ``n`` unknown objects; ``M`` the set of those that were explored and can be pushed; ``D_M`` the costs between the
nodes next to unknown objects, over the visual graph and the manipulation nodes of ``M``. The benefit of object ``i`` after
``M`` is Eq. (4.2) with that graph in place of the visual one: the maximum of ``D_M - D_(M + i)`` over pairs of neighbours of
``i``. Every unknown object can be pushed with the same prior probability ``p``, independent of the others. Whether the
objects of a set ``S`` can be pushed is known only after the tour is planned, so the benefit of ``i`` after ``S`` is ``p``
times the mean over the random subset ``M`` of ``S``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int32

from ..joint_graph import JointGraph, JointNode, costs_between

#: Number of objects whose sets are evaluated in one array: 256 matrices.
AT_ONCE = 8


@dataclass(frozen=True, slots=True, eq=False)
class ExpectedBenefit:
    """Expected benefits by the set of objects explored before: bit ``k`` of the row stands for object ``k``."""

    #: probability that the object connects parts of the floor that were separate
    opens: Float[np.ndarray, "sets n"]
    #: expected reduction of the path cost between two of its neighbours that were connected [s]
    saved_s: Float[np.ndarray, "sets n"]


def expected_benefit(
    joint: JointGraph, unknown: tuple[str, ...], movable: float, *, by_set: bool = True
) -> ExpectedBenefit:
    """Expected benefits of exploring some objects of a joint graph.

    Parameters
    ----------
    joint
        Graph with a node for each of them, with the cost of its push as if it had been explored. The other nodes are known.
    unknown
        Ids of the unexplored objects, at least one.
    movable
        Prior probability that one of them can be pushed.
    by_set
        Whether the benefit is computed for every set explored before (``2**n`` rows), or for none (one row).
    """
    nodes = [joint.node(id) for id in unknown]
    ports = np.unique(np.concatenate([node.neighbours for node in nodes]))
    ends, cost_s = joint.edges()
    known = ~np.isin(ends, [node.number for node in nodes]).any(axis=1)
    total = joint.visual.nodes + len(joint.added)
    # The cost without each set of manipulation nodes; a node adds the paths through itself, once.
    between_s = costs_between(ends[known], cost_s[known], total, ports)[None]
    first, rest = (nodes[:AT_ONCE], nodes[AT_ONCE:]) if by_set else ([], [])
    blocks = []
    for chosen in range(1 << len(rest)):
        block_s = between_s
        for bit, node in enumerate(rest):
            if chosen >> bit & 1:
                block_s = _with_node(block_s, ports, node)
        for node in first:
            block_s = np.concatenate([block_s, _with_node(block_s, ports, node)])
        blocks.append(np.stack([_gain(block_s, ports, node) for node in nodes], axis=2))
    gains = np.concatenate(blocks, axis=1)
    for bit in range(len(nodes) if by_set else 0):
        pairs = gains.reshape(2, -1, 2, 1 << bit, len(nodes))  # without and with the object of this bit
        pairs[:, :, 1] = movable * pairs[:, :, 1] + (1.0 - movable) * pairs[:, :, 0]
    return ExpectedBenefit(movable * gains[0], movable * gains[1])


def _with_node(
    between_s: Float[np.ndarray, "sets k k"], ports: Int32[np.ndarray, "k"], node: JointNode
) -> Float[np.ndarray, "sets k k"]:
    """Costs between ports once a manipulation node may be passed: a cheapest path passes it at most once."""
    at = np.searchsorted(ports, node.neighbours)
    to_s = (between_s[:, :, at] + node.edge_s).min(axis=2, initial=np.inf)
    return np.minimum(between_s, to_s[:, :, None] + to_s[:, None, :])


def _gain(
    between_s: Float[np.ndarray, "sets k k"], ports: Int32[np.ndarray, "k"], node: JointNode
) -> Float[np.ndarray, "2 sets"]:
    """Whether a node connects separate neighbours (0 or 1), and the maximum reduction between the others [s]."""
    at = np.searchsorted(ports, node.neighbours)
    before_s = between_s[:, at[:, None], at]
    after_s = _with_node(before_s, node.neighbours, node)
    separate = np.isinf(before_s)
    opens = (separate & np.isfinite(after_s)).any(axis=(1, 2))
    saved_s = np.where(separate, 0.0, before_s) - np.where(separate, 0.0, after_s)
    return np.stack([opens, saved_s.max(axis=(1, 2), initial=0.0)])
