"""Graphs are written without loss; route graphs are as the route server reads them, and clear of obstacles."""

from __future__ import annotations

import json

import numpy as np
import pytest

from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.files import save_graph, save_route_graph
from visuohaptic.navigation.graph import build_graph
from visuohaptic.navigation.grid import SpeedLimits, grid_layers


def read(path):
    """Ids, frames and places [m] of the nodes, and the edges: properties, line [m], ends as indices of nodes."""
    features = json.loads(path.read_text())["features"]
    nodes = [one for one in features if one["geometry"]["type"] == "Point"]
    edges = [one for one in features if one["geometry"]["type"] == "MultiLineString"]
    assert len(nodes) + len(edges) == len(features)
    place = {one["properties"]["id"]: k for k, one in enumerate(nodes)}
    ends = [[place[one["properties"][name]] for name in ("startid", "endid")] for one in edges]
    return (
        nodes,
        np.array([one["geometry"]["coordinates"] for one in nodes]),
        [one["properties"] for one in edges],
        [np.concatenate(one["geometry"]["coordinates"]) for one in edges],
        np.array(ends),
    )


@pytest.fixture(scope="module")
def made():
    cells = np.zeros((50, 61), np.int8)
    cells[10::15, 8::14] = 100
    cells[:, 0] = 100
    grid = OccupancyMap(cells, 0.1, (-3.0, 2.0, 0.4))
    layers = grid_layers(grid, SpeedLimits(0.1))
    graph = build_graph(layers)
    assert graph.nodes > 3
    assert graph.loops > 0
    return grid, graph, layers


def test_a_graph_is_written_without_loss(made, tmp_path):
    grid, graph, _ = made
    save_graph(tmp_path / "g.geojson", graph, grid)
    written = json.loads((tmp_path / "g.geojson").read_text())["grid"]
    assert (written["rows"], written["columns"]) == grid.shape
    assert (tuple(written["origin"]), written["resolution_m"]) == (grid.origin, grid.resolution_m)
    nodes, node_m, edges, lines, ends = read(tmp_path / "g.geojson")
    cells = [[one["properties"]["metadata"][name] for name in ("row", "column")] for one in nodes]
    np.testing.assert_array_equal(cells, graph.node_cells)
    np.testing.assert_array_equal(node_m, graph.node_m)
    component = [one["properties"]["metadata"]["component"] for one in nodes]
    np.testing.assert_array_equal(component, graph.component)
    np.testing.assert_array_equal(ends, graph.edges)
    np.testing.assert_array_equal([edge["cost"] for edge in edges], graph.edge_cost_s)
    for name, values in (("length_m", graph.edge_length_m), ("clearance_m", graph.edge_clearance_m)):
        np.testing.assert_array_equal([edge["metadata"][name] for edge in edges], values)
    for number, line in enumerate(lines):
        np.testing.assert_array_equal(grid.cell_from_world(line), graph.edge_path(number))


def test_a_route_graph_is_what_the_route_server_reads(made, tmp_path):
    _, graph, layers = made
    save_route_graph(tmp_path / "r.geojson", graph, layers, frame="office")
    data = json.loads((tmp_path / "r.geojson").read_text())
    ids = [feature["properties"]["id"] for feature in data["features"]]
    assert len(set(ids)) == len(ids)  # nodes and edges share one range
    nodes, node_m, edges, _, ends = read(tmp_path / "r.geojson")
    assert {node["properties"]["frame"] for node in nodes} == {"office"}
    np.testing.assert_array_equal(node_m[: graph.nodes], graph.node_m)
    np.testing.assert_array_equal(ends[1::2], ends[::2, ::-1])
    assert min(edge["cost"] for edge in edges) > 0
    # Nodes that split an edge join two pieces of it; the others keep the edges of the graph.
    degree = np.bincount(ends[::2].ravel(), minlength=len(node_m))
    assert (degree[graph.nodes :] == 2).all()
    plain = graph.edges[graph.edges[:, 0] != graph.edges[:, 1]]
    np.testing.assert_array_equal(degree[: graph.nodes], np.bincount(plain.ravel(), minlength=graph.nodes))


