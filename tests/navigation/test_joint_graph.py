"""The seven steps, benefit, glass, doors and waiting, on scenes with a known result."""

from __future__ import annotations

import itertools
import json

import networkx
import numpy as np
import pytest
import shapely
from scipy.sparse.csgraph import dijkstra

from visuohaptic.core import Estimate, HapticTag, InputError, Primitive, PrimitiveKind
from visuohaptic.navigation.files import save_joint_route_graph
from visuohaptic.navigation.graph import assign_regions, build_graph
from visuohaptic.navigation.grid import SpeedLimits, grid_layers
from visuohaptic.navigation.planning import extend_graph
from visuohaptic.navigation.problem import (
    NodeType,
    Passage,
    PassageKind,
    is_door_wing,
    passage_node,
    push_node,
)

from .plan_scenes import ROBOT, box, office
from .test_regions import grid_graph


@pytest.fixture(scope="module")
def scene():
    problem = office()
    layers = grid_layers(problem.map, SpeedLimits(ROBOT.radius_m))
    graph = build_graph(layers)
    return problem, graph, assign_regions(layers, graph)


@pytest.fixture(scope="module")
def joint(scene):
    problem, graph, regions = scene
    return extend_graph(graph, regions, ROBOT, [push_node(item, ROBOT, 0.15) for item in problem.objects])


@pytest.mark.parametrize("corners", [[], [[0.0, 0.0], [1.0, 0.0]], [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]])
def test_a_node_without_an_area_is_refused(corners: list[list[float]]) -> None:
    with pytest.raises(InputError, match="NodeType 'vitrine': outline_m: found"):
        NodeType("vitrine", np.reshape(corners, (-1, 2)))


def test_the_visual_graph_is_extended_and_not_modified(scene):
    problem, graph, regions = scene
    before = [graph.edges.copy(), graph.edge_cost_s.copy(), regions.seed.copy(), regions.potential.copy()]
    extend_graph(graph, regions, ROBOT, [push_node(item, ROBOT) for item in problem.objects])
    after = [graph.edges, graph.edge_cost_s, regions.seed, regions.potential]
    assert all((a == b).all() for a, b in zip(before, after, strict=True))


def test_a_manipulation_node_carries_half_its_task_on_each_edge(joint):
    stool = joint.node("stool")
    assert stool.task_s == pytest.approx(7.0)
    assert np.allclose(stool.edge_s - stool.drive_s, 3.5)
    assert len(stool.neighbours) >= 2
    assert len(stool.region) > 0
    # The yellow region of figure 4.2 was nobody's before.
    assert (joint.regions.seed.ravel()[stool.region] < 0).all()


def test_edge_costs_are_those_of_the_map_without_the_object(scene, joint):
    """Step 6, the long way: the same node and neighbours on layers of the whole map without the stool."""
    problem, graph, _ = scene
    from visuohaptic.io.maps import OccupancyMap
    from visuohaptic.navigation.planning import clear_cells
    from visuohaptic.navigation.planning.search import grid_from_world

    occupied = problem.map.cells >= 50
    clear_cells(occupied, [grid_from_world(problem.map, problem.objects[0].footprint_m)])
    free = OccupancyMap((occupied * 100).astype(np.int8), problem.map.resolution_m)
    layers = grid_layers(free, SpeedLimits(ROBOT.radius_m))
    stool = joint.node("stool")
    cost = layers.limits.cost_s_per_m(layers.distance_m)
    number = stool.cell[0] * layers.shape[1] + stool.cell[1]
    moves = grid_graph(cost, free.resolution_m, mean=True)
    best_s = dijkstra(moves, indices=number).reshape(layers.shape)
    for neighbour, drive_s in zip(stool.neighbours, stool.drive_s, strict=True):
        row, column = graph.node_cells[neighbour]
        # The node's edge goes straight into the neighbour's region, along that region's potential;
        # the free map also offers ways through other regions and is faster where the stool was near.
        assert best_s[row, column] <= drive_s * 1.02
        assert drive_s <= 1.6 * best_s[row, column]


def test_fixed_objects_have_no_finite_edge_and_free_standing_ones_none_worth_keeping(joint):
    assert not np.isfinite(joint.node("tower").edge_s).any()
    assert joint.benefit_s("tower") == 0.0
    assert joint.benefit_s("bin") == 0.0


def test_benefit_is_a_reduction_and_infinite_where_parts_were_separate(joint):
    assert joint.benefit_s("table") == np.inf
    stool = joint.node("stool")
    # Of the paths without it: a shortest path over the edges as they are drawn, by another library.
    graph = networkx.MultiGraph()
    graph.add_weighted_edges_from(
        (a, b, cost)
        for (a, b), cost in zip(joint.visual.edges.tolist(), joint.visual.edge_cost_s, strict=True)
    )
    gains = []
    for i, k in itertools.combinations(range(len(stool.neighbours)), 2):
        try:
            before = networkx.dijkstra_path_length(graph, int(stool.neighbours[i]), int(stool.neighbours[k]))
        except networkx.NetworkXNoPath:
            before = np.inf
        gains.append(before - stool.edge_s[i] - stool.edge_s[k])
    assert joint.benefit_s("stool") >= max(gains) - 1e-9
    assert joint.benefit_s("stool") > 0
    with pytest.raises(InputError, match="has no node 'sofa', there are: stool, table"):
        joint.node("sofa")


