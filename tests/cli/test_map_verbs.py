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
    from visuohaptic.navigation.files import load_graph, load_layer, load_route_graph

    out = tmp_path / "out"
    assert main(["map", "graph", str(office), "--radius", "0.17", "--out", str(out), "--plot", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {path.name for path in out.iterdir()} >= set(found["written"])
    graph, _ = load_graph(out / "graph.geojson")
    assert (graph.nodes, graph.loops) == (found["nodes"], 2)
    assert len(load_route_graph(out / "route_graph.geojson").node_ids) >= graph.nodes
    regions = load_layer(out / "regions.yaml")
    assert regions.values.max() == graph.nodes - 1
    assert (out / "navigation.png").stat().st_size > 10_000


def test_a_radius_of_nothing_is_one_line(office, tmp_path, capsys):
    assert main(["map", "graph", str(office), "--radius", "0", "--out", str(tmp_path)]) == 2
    assert "radius_m" in capsys.readouterr().err