def maze(rng: np.random.Generator, cells: int, wide: int) -> OccupancyMap:
    """A maze with a few loops: walls of one cell, corridors of ``wide``."""
    open_wall = np.zeros((2 * cells + 1, 2 * cells + 1), bool)
    seen = np.zeros((cells, cells), bool)
    stack = [(0, 0)]
    seen[0, 0] = True
    while stack:
        row, column = stack[-1]
        near = [
            (row + dr, column + dc)
            for dr, dc in ((1, 0), (-1, 0), (0, 1), (0, -1))
            if 0 <= row + dr < cells and 0 <= column + dc < cells and not seen[row + dr, column + dc]
        ]
        if not near:
            stack.pop()
            continue
        r, c = near[rng.integers(len(near))]
        open_wall[row + r + 1, column + c + 1] = seen[r, c] = True
        stack.append((r, c))
    open_wall[1::2, 1::2] = True
    inner = np.zeros_like(open_wall)
    inner[1:-1, 1:-1] = True
    inner[::2, ::2] = False
    open_wall |= inner & (rng.random(open_wall.shape) < 0.1)
    sizes = np.where(np.arange(2 * cells + 1) % 2, wide, 1)
    free = np.repeat(np.repeat(open_wall, sizes, axis=0), sizes, axis=1)
    return OccupancyMap(np.where(free, 0, 100).astype(np.int8), 0.05, (1.0, -2.0, 0.3))


def cave(rng: np.random.Generator, size: int) -> OccupancyMap:
    """Smoothed noise."""
    from scipy.ndimage import gaussian_filter

    smooth = gaussian_filter(rng.standard_normal((size, size)), 4.0)
    return OccupancyMap(np.where(smooth > 0.4 * smooth.std(), 100, 0).astype(np.int8), 0.05)


def chords_below(path, grid: OccupancyMap, radius_m: float) -> tuple[int, int]:
    """Edges of a file, and how many of them come nearer to occupied or unknown squares than the robot may.

    Exact geometry, by a library. Neighbouring cells whose centres keep the radius r are the finest pieces there
    are: halfway between them, h from either, a corner may be ``sqrt(r^2 - h^2)`` off.
    """
    import shapely

    _, node_m, _, _, ends = read(path)
    lines = node_m[ends]
    blocked = np.argwhere((grid.cells >= 50) | (grid.cells < 0))
    corners = np.stack([blocked + np.array(d) - 0.5 for d in ((0, 0), (0, 1), (1, 1), (1, 0))], axis=1)
    squares = shapely.STRtree(shapely.polygons(grid.world_from_cell(corners)))
    chords = shapely.linestrings(lines)
    half_m = 0.5 * np.hypot(*(lines[:, 1] - lines[:, 0]).T)
    neighbours = half_m < 0.75 * grid.resolution_m
    allowed_m = np.where(neighbours, np.sqrt(np.maximum(radius_m**2 - half_m**2, 0.0)), radius_m)
    # A micrometre for single precision of the distances and the six figures after the point of some files.
    hits = squares.query(chords, predicate="dwithin", distance=allowed_m - 1e-6)
    return len(lines), len(np.unique(hits[0]))


def test_no_edge_of_a_route_graph_comes_nearer_than_the_robot_may(tmp_path):
    rng = np.random.default_rng(7)
    grids = [maze(rng, 9, wide) for wide in (7, 9, 12)] + [cave(rng, 160) for _ in range(3)]
    for number, grid in enumerate(grids):
        for radius_m in (0.1, 0.17):
            layers = grid_layers(grid, SpeedLimits(radius_m))
            for spacing_m in (None, 0.5):
                path = tmp_path / f"{number}.geojson"
                save_route_graph(path, build_graph(layers, spacing_m=spacing_m), layers)
                edges, below = chords_below(path, grid, radius_m)
                assert edges > 20
                assert below == 0, (number, radius_m, spacing_m)


@pytest.mark.data
def test_no_edge_on_a_real_floor_comes_nearer_than_the_robot_may(data, tmp_path):
    folder = data / "navigation" / "dev" / "maps"
    for name in ("aws_small_house/map.yaml", "nav2/depot.yaml"):
        grid = OccupancyMap.load(folder / name)
        layers = grid_layers(grid, SpeedLimits(0.17))
        save_route_graph(tmp_path / "r.geojson", build_graph(layers), layers)
        edges, below = chords_below(tmp_path / "r.geojson", grid, 0.17)
        assert edges > 20
        assert below == 0
