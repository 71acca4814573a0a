"""Exported graphs satisfy the loader of the Nav2 route server, as its own sample graph does."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import networkx
import numpy as np
import pytest
import shapely
from benchmarks._plan_child import described, problem_of

from tests.worlds.floor_scenes import random_rooms
from visuohaptic.navigation.files import save_joint_route_graph, save_route_graph
from visuohaptic.navigation.graph import assign_regions, build_graph
from visuohaptic.navigation.grid import SpeedLimits, grid_layers
from visuohaptic.navigation.planning import extend_graph
from visuohaptic.navigation.problem import NodeType, Passage, passage_node, push_node

from .plan_scenes import ROBOT, box, office

TRIGGERS = {"NODE", "ON_ENTER", "ON_EXIT"}


def faults(path: Path) -> list[str]:
    """What the loader of the route server would stop at or misread, by its documented format."""
    features = json.loads(path.read_text())["features"]
    nodes = [f for f in features if f["geometry"]["type"] == "Point"]
    edges = [f for f in features if f["geometry"]["type"] in {"LineString", "MultiLineString"}]
    found = []
    if not nodes or not edges or len(nodes) + len(edges) != len(features):
        found.append("nodes and edges, and nothing else")
    ids = [f["properties"]["id"] for f in features]
    if len(set(ids)) < len(ids) or not all(type(i) is int and 0 <= i < 2**32 for i in ids):
        found.append("ids are whole numbers that nodes and edges share")
    known = {f["properties"]["id"] for f in nodes}
    for feature in nodes:
        x, y = feature["geometry"]["coordinates"]
        if not (np.isfinite([x, y]).all() and isinstance(feature["properties"].get("frame", ""), str)):
            found.append(f"node {feature['properties']['id']}")
    for feature in edges:
        own = feature["properties"]
        if not {own["startid"], own["endid"]} <= known:
            found.append(f"edge {own['id']}: no such node")
        cost = own.get("cost", 0.0)
        if not (isinstance(cost, int | float) and cost >= 0 and np.isfinite(cost)):
            found.append(f"edge {own['id']}: cost {cost}")
        if type(own.get("overridable", True)) is not bool:
            found.append(f"edge {own['id']}: overridable")
    for feature in features:
        own = feature["properties"]
        for name, operation in own.get("operations", {}).items():
            if type(operation["type"]) is not str or operation["trigger"] not in TRIGGERS:
                found.append(f"operation {name} of {own['id']}")
            found += _unread(operation.get("metadata", {}), f"{own['id']}.{name}")
        found += _unread(own.get("metadata", {}), str(own["id"]))
    return found


def _unread(metadata: dict[str, Any], where: str) -> list[str]:
    """The loader takes numbers, texts, truth values, lists of those and objects; null makes it throw."""
    found = []
    for key, value in metadata.items():
        if isinstance(value, dict):
            found += _unread(value, f"{where}.{key}")
        elif not all(
            isinstance(v, bool | int | float | str) for v in (value if isinstance(value, list) else [value])
        ):
            found.append(f"{where}.{key}")
    return found


@pytest.fixture(scope="module")
def joint():
    problem = office()
    layers = grid_layers(problem.map, SpeedLimits(ROBOT.radius_m))
    graph = build_graph(layers)
    outline = problem.objects[0].footprint_m
    wing = box(*problem.objects[0].centre_m, 0.45)
    glass = box(*graph.node_m[0], 0.3, 0.3)
    kinds = [
        *(push_node(item, ROBOT, 0.15) for item in problem.objects),
        passage_node(Passage("wing", wing, "door_push"), ROBOT),
        passage_node(Passage("slide", outline, "door_sliding"), ROBOT),
        NodeType("glass", glass),
    ]
    return extend_graph(graph, assign_regions(layers, graph), ROBOT, kinds)


def test_the_joint_graph_is_what_the_route_server_loads(joint, tmp_path):
    path = tmp_path / "joint.geojson"
    save_joint_route_graph(path, joint)
    assert faults(path) == []
    features = json.loads(path.read_text())["features"]
    operations = {
        (operation["type"], operation["trigger"])
        for feature in features
        for operation in feature["properties"].get("operations", {}).values()
    }
    planner = joint.added[0].kind.planner.title().replace(" ", "")
    assert operations >= {(kind, "ON_ENTER") for kind in (planner, "PushDoor", "TriggerAndWait")}
    # Only an edge into the place of a task carries its operation.
    tasks = {node.number for node in joint.added}
    assert all(
        feature["properties"]["endid"] in tasks
        for feature in features
        if "operations" in feature["properties"]
    )
    # Seconds stay floating point in the file: the server asks for them as such.
    for feature in features:
        for operation in feature["properties"].get("operations", {}).values():
            assert isinstance(operation["metadata"]["seconds"], float)
            assert 0.0 <= operation["metadata"]["failure_probability"] <= 1.0


def test_the_visual_graph_is_what_the_route_server_loads(joint, tmp_path):
    save_route_graph(tmp_path / "visual.geojson", joint.visual, joint.regions.layers)
    assert faults(tmp_path / "visual.geojson") == []


@pytest.mark.parametrize("seed", [4, 63])
def test_every_drive_to_an_object_keeps_clear_of_the_walls(tmp_path, seed):
    """In room 63 the straight line between an object's node and a neighbour crosses a wall."""
    world, path = random_rooms(seed), tmp_path / "joint.geojson"
    problem = problem_of(described(world, 0.05))
    layers = grid_layers(problem.map, SpeedLimits(problem.robot.radius_m))
    graph = build_graph(layers)
    kinds = [push_node(item, problem.robot) for item in problem.objects]
    joint = extend_graph(graph, assign_regions(layers, graph), problem.robot, kinds)
    save_joint_route_graph(path, joint)
    features = json.loads(path.read_text())["features"]
    at = {
        f["properties"]["id"]: f["geometry"]["coordinates"]
        for f in features
        if "startid" not in f["properties"]
    }
    edges = [f["properties"] for f in features if "startid" in f["properties"]]
    lines = [shapely.LineString([at[edge["startid"]], at[edge["endid"]]]) for edge in edges]
    walls = shapely.union_all(world.walls)
    assert min(walls.distance(line) for line in lines) > world.robot.radius_m - 1e-6
    # Every drive is whole; its pieces cut corners of the path, and pass walls more closely and slowly.
    drives = networkx.DiGraph()
    drives.add_weighted_edges_from((edge["startid"], edge["endid"], edge["cost"]) for edge in edges)
    for node in joint.added:
        for near, cost_s in zip(node.neighbours.tolist(), node.edge_s.tolist(), strict=True):
            if np.isfinite(cost_s):
                there_s, back_s = (
                    networkx.dijkstra_path_length(drives, *ends)
                    for ends in ((near, node.number), (node.number, near))
                )
                assert there_s == pytest.approx(back_s)
                away_m = float(np.hypot(*np.subtract(at[near], at[node.number])))
                assert away_m / problem.robot.v_max_m_s + 0.5 * node.task_s - 1e-9 < there_s < 1.5 * cost_s


@pytest.mark.data
def test_the_server_s_own_sample_passes_the_same_check(data):
    # But for one thing: six of its edges share an id, against its own documentation.
    sample = faults(data / "navigation" / "dev" / "maps" / "nav2" / "depot_graph.geojson")
    assert sample == ["ids are whole numbers that nodes and edges share"]


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda f: f[-1]["properties"].update(endid=10**6), "no such node"),
        (lambda f: f[-1]["properties"].update(id=0), "ids are"),
        (lambda f: f[-1]["properties"].update(metadata={"a": None}), ".a"),
        (
            lambda f: f[-1]["properties"].update(operations={"o": {"type": "X", "trigger": "LATER"}}),
            "operation o",
        ),
    ],
)
def test_the_check_sees_what_is_wrong(joint, tmp_path, change, fault):
    path = tmp_path / "bad.geojson"
    save_joint_route_graph(path, joint)
    data = json.loads(path.read_text())
    change(data["features"])
    path.write_text(json.dumps(data))
    assert any(fault in line for line in faults(path))
