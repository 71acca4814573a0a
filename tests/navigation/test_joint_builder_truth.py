"""Each step of a node's extension on the whole map instead of a window: SciPy's components and paths, shapely's distances."""

from __future__ import annotations

import itertools
import math

import networkx
import numpy as np
import pytest
import shapely
from scipy.ndimage import binary_dilation, label
from scipy.sparse.csgraph import dijkstra

from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.graph import assign_regions, build_graph
from visuohaptic.navigation.grid import SpeedLimits, grid_layers
from visuohaptic.navigation.planning import clear_cells, extend_graph
from visuohaptic.navigation.planning.search import grid_from_world
from visuohaptic.navigation.problem import NodeType, RobotModel

from .test_regions import grid_graph

CELL_M, ROBOT = 0.1, RobotModel(0.2)
RADIUS = ROBOT.radius_m / CELL_M
EIGHT = np.ones((3, 3))


def outline(x_m, y_m, turn_rad, wide_m=0.8, deep_m=0.5):
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    corners = 0.5 * np.array([[-wide_m, -deep_m], [wide_m, -deep_m], [wide_m, deep_m], [-wide_m, deep_m]])
    return corners @ [[c, s], [-s, c]] + [x_m, y_m]


#: In a door, across a corridor's end, at the edge of the map, in the open, in a corner beside unknown cells.
PLACES = {
    "door": (3.05, 1.6, 1.4),
    "hall": (4.6, 2.5, 0.2),
    "edge": (0.1, 4.3, 0.5),
    "open": (1.6, 1.2, 0.7),
    "corner": (5.6, 4.6, -0.3),
}


@pytest.fixture(scope="module")
def floor():
    """6 m by 5 m: two rooms with a door, the right one divided by a wall with a passage; objects are drawn."""
    cells = np.zeros((50, 60), np.int8)
    cells[:3] = cells[-2:] = 100
    cells[:, -1] = 100
    cells[:, 30:32] = 100
    cells[12:20, 30:32] = 0
    cells[25, 32:42] = cells[25, 50:60] = 100
    cells[46:48, 40:50] = -1
    blank = cells.copy()
    grid = OccupancyMap(cells, CELL_M, (1.0, -2.0, 0.6))
    turn = np.array([[math.cos(0.6), math.sin(0.6)], [-math.sin(0.6), math.cos(0.6)]])
    kinds = [
        NodeType(id, outline(*place) @ turn + [1.0, -2.0], task_s=6.0, in_map=True)
        for id, place in PLACES.items()
    ]
    rows, columns = np.indices(cells.shape)
    for kind in kinds:
        shape = shapely.Polygon(grid_from_world(grid, kind.outline_m))
        cells[shapely.intersects(shape.buffer(-1e-6), shapely.box(columns, rows, columns + 1, rows + 1))] = (
            100
        )
    grid = OccupancyMap(cells, CELL_M, grid.origin)
    layers = grid_layers(grid, SpeedLimits(ROBOT.radius_m))
    graph = build_graph(layers)
    regions = assign_regions(layers, graph)
    return blank, grid, regions, extend_graph(graph, regions, ROBOT, kinds)


def without(grid, kind):
    """Distances on the map without one object [cells]."""
    occupied = (grid.cells >= 50) | (grid.cells < 0)
    clear_cells(occupied, [grid_from_world(grid, kind.outline_m)])
    rows, columns = np.nonzero(np.pad(occupied, 1, constant_values=True))
    squares = shapely.union_all(shapely.box(columns - 1, rows - 1, columns, rows))
    r, c = np.indices(occupied.shape)
    return shapely.distance(squares, shapely.points(c + 0.5, r + 0.5))


