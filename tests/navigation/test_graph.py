"""Loops, components, stubs and attributes of the graph."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from visuohaptic.core import InputError
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.graph import build_graph
from visuohaptic.navigation.grid import SpeedLimits, grid_layers

from .random_maps import RADII_M, random_map, real_maps, topology


def check(layers, graph) -> None:
    """What holds for every graph."""
    assert (graph.components, graph.loops) == topology(layers.reachable)
    cells = graph.node_cells
    flat = cells[:, 0].astype(int) * layers.shape[1] + cells[:, 1]
    assert (np.diff(flat) > 0).all()
    np.testing.assert_allclose(graph.node_m, layers.map.world_from_cell(cells))
    assert (graph.edges[:, 0] <= graph.edges[:, 1]).all()
    assert (graph.component[graph.edges[:, 0]] == graph.component[graph.edges[:, 1]]).all()
    cost = layers.limits.cost_s_per_m(layers.distance_m)
    for edge, (a, b) in enumerate(graph.edges):
        path = graph.edge_path(edge)
        assert (path[0] == cells[a]).all()
        assert (path[-1] == cells[b]).all()
        steps = np.diff(path, axis=0)
        assert (np.abs(steps).max(axis=1) == 1).all()
        lengths = np.hypot(*steps.T) * layers.map.resolution_m
        along = cost[path[:, 0], path[:, 1]]
        assert np.isfinite(along).all()
        assert graph.edge_length_m[edge] == pytest.approx(lengths.sum())
        assert graph.edge_cost_s[edge] == pytest.approx((lengths * (along[1:] + along[:-1]) / 2).sum())
        assert graph.edge_clearance_m[edge] == layers.distance_m[path[:, 0], path[:, 1]].min()


def rectangle(rows: int, columns: int, *walls: tuple[slice, slice]) -> OccupancyMap:
    """A room of cells of 0.05 m inside a wall, with more walls."""
    cells = np.full((rows, columns), 100, np.int8)
    cells[1:-1, 1:-1] = 0
    for wall in walls:
        cells[wall] = 100
    return OccupancyMap(cells, 0.05)


def test_the_graph_of_random_maps_has_their_topology_and_true_attributes():
    rng = np.random.default_rng(4)
    for _ in range(200):
        layers = grid_layers(random_map(rng), SpeedLimits(float(rng.choice(RADII_M))))
        stub_length_m = [None, 0.0, 0.5, 1e9][rng.integers(4)]
        spacing_m = [None, None, 0.3, 1.0][rng.integers(4)]
        graph = build_graph(layers, stub_length_m=stub_length_m, spacing_m=spacing_m)
        check(layers, graph)
        if spacing_m is None:
            # A node of two ways is there only for a loop that has no other node.
            two = np.flatnonzero(graph.degree == 2)
            loops = graph.edges[graph.edges[:, 0] == graph.edges[:, 1], 0]
            assert np.isin(two, loops).all()


@settings(max_examples=60, deadline=None)
@given(
    st.integers(1, 14).flatmap(
        lambda columns: st.lists(
            st.lists(st.sampled_from([0, 0, 100]), min_size=columns, max_size=columns),
            min_size=1,
            max_size=14,
        )
    )
)
def test_any_small_map_keeps_its_topology(rows):
    layers = grid_layers(OccupancyMap(np.array(rows, np.int8), 0.1), SpeedLimits(0.1))
    check(layers, build_graph(layers))


@pytest.mark.data
def test_every_real_map_keeps_its_topology(data):
    maps = real_maps(data)
    assert len(maps) >= 15
    for grid in maps.values():
        layers = grid_layers(grid, SpeedLimits(0.2))
        graph = build_graph(layers)
        assert (graph.components, graph.loops) == topology(layers.reachable)


def test_a_room_is_one_node():
    graph = build_graph(grid_layers(rectangle(80, 80), SpeedLimits(0.17)))
    assert (graph.nodes, len(graph.edges)) == (1, 0)


def test_a_room_round_a_pillar_is_one_node_with_a_loop():
    grid = rectangle(81, 81, (slice(36, 45), slice(36, 45)))
    graph = build_graph(grid_layers(grid, SpeedLimits(0.17)))
    assert (graph.nodes, len(graph.edges), graph.loops) == (1, 1, 1)
    assert graph.edges.tolist() == [[0, 0]]


def test_a_crossing_of_corridors_is_one_node_with_four_ends():
    grid = rectangle(
        121,
        121,
        *[(r, c) for r in (slice(0, 50), slice(71, 121)) for c in (slice(0, 50), slice(71, 121))],
    )
    graph = build_graph(grid_layers(grid, SpeedLimits(0.17)))
    assert sorted(graph.degree.tolist()) == [1, 1, 1, 1, 4]
    middle = graph.node_m[graph.degree.argmax()]
    np.testing.assert_allclose(middle, [3.025, 3.025], atol=0.06)


def test_stubs_go_and_corridors_stay():
    # A corridor of 1 m with a niche of 0.5 m and a side corridor of 3 m.
    grid = rectangle(122, 202, (slice(21, 121), slice(0, 202)))
    grid.cells[21:31, 60:72] = 0
    grid.cells[21:81, 120:140] = 0
    layers = grid_layers(grid, SpeedLimits(0.17))
    graph = build_graph(layers)
    assert sorted(graph.degree.tolist()) == [1, 1, 1, 3]
    assert build_graph(layers, stub_length_m=0.0).nodes > graph.nodes
    one = build_graph(layers, stub_length_m=100.0)
    assert (one.nodes, len(one.edges)) == (1, 0)


def test_connection_nodes_are_kept_at_a_spacing():
    graph = build_graph(grid_layers(rectangle(22, 400), SpeedLimits(0.17)), spacing_m=1.0)
    assert graph.nodes == pytest.approx(19, abs=2)
    assert 0.75 < graph.edge_length_m.min() <= graph.edge_length_m.max() < 1.34


def test_a_map_where_the_robot_does_not_fit_has_an_empty_graph():
    graph = build_graph(grid_layers(rectangle(5, 9), SpeedLimits(0.5)))
    assert (graph.nodes, len(graph.edges), graph.components, graph.loops) == (0, 0, 0, 0)


def test_a_spacing_below_zero_is_refused():
    with pytest.raises(InputError, match="spacing_m"):
        build_graph(grid_layers(rectangle(9, 9), SpeedLimits(0.1)), spacing_m=-1.0)


def test_a_spacing_finer_than_the_cells_ends_with_a_node_on_each():
    layers = grid_layers(rectangle(9, 30), SpeedLimits(0.1))
    fine = build_graph(layers, spacing_m=1e-12)  # never came to an end
    once = build_graph(layers, spacing_m=layers.map.resolution_m / 2)
    assert (fine.node_cells == once.node_cells).all()
