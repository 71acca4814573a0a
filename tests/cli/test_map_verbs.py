"""``map inspect`` and ``map graph`` on a small map."""

from __future__ import annotations

import json

import numpy as np
import pytest

from visuohaptic.cli.main import main
from visuohaptic.io.maps import OccupancyMap


@pytest.fixture
def office(tmp_path):
    """Two rooms joined by two doors, one with a pillar: two loops."""
    cells = np.full((60, 120), 100, np.int8)
    cells[1:-1, 1:59] = 0
    cells[1:-1, 61:-1] = 0
    cells[10:24, 59:61] = 0
    cells[36:50, 59:61] = 0
    cells[28:32, 88:92] = 100
    path = tmp_path / "office.yaml"
    OccupancyMap(cells, 0.05).save(path)
    return path


def test_inspect_says_what_is_on_the_map(office, capsys):
    assert main(["map", "inspect", str(office), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["components"], found["loops"]) == (1, 2)
    assert found["size_m"] == [6.0, 3.0]
    assert found["share_unknown"] == 0
    assert len(found["narrowest_passages"]) <= 5
    # A door of 14 cells between its jambs, walked along a row of cells: half a cell beside the middle.
    assert found["narrowest_passages"][0]["width_m"] == pytest.approx(0.65, abs=1e-6)


def test_graph_writes_layers_and_graphs_that_can_be_read(office, tmp_path, capsys):
    from visuohaptic.navigation.files import load_layer

    out = tmp_path / "out"
    assert main(["map", "graph", str(office), "--radius", "0.17", "--out", str(out), "--plot", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {path.name for path in out.iterdir()} >= set(found["written"])
    nodes, edges = (
        [
            [one["geometry"]["type"] for one in json.loads((out / name).read_text())["features"]].count(kind)
            for name in ("graph.geojson", "route_graph.geojson")
        ]
        for kind in ("Point", "MultiLineString")
    )
    assert nodes[0] == found["nodes"]
    assert edges[0] - nodes[0] + found["components"] == 2  # loops
    assert nodes[1] >= nodes[0]
    regions = load_layer(out / "regions.yaml")
    assert regions.values.max() == nodes[0] - 1
    assert (out / "navigation.png").stat().st_size > 10_000


def test_inspect_lists_doors_and_what_stands_alone(tmp_path, capsys):
    cells = np.full((80, 120), 100, np.int8)
    cells[2:78, 2:58] = cells[2:78, 61:118] = 0
    cells[30:48, 58:61] = 0  # a door of 0.9 m in the wall between two rooms
    cells[38:42, 88:92] = 100  # a pillar
    OccupancyMap(cells, 0.05).save(tmp_path / "rooms.yaml")
    assert main(["map", "inspect", str(tmp_path / "rooms.yaml"), "--doors", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    (door,), (pillar,) = found["doors"], found["candidates"]
    assert door["at_m"] == pytest.approx([2.975, 1.95], abs=0.1)
    assert door["width_m"] == pytest.approx(0.9, abs=0.1)
    assert 0.5 < door["probability"] <= 1.0
    assert pillar["at_m"] == pytest.approx([4.5, 2.0], abs=0.03)
    assert pillar["size_m"] == pytest.approx([0.2, 0.2], abs=0.03)


def test_graph_takes_objects_and_a_route(office, tmp_path, capsys):
    objects = tmp_path / "objects.yaml"
    objects.write_text(
        "objects:\n"
        "- {id: box, footprint_m: [[4.4, 1.4], [4.6, 1.4], [4.6, 1.6], [4.4, 1.6]], haptic_tag: {explored: 1}}\n"
        "- {id: door, type: door_sliding, footprint_m: [[2.95, 0.5], [3.05, 0.5], [3.05, 1.2], [2.95, 1.2]]}\n"
    )
    out = tmp_path / "joint"
    words = ["map", "graph", str(office), "--radius", "0.17", "--out", str(out), "--objects", str(objects)]
    assert main([*words, "--route", "0.5", "0.8", "5.5", "0.8", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    nodes = [f["properties"] for f in json.loads((out / "joint_graph.geojson").read_text())["features"]]
    added = {node["metadata"]["object"]: node["metadata"]["planner"] for node in nodes if "metadata" in node}
    assert added == {"box": "direct push", "door": "trigger and wait"}
    masks = [
        OccupancyMap.load(out / f"{name}.yaml").value_at(np.array([4.5, 1.5]))
        for name in ("felt_obstacles", "keepout")
    ]
    assert 0 < masks[0] < 100
    assert masks[1] == 0, "a box that can be pushed is no place to keep out of"
    # Straight through the lower door, 5 m, but for its middle at 0.85 m.
    assert found["route"]["length_m"] == pytest.approx(5.0, abs=0.1)


def test_a_radius_of_nothing_is_one_line(office, tmp_path, capsys):
    assert main(["map", "graph", str(office), "--radius", "0", "--out", str(tmp_path)]) == 2
    assert "radius_m" in capsys.readouterr().err


@pytest.mark.parametrize("flat", [False, True], ids=["parts", "panes"])
def test_a_plan_keeps_clear_of_the_glass_of_a_reconstruction(office, tmp_path, capsys, flat):
    """A clear part of 5 cm, or a flat pane, in the lower door: the other way is planned, and none with both doors closed."""
    (tmp_path / "robot.yaml").write_text("radius_m: 0.17\n")
    words = [
        "plan",
        str(office),
        "--robot",
        str(tmp_path / "robot.yaml"),
        "--start",
        "0.5",
        "0.8",
        "--goal",
        "5.5",
        "0.8",
    ]
    ways = []
    for panes in ((), ((2.98, 0.4),), ((2.98, 0.4), (2.98, 1.7))):
        if flat:
            sides = ([[a, b, 0.0], [a, b + 0.9, 0.0], [a, b + 0.9, 0.5], [a, b, 0.5]] for a, b in panes)
            told = {"clusters": [], "panes": [{"corners": corners, "sigma": 0.002} for corners in sides]}
        else:
            hulls = [
                np.array([[x, y, z] for x in (a, a + 0.05) for y in (b, b + 0.9) for z in (0.0, 0.5)])
                for a, b in panes
            ]
            told = {"clusters": [{"hull": hull.tolist(), "score": 0.9} for hull in hulls]}
        (tmp_path / "regions.json").write_text(json.dumps(told))
        code = main([*words, *(["--glass", str(tmp_path / "regions.json")] if panes else []), "--json"])
        ways.append((code, json.loads(capsys.readouterr().out)["length_m"]))
    assert ways[0] == (0, pytest.approx(5.0, abs=0.1))
    # Through the upper door, at (3, 1.8) or higher: at least twice the hypotenuse.
    assert ways[1][0] == 0
    assert 2 * np.hypot(2.5, 1.0) <= ways[1][1] < 6.5
    assert ways[2][0] == 3