@pytest.mark.parametrize("id", PLACES)
def test_a_node_is_that_of_the_whole_map(floor, id):
    _, grid, regions, joint = floor
    node = joint.node(id)
    distance = without(grid, node.kind)
    free = distance >= RADIUS - 1e-6
    own = free & (regions.seed < 0)
    window = node.window
    # Up to three radii, from where on it does not matter, the clearance is the distance on the whole map.
    shown = np.minimum(node.clearance, 3.0 * RADIUS)
    np.testing.assert_allclose(shown, np.minimum(distance[window], 3.0 * RADIUS), atol=1e-5)
    rows, columns = np.nonzero(own)
    corners = grid_from_world(grid, node.kind.outline_m)
    # What the object keeps the robot from is within its radius.
    gap = shapely.distance(shapely.Polygon(corners), shapely.points(columns + 0.5, rows + 0.5))
    mine = gap < RADIUS + 1.0
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    away = np.hypot(columns[mine] + 0.5 - middle[0], rows[mine] + 0.5 - middle[1])
    row, column = node.cell
    assert np.hypot(column + 0.5 - middle[0], row + 0.5 - middle[1]) == pytest.approx(away.min())
    parts = label(own, EIGHT)[0]
    region = np.flatnonzero((parts == parts[row, column]).ravel())
    np.testing.assert_array_equal(np.sort(node.region), region)

    # Drives by moves from cell to cell: any-angle ones are up to 8 % shorter.
    speeds = SpeedLimits(ROBOT.radius_m)
    cost = np.where(free, speeds.cost_s_per_m(np.maximum(distance * CELL_M, ROBOT.radius_m)), np.inf)
    reach = binary_dilation(parts == parts[row, column], EIGHT)
    moves = grid_graph(np.where(reach, cost, np.inf), CELL_M, mean=True)
    there_s = dijkstra(moves, indices=row * grid.shape[1] + column).reshape(grid.shape)
    beside = reach & free & (regions.seed >= 0) & np.isfinite(there_s)
    through_s = there_s + regions.potential_s
    number = regions.node
    names = np.unique(number[beside])
    truth_s = {name: through_s[beside & (number == name)].min() for name in names.tolist()}
    for name, drive_s in zip(node.neighbours.tolist(), node.drive_s.tolist(), strict=True):
        assert 0.9 * truth_s[name] < drive_s < 1.01 * truth_s[name]

    # An edge is worthwhile if it shortens a path between two neighbours by a twentieth.
    graph = networkx.MultiGraph()
    graph.add_nodes_from(range(joint.visual.nodes))
    edges = zip(joint.visual.edges.tolist(), joint.visual.edge_cost_s.tolist(), strict=True)
    graph.add_weighted_edges_from((a, b, cost_s) for (a, b), cost_s in edges)
    sure, possible = set(), set()
    for a, b in itertools.combinations(names.tolist(), 2):
        try:
            around_s = networkx.dijkstra_path_length(graph, a, b)
        except networkx.NetworkXNoPath:
            around_s = math.inf
        most, least = 1.01 * (truth_s[a] + truth_s[b]), 0.9 * (truth_s[a] + truth_s[b])
        sure |= {a, b} if most < 0.95 * around_s else set()
        possible |= {a, b} if least < 0.95 * around_s else set()
    assert sure <= set(node.neighbours.tolist()) <= possible
    for way, name in zip(node.ways, node.neighbours.tolist(), strict=True):
        assert tuple(way[0]) == node.cell
        assert np.abs(np.diff(way, axis=0)).max(initial=0) <= 1
        assert number[tuple(way[-1])] == name
        assert free[tuple(way.T)].all()


def test_half_of_the_task_is_on_each_edge_and_a_door_is_worth_its_push(floor):
    *_, joint = floor
    door = joint.node("door")
    assert joint.benefit_s("door") > 0.0
    assert len(door.neighbours) >= 2
    np.testing.assert_allclose(door.edge_s - door.drive_s, 3.0)


@pytest.mark.parametrize("place", [(0.05, 2.5), (5.9, 0.6), (3.0, 4.98), (2.5, 1.0)])
def test_glass_closes_what_is_near_it_also_at_the_edge_of_the_map(floor, place):
    _, grid, regions, joint = floor
    corners = outline(*place, 0.4) / CELL_M
    shape = shapely.Polygon(corners)
    turn = np.array([[math.cos(0.6), math.sin(0.6)], [-math.sin(0.6), math.cos(0.6)]])
    glass = NodeType("glass", corners * CELL_M @ turn + [1.0, -2.0], task_s=math.inf)
    node = extend_graph(joint.visual, regions, ROBOT, [glass]).node("glass")
    rows, columns = np.nonzero(regions.seed >= 0)
    near = shapely.distance(shape, shapely.points(columns + 0.5, rows + 0.5)) < RADIUS - 1e-9
    np.testing.assert_array_equal(np.sort(node.region), (rows * grid.shape[1] + columns)[near])
    closed = [
        edge
        for edge in range(len(joint.visual.edges))
        if np.isin(joint.visual.edge_path(edge).astype(np.int64) @ [grid.shape[1], 1], node.region).any()
    ]
    assert node.blocked_edges.tolist() == closed