def test_glass_closes_edges(scene):
    problem, graph, regions = scene
    cell = graph.edge_path(0)[len(graph.edge_path(0)) // 2]
    place = problem.map.world_from_cell(cell)
    glass = NodeType("vitrine", box(*place, 0.2))
    joint = extend_graph(graph, regions, ROBOT, [glass])
    node = joint.node("vitrine")
    assert 0 in node.blocked_edges
    assert len(node.neighbours) == 0
    assert not np.isfinite(joint.edges()[1][0])
    assert np.isfinite(graph.edge_cost_s[0])
    # The safety region is where the robot would touch it: cells of regions whose middle is nearer than its radius, by shapely.
    assert int(cell[0]) * problem.map.shape[1] + int(cell[1]) in node.region
    rows, columns = np.nonzero(regions.seed >= 0)
    middles_m = problem.map.world_from_cell(np.column_stack([rows, columns]))
    gap_m = shapely.distance(shapely.Polygon(glass.outline_m), shapely.points(middles_m))
    expected = (rows * problem.map.shape[1] + columns)[gap_m < ROBOT.radius_m]
    assert sorted(node.region.tolist()) == expected.tolist()


def test_a_wing_is_known_by_constant_rotation_and_a_plane():
    line = Primitive(PrimitiveKind.LINE, np.zeros(3), np.eye(3), 0.9)
    ball = Primitive(PrimitiveKind.CIRCLE, np.zeros(3), np.eye(3), 0.9)
    wing = HapticTag(rotation_rad_per_m=Estimate(1.6, 0.1), primitive=line)
    assert is_door_wing(wing)
    assert not is_door_wing(wing.updated(primitive=ball))
    assert not is_door_wing(wing.updated(primitive=None))
    assert not is_door_wing(wing.updated(rotation_rad_per_m=Estimate(1.6, 1.2)))
    assert not is_door_wing(wing.updated(rotation_rad_per_m=Estimate(0.05, 0.01)))
    assert not is_door_wing(wing.updated(fixed=True))


def test_doors_and_waiting_have_times_and_risks():
    outline = box(0, 0, 0.9, 0.05)

    def cost(kind, shape=outline, **options):
        return Passage("it", shape, kind, **options).cost(ROBOT)

    wing = cost(PassageKind.DOOR_PUSH)
    # Free width 0.9 (1 - cos a) = 2.2 x 0.17: a = 0.945 rad, the contact at 0.45 m moves 0.425 m.
    attempt_s = wing.total_s * (1.0 - wing.failure_probability)
    assert attempt_s == pytest.approx(4.0 + 0.45 * 0.945 / 0.05, rel=2e-3)
    assert cost(PassageKind.DOOR_PUSH, box(0, 0, 0.3, 0.05)).total_s == np.inf
    assert cost(PassageKind.DOOR_PUSH, tag=HapticTag(fixed=True)).total_s == np.inf
    slides = cost(PassageKind.DOOR_SLIDING, open_s=Estimate(4.0))
    assert slides.total_s * (1.0 - slides.failure_probability) == pytest.approx(4.0)
    lift = cost(PassageKind.ELEVATOR, open_s=Estimate(200.0, spread=200.0))
    draws = np.minimum(np.random.default_rng(0).exponential(200.0, 200_000), 300.0)
    assert lift.total_s == pytest.approx(draws.mean(), rel=0.01)
    assert lift.failure_probability == pytest.approx((draws == 300.0).mean(), abs=0.005)
    node = passage_node(Passage("it", outline, PassageKind.DOOR_PUSH), ROBOT)
    assert (node.task_s, node.planner) == (wing.total_s, "push door")


def test_the_route_graph_names_operations(joint, tmp_path):
    save_joint_route_graph(tmp_path / "joint.geojson", joint)
    data = json.loads((tmp_path / "joint.geojson").read_text())
    edges = [f["properties"] for f in data["features"] if f["geometry"]["type"] == "MultiLineString"]
    nodes = {f["properties"]["id"] for f in data["features"] if f["geometry"]["type"] == "Point"}
    assert len(nodes) >= joint.visual.nodes + len(joint.added)  # and those that split edges
    assert all({edge["startid"], edge["endid"]} <= nodes for edge in edges)
    pushes = [edge for edge in edges if edge["endid"] == joint.node("stool").number]
    assert pushes
    assert pushes[0]["operations"]["direct_push"]["metadata"]["object"] == "stool"
    assert len({feature["properties"]["id"] for feature in data["features"]}) == len(data["features"])
