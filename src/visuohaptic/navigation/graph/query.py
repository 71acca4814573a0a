"""Paths through the graph and over the cells: shortest, any-angle by string pulling, and exact (Alt 2016, Sec. 4.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Int32, UInt8

from ...core.errors import InputError
from ..grid.cost_grid import GridLayers
from .navigation_graph import NavigationGraph
from .regions import Regions, step_bounds

__all__ = ["GridPath", "Route", "costs_from", "plan_on_grid", "plan_path", "pull_string", "shortest_path"]

#: From so many nodes on, landmarks pay for a graph that is asked more than once.
_LANDMARKS_FROM = 1000
_LANDMARKS = 6


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """A path through the graph."""

    nodes: Int32[np.ndarray, "k"]  #: from the start to the goal; empty when there is none
    edges: Int32[np.ndarray, "k-1"]  #: between them
    cost_s: float  #: sum of the edges' costs, infinite when there is none

    @property
    def found(self) -> bool:
        """Whether there is a path."""
        return len(self.nodes) > 0


@dataclass(frozen=True, slots=True, eq=False)
class GridPath:
    """A path over the cells, and the any-angle path of straight segments."""

    cells: Int32[np.ndarray, "k 2"]  #: (row, column), each a neighbour of the one before; empty: no path
    points_m: Float[np.ndarray, "q 2"]  #: corners of the any-angle path (x, y) in the map frame [m]
    cost_s: float  #: of the cells: mean cost of both ends of each step times its length; infinite: no path
    line_cost_s: float  #: of the any-angle path
    line_length_m: float  #: of the any-angle path
    looked_at: int  #: cells that the search settled

    @property
    def found(self) -> bool:
        """Whether there is a path."""
        return len(self.cells) > 0


def shortest_path(
    graph: NavigationGraph, start_node: int, goal_node: int, costs: Float[np.ndarray, "m"] | None = None
) -> Route:
    """The cheapest path between two nodes.

    Parameters
    ----------
    graph
        From :func:`visuohaptic.navigation.graph.navigation_graph.build_graph`.
    start_node, goal_node
        Numbers of nodes.
    costs
        Cost of each edge instead of its ``edge_cost_s``, at least 0; infinite closes it.
    """
    from ._search_kernels import graph_search

    for name, node in (("start_node", start_node), ("goal_node", goal_node)):
        if not 0 <= node < graph.nodes:
            raise InputError("shortest_path", f"found {node}, expected 0 to {graph.nodes - 1}", field=name)
    start, half, pace, marks = _searching(graph)
    if costs is None:
        costs = graph.edge_cost_s
    else:
        costs = _checked(graph, costs)
        pace, marks = 0.0, marks[:0]  # bounds of the edges' own costs do not hold for others
    halves, cost_s = graph_search(
        start, half, graph.edges, costs, graph.node_m, pace, marks, start_node, goal_node
    )
    if not np.isfinite(cost_s):
        return Route(np.empty(0, np.int32), np.empty(0, np.int32), float("inf"))
    last = graph.edges[halves >> 1, 1 - (halves & 1)]
    return Route(np.concatenate([[start_node], last]).astype(np.int32), halves >> 1, float(cost_s))


def costs_from(
    graph: NavigationGraph, node: int, costs: Float[np.ndarray, "m"] | None = None
) -> Float[np.ndarray, "n"]:
    """Cost of the cheapest path from a node to every other [s], infinite where there is none.

    Parameters
    ----------
    graph
        Navigation graph.
    node
        Index of the node.
    costs
        Of the edges [s], in place of the graph's own.
    """
    from ._search_kernels import all_costs

    if not 0 <= node < graph.nodes:
        raise InputError("costs_from", f"found {node}, expected 0 to {graph.nodes - 1}", field="node")
    start, half, _, _ = _searching(graph, landmarks=False)
    used = graph.edge_cost_s if costs is None else _checked(graph, costs)
    return np.asarray(all_costs(start, half, graph.edges, used, node))


def _checked(graph: NavigationGraph, costs: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m"]:
    costs = np.ascontiguousarray(costs, dtype=np.float64)
    if costs.shape != (len(graph.edges),) or np.isnan(costs).any() or (costs < 0).any():
        raise InputError(
            "shortest_path",
            f"found shape {costs.shape}, expected one cost of at least 0 for each of {len(graph.edges)} edges",
            field="costs",
        )
    return costs


def _searching(
    graph: NavigationGraph, *, landmarks: bool = True
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """CSR half-edges, least cost per metre as the crow flies, and costs to landmarks; made once per graph."""
    from ._search_kernels import all_costs, half_edges

    known = graph._searching
    if not known:
        start, half = half_edges(graph.nodes, graph.edges)
        way_m = np.hypot(*(graph.node_m[graph.edges[:, 1]] - graph.node_m[graph.edges[:, 0]]).T)
        apart = way_m > 0
        pace = float((graph.edge_cost_s[apart] / way_m[apart]).min()) if apart.any() else 0.0
        # A little less, so that rounding never makes a bound too high.
        known.append((start, half, pace * (1 - 1e-9)))
    start, half, pace = known[0]
    if landmarks and len(known) == 1:
        marks = np.empty((0, graph.nodes))
        if graph.nodes >= _LANDMARKS_FROM:
            # Each far from those before, in the largest component.
            largest = np.bincount(graph.component).argmax()
            inside = np.flatnonzero(graph.component == largest)
            near = all_costs(start, half, graph.edges, graph.edge_cost_s, int(inside[0]))
            rows = []
            for _ in range(_LANDMARKS):
                mark = int(inside[np.argmax(near[inside])])
                rows.append(all_costs(start, half, graph.edges, graph.edge_cost_s, mark))
                near = rows[0] if len(rows) == 1 else np.minimum(near, rows[-1])
            marks = np.array(rows) * (1 - 1e-9)
        known.append(marks)
    return start, half, pace, known[1] if landmarks else np.empty((0, graph.nodes))


def plan_on_grid(
    layers: GridLayers, start_m: Float[np.ndarray, "2"], goal_m: Float[np.ndarray, "2"]
) -> GridPath:
    """The cheapest path over the cells, exactly: A* on the 8-neighbour grid.

    Costs are those of Eq. (4.1) rounded to whole units (1/4096 of the fastest step).

    Parameters
    ----------
    layers
        Costmap: clearance and cost of each cell.
    start_m, goal_m
        x, y [m], map frame.

    Raises
    ------
    InputError
        Start or goal is where the robot does not fit.
    """
    start, goal = _cell(layers, start_m, "start_m"), _cell(layers, goal_m, "goal_m")
    return _on_cells(layers, start, goal, np.empty((0, 0), np.int32), np.empty(0, np.uint8))


def pull_string(
    regions: Regions,
    edges: Int[np.ndarray, "k"],
    start_cell: Int[np.ndarray, "2"],
    goal_cell: Int[np.ndarray, "2"],
) -> GridPath:
    """The cheapest any-angle path inside the regions that some edges lead through: string pulling of a route.

    Parameters
    ----------
    regions
        From :func:`visuohaptic.navigation.graph.regions.assign_regions`.
    edges
        Of a route, for example ``route.edges``. The regions of the start and of the goal may always be entered.
    start_cell, goal_cell
        (row, column).
    """
    layers = regions.layers
    columns = layers.shape[1]
    ends = []
    for name, cell in (("start_cell", start_cell), ("goal_cell", goal_cell)):
        row, column = (int(value) for value in np.asarray(cell))
        if not layers.map.inside(np.array([row, column])) or regions.seed[row, column] < 0:
            raise InputError(
                "pull_string", f"cell ({row}, {column}) cannot be reached by the robot", field=name
            )
        ends.append(row * columns + column)
    allowed = np.zeros(regions.seed.size, np.uint8)
    graph = regions.graph
    used = np.zeros(len(graph.edges), np.bool_)
    used[np.asarray(edges, dtype=np.int64)] = True
    # Not only the nodes' own regions: an edge may pass through a third one.
    cells = graph.path_cells[np.repeat(used, np.diff(graph.path_start))]
    allowed[regions.seed[cells[:, 0], cells[:, 1]]] = 1
    allowed[regions.seed.ravel()[ends]] = 1
    return _on_cells(layers, ends[0], ends[1], regions.seed, allowed)


def plan_path(
    regions: Regions,
    start_m: Float[np.ndarray, "2"],
    goal_m: Float[np.ndarray, "2"],
    *,
    slack: float = 0.25,
) -> GridPath:
    """Any-angle path from point to point: a route through the graph, shortened over the cells by string pulling.

    The path may use the regions of all nodes through which a route costs at most ``1 + slack`` times the
    cheapest, because edges lead through the middle and are in general overestimated.

    Parameters
    ----------
    regions
        From :func:`visuohaptic.navigation.graph.regions.assign_regions`.
    start_m, goal_m
        x, y [m], map frame.
    slack
        Fraction by which a route may cost more than the cheapest.

    Raises
    ------
    InputError
        Start or goal is where the robot does not fit.
    """
    layers, graph = regions.layers, regions.graph
    columns = layers.shape[1]
    ends = [_cell(layers, start_m, "start_m"), _cell(layers, goal_m, "goal_m")]
    cells = np.column_stack(np.divmod(ends, columns))
    first, last = (int(node) for node in regions.node_at(cells))
    if first < 0 or last < 0 or graph.component[first] != graph.component[last]:
        return _no_path()
    there, back = costs_from(graph, first), costs_from(graph, last)
    within = there + back <= there[last] * (1.0 + slack) + 1e-9
    edges = np.flatnonzero(within[graph.edges].all(axis=1))
    return pull_string(regions, edges, cells[0], cells[1])


def _cell(layers: GridLayers, point_m: Float[np.ndarray, "2"], name: str) -> int:
    point = np.asarray(point_m, dtype=np.float64)
    cell = layers.map.cell_from_world(point)
    if not layers.map.inside(cell):
        raise InputError("plan", f"found {point.tolist()} m, which is outside the map", field=name)
    if layers.step[cell[0], cell[1]] == 0:
        raise InputError(
            "plan",
            f"found {point.tolist()} m, {layers.distance_m[cell[0], cell[1]]:.3f} m from an obstacle, "
            f"expected at least the radius of {layers.radius_m} m",
            field=name,
        )
    return int(cell[0]) * layers.shape[1] + int(cell[1])


def _no_path() -> GridPath:
    return GridPath(np.empty((0, 2), np.int32), np.empty((0, 2)), float("inf"), float("inf"), float("inf"), 0)


def _on_cells(
    layers: GridLayers,
    start: int,
    goal: int,
    seed: Int32[np.ndarray, "rows columns"],
    allowed: UInt8[np.ndarray, "cells"],
) -> GridPath:
    from ._grid_search_kernels import grid_search, straighten

    slowest, fastest = step_bounds(layers)
    path, cost, looked = grid_search(layers.step, start, goal, fastest, slowest, seed, allowed)
    if cost < 0:
        return _no_path()
    kept, line_cost = straighten(layers.step, path)
    cells = np.column_stack(np.divmod(path, layers.shape[1])).astype(np.int32)
    points_m = layers.map.world_from_cell(cells[kept])
    length_m = float(np.hypot(*np.diff(points_m, axis=0).T).sum())
    unit_s = 0.5 * layers.unit_s
    return GridPath(cells, points_m, float(cost) * unit_s, float(line_cost) * unit_s, length_m, int(looked))
