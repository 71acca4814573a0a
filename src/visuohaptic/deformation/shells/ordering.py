"""Elimination order of a mesh: geometric nested dissection, and its tree of fronts.

The nodes of the shortest separator across a coordinate are eliminated last, both halves before it
recursively. On a surface, the size of the factor is then close to N log N; the default ordering of
scipy's solver causes four times as much fill-in.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from . import _front_kernels as kernels


@dataclass(frozen=True, slots=True, eq=False)
class FrontTree:
    """Groups of nodes that are eliminated together, and the nodes that each elimination affects.

    Fronts are in elimination order, children before parents. "Position" is a node's index in
    that order; "local" an index among a front's pivots followed by its border.
    """

    order: Int[np.ndarray, "v"]  #: node at each position
    place: Int[np.ndarray, "v"]  #: position of each node
    first: Int[np.ndarray, "fronts+1"]  #: first pivot position of each front
    parent: Int[np.ndarray, "fronts"]  #: -1 for a root
    offset: Int[np.ndarray, "fronts+1"]  #: start of a front's border in ``border``
    border: Int[np.ndarray, "b"]  #: positions, ascending in each front
    border_local: Int[np.ndarray, "b"]  #: the same, as local indices in the parent
    elements: tuple[Int[np.ndarray, "_"], ...]  #: elements that each front assembles
    element_local: tuple[Int[np.ndarray, "_ corners"], ...]  #: local indices of their nodes
    children: tuple[tuple[int, ...], ...]

    @property
    def fronts(self) -> int:
        """Number of fronts."""
        return self.parent.size


def front_tree(
    points_m: Float[np.ndarray, "v 3"], elements: Int[np.ndarray, "e corners"], leaf: int = 20
) -> FrontTree:
    """Order the nodes of a mesh by geometric nested dissection.

    Parameters
    ----------
    points_m
        Nodes.
    elements
        Nodes of each element; the nodes of one element are coupled.
    leaf
        Parts with at most this many nodes are not divided.
    """
    elements = np.ascontiguousarray(elements, dtype=np.int64)
    count = len(points_m)
    starts, neighbours = _graph(elements, count)
    order, first = _dissect(np.ascontiguousarray(points_m, dtype=float), starts, neighbours, leaf)
    place, owner, parent, offset, border = kernels.borders(order, first, starts, neighbours)
    fronts = parent.size
    border = border[np.lexsort((border, np.repeat(np.arange(fronts), np.diff(offset))))]
    lead = owner[place[elements].min(axis=1)]
    by_front = np.argsort(lead, kind="stable")
    local = kernels.local_places(place[elements[by_front]], lead[by_front], first, offset, border, count)
    cuts = np.searchsorted(lead[by_front], np.arange(fronts + 1))
    holder = np.repeat(parent, np.diff(offset))
    by_parent = np.argsort(holder, kind="stable")
    border_local = np.empty_like(border)
    border_local[by_parent] = kernels.local_places(
        border[by_parent, None], holder[by_parent], first, offset, border, count
    )[:, 0]
    children: list[list[int]] = [[] for _ in range(fronts)]
    for front, above in enumerate(parent):
        if above >= 0:
            children[above].append(front)
    return FrontTree(
        order,
        place,
        first,
        parent,
        offset,
        border,
        border_local,
        tuple(by_front[a:b] for a, b in pairwise(cuts)),
        tuple(local[a:b] for a, b in pairwise(cuts)),
        tuple(map(tuple, children)),
    )


def _graph(
    elements: Int[np.ndarray, "e corners"], count: int
) -> tuple[Int[np.ndarray, "v+1"], Int[np.ndarray, "_"]]:
    """Adjacency of nodes that share an element, in compressed rows."""
    corners = elements.shape[1]
    pairs = [(a, b) for a in range(corners) for b in range(corners) if a != b]
    rows = np.concatenate([elements[:, a] for a, _ in pairs])
    columns = np.concatenate([elements[:, b] for _, b in pairs])
    keys = np.unique(rows * count + columns)
    return np.searchsorted(keys, np.arange(count + 1) * count), keys % count


def _dissect(
    points: Float[np.ndarray, "v 3"],
    starts: Int[np.ndarray, "v+1"],
    neighbours: Int[np.ndarray, "_"],
    leaf: int,
) -> tuple[Int[np.ndarray, "v"], Int[np.ndarray, "fronts+1"]]:
    count = len(points)
    label = np.zeros(count, dtype=np.int64)
    side = np.zeros(count, dtype=np.int8)
    blocks: list[np.ndarray] = []
    mark = 0
    # A part, or a separator that waits until both of its sides are processed.
    todo: list[tuple[np.ndarray, bool]] = [(np.arange(count), False)]
    while todo:
        nodes, done = todo.pop()
        if done or nodes.size <= leaf:
            if nodes.size:
                blocks.append(nodes)
            continue
        mark += 1
        label[nodes] = mark
        ordered = np.sort(points[nodes], axis=0)
        middle, extent = ordered[nodes.size // 2], ordered[-1] - ordered[0]
        if not kernels.split(nodes, label, mark, points, middle, extent, starts, neighbours, side):
            blocks.append(nodes)
            continue
        where = side[nodes]
        todo.append((nodes[where == 2], True))
        todo.append((nodes[where == 1], False))
        todo.append((nodes[where == 0], False))
    return np.concatenate(blocks), np.cumsum([0] + [block.size for block in blocks])
