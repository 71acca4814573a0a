"""Graphs survive the file; the route server's own graph can be read."""

from __future__ import annotations

import json

import numpy as np
import pytest

from visuohaptic.errors import InputError
from visuohaptic.navigation.geojson import load_graph, load_route_graph, save_graph, save_route_graph
from visuohaptic.navigation.graph import build_graph
from visuohaptic.navigation.grid import SpeedLimits, grid_layers
from visuohaptic.recording import OccupancyMap

from .test_incremental import GRAPH_FIELDS


@pytest.fixture(scope="module")
def made():
    cells = np.zeros((50, 61), np.int8)
    cells[10::15, 8::14] = 100
    cells[:, 0] = 100
    grid = OccupancyMap(cells, 0.1, (-3.0, 2.0, 0.4))
    graph = build_graph(grid_layers(grid, SpeedLimits(0.1)))
    assert graph.nodes > 3
    assert graph.loops > 0
    return grid, graph


def test_a_graph_comes_back_unchanged(made, tmp_path):
    grid, graph = made
    save_graph(tmp_path / "g.geojson", graph, grid)
    back, place = load_graph(tmp_path / "g.geojson")
    assert (place.shape, place.origin, place.resolution_m) == (grid.shape, grid.origin, grid.resolution_m)
    for name in GRAPH_FIELDS:
        np.testing.assert_array_equal(getattr(back, name), getattr(graph, name), name)


def test_a_route_graph_is_what_the_route_server_reads(made, tmp_path):
    graph = made[1]
    save_route_graph(tmp_path / "r.geojson", graph, frame="office")
    data = json.loads((tmp_path / "r.geojson").read_text())
    ids = [feature["properties"]["id"] for feature in data["features"]]
    assert len(set(ids)) == len(ids)  # nodes and edges share one range
    route = load_route_graph(tmp_path / "r.geojson")
    assert route.frame == "office"
    np.testing.assert_array_equal(route.node_m, graph.node_m)
    plain = graph.edges[graph.edges[:, 0] != graph.edges[:, 1]]
    np.testing.assert_array_equal(route.edges[::2], plain)
    np.testing.assert_array_equal(route.edges[1::2], plain[:, ::-1])
    assert (route.edge_cost > 0).all()


@pytest.mark.data
def test_the_route_graph_of_the_depot_can_be_read(data):
    route = load_route_graph(data / "navigation" / "dev" / "maps" / "nav2" / "depot_graph.geojson")
    features = json.loads(
        (data / "navigation" / "dev" / "maps" / "nav2" / "depot_graph.geojson").read_text()
    )["features"]
    kinds = [feature["geometry"]["type"] for feature in features]
    assert (len(route.node_ids), len(route.edges)) == (
        kinds.count("Point"),
        len(kinds) - kinds.count("Point"),
    )
    assert np.isnan(route.edge_cost).all()  # that file leaves costs to the server


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not valid JSON"),
        ("[]", "no list of features"),
        ('{"features": [3]}', "feature 1"),
        (
            '{"features": [{"geometry": {"type": "Point", "coordinates": [0]}, "properties": {"id": 0}}]}',
            "feature 1",
        ),
        (
            '{"features": [{"geometry": {"type": "Point", "coordinates": [0, NaN]}, "properties": {"id": 0}}]}',
            "not finite",
        ),
        (
            '{"features": [{"geometry": {"type": "Point", "coordinates": [0, 1]}, "properties": {"id": "a"}}]}',
            "whole number",
        ),
        (
            '{"features": [{"geometry": {"type": "LineString", "coordinates": [[0, 1], [1, 1]]},'
            ' "properties": {"id": 3, "startid": 1, "endid": 2}}]}',
            "no node 1",
        ),
    ],
)
def test_damaged_files_are_refused_with_the_place(tmp_path, text, message):
    (tmp_path / "bad.geojson").write_text(text)
    with pytest.raises(InputError, match=message):
        load_route_graph(tmp_path / "bad.geojson")


def test_a_route_graph_is_not_taken_for_one_with_cells(made, tmp_path):
    save_route_graph(tmp_path / "r.geojson", made[1])
    with pytest.raises(InputError, match="load_route_graph"):
        load_graph(tmp_path / "r.geojson")
    with pytest.raises(InputError, match="cannot be read"):
        load_graph(tmp_path / "absent.geojson")
