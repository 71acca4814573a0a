"""Shortest ways against NetworkX and SciPy, and what pulling taut keeps."""

from __future__ import annotations

import networkx
import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

from visuohaptic.core import InputError
from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.graph import (
    assign_regions,
    build_graph,
    costs_from,
    plan_on_grid,
    plan_path,
    pull_string,
    shortest_path,
)
from visuohaptic.navigation.grid import SpeedLimits, grid_layers

from .random_maps import random_map, real_maps
from .test_regions import grid_graph


def networkx_graph(graph, costs) -> networkx.MultiGraph:
    made = networkx.MultiGraph()
    made.add_nodes_from(range(graph.nodes))
    for (a, b), cost in zip(graph.edges.tolist(), costs.tolist(), strict=True):
        if np.isfinite(cost):
            made.add_edge(a, b, weight=cost)
    return made


def test_routes_are_those_of_networkx_with_any_costs():
    rng = np.random.default_rng(6)
    for _ in range(20):
        layers = grid_layers(random_map(rng, 80), SpeedLimits(0.1))
        graph = build_graph(layers)
        if graph.nodes < 2:
            continue
        other = rng.exponential(1.0, len(graph.edges))
        other[rng.random(len(other)) < 0.1] = np.inf
        for costs in (None, other):
            used = graph.edge_cost_s if costs is None else costs
            start = int(rng.integers(graph.nodes))
            truth = networkx.single_source_dijkstra_path_length(networkx_graph(graph, used), start)
            every = costs_from(graph, start, costs)
            for goal in rng.integers(0, graph.nodes, 8).tolist():
                route = shortest_path(graph, start, goal, costs)
                assert route.cost_s == pytest.approx(truth.get(goal, np.inf))
                assert every[goal] == pytest.approx(truth.get(goal, np.inf))
                assert route.found == (goal in truth)
                if route.found:
                    assert (route.nodes[0], route.nodes[-1]) == (start, goal)
                    assert used[route.edges].sum() == pytest.approx(route.cost_s)
                    pairs = np.sort(np.column_stack([route.nodes[:-1], route.nodes[1:]]), axis=1)
                    np.testing.assert_array_equal(pairs, graph.edges[route.edges])


def test_landmarks_do_not_change_the_answer():
    # A lattice of pillars has more nodes than landmarks need.
    cells = np.zeros((320, 320), np.int8)
    cells[::8, ::8] = 100
    rng = np.random.default_rng(7)
    cells[rng.random(cells.shape) < 0.01] = 100
    graph = build_graph(grid_layers(OccupancyMap(cells, 0.1), SpeedLimits(0.1)))
    assert graph.nodes > 1000
    for _ in range(20):
        a, b = (int(n) for n in rng.integers(0, graph.nodes, 2))
        plain = shortest_path(graph, a, b, graph.edge_cost_s)
        assert shortest_path(graph, a, b).cost_s == pytest.approx(plain.cost_s)


def test_the_way_over_the_cells_is_the_cheapest():
    rng = np.random.default_rng(9)
    for _ in range(25):
        grid = random_map(rng)
        layers = grid_layers(grid, SpeedLimits(0.1))
        places = np.argwhere(layers.reachable)
        if len(places) < 2:
            continue
        start, goal = places[rng.integers(len(places), size=2)]
        found = plan_on_grid(layers, grid.world_from_cell(start), grid.world_from_cell(goal))
        cost = layers.limits.cost_s_per_m(layers.distance_m)
        number = int(start[0]) * grid.shape[1] + int(start[1])
        truth_s = dijkstra(grid_graph(cost, 0.1, mean=True), indices=number).reshape(grid.shape)[tuple(goal)]
        if np.isinf(truth_s):
            assert not found.found
            continue
        assert found.cost_s == pytest.approx(truth_s, rel=2e-4, abs=1e-9)
        assert (found.cells[0] == start).all()
        assert (found.cells[-1] == goal).all()
        assert layers.reachable[found.cells[:, 0], found.cells[:, 1]].all()
        # The taut line is never dearer, and a sampled integral of its cost says the same.
        assert found.line_cost_s <= found.cost_s * (1 + 1e-4) + 1e-9
        integral_s = 0.0
        for a, b in zip(found.points_m[:-1], found.points_m[1:], strict=True):
            fraction = (np.arange(4000) + 0.5) / 4000
            cells = grid.cell_from_world(a + fraction[:, None] * (b - a))
            integral_s += cost[cells[:, 0], cells[:, 1]].mean() * np.hypot(*(b - a))
        assert found.line_cost_s == pytest.approx(integral_s, rel=2e-3)


def test_a_plan_stays_in_its_component_and_says_when_there_is_none():
    cells = np.zeros((20, 41), np.int8)
    cells[:, 20] = 100
    grid = OccupancyMap(cells, 0.1)
    layers = grid_layers(grid, SpeedLimits(0.1))
    regions = assign_regions(layers, build_graph(layers))
    plan = plan_path(regions, np.array([0.5, 1.0]), np.array([3.5, 1.0]))
    assert not plan.found
    assert plan.cost_s == np.inf
    with pytest.raises(InputError, match=r"goal_m.*expected at least the radius"):
        plan_path(regions, np.array([0.5, 1.0]), np.array([2.05, 1.0]))
    with pytest.raises(InputError, match="outside the map"):
        plan_on_grid(layers, np.array([0.5, np.nan]), np.array([2.05, 1.0]))
    with pytest.raises(InputError, match="goal_node"):
        shortest_path(regions.graph, 0, 99)
    with pytest.raises(InputError, match="costs"):
        shortest_path(regions.graph, 0, 0, np.full(99, 1.0))


@pytest.mark.data
def test_taut_paths_on_a_real_map_are_optimal(data):
    grid = real_maps(data)["willow-full-0.05"]
    layers = grid_layers(grid, SpeedLimits(0.2))
    graph = build_graph(layers)
    regions = assign_regions(layers, graph)
    rng = np.random.default_rng(10)
    large = np.flatnonzero(graph.component == np.bincount(graph.component).argmax())
    ratios, route_ratios = [], []
    for _ in range(12):
        a, b = rng.choice(large, 2, replace=False)
        best = plan_on_grid(layers, graph.node_m[a], graph.node_m[b])
        route = shortest_path(graph, int(a), int(b))
        taut = pull_string(regions, route.edges, graph.node_cells[a], graph.node_cells[b])
        route_ratios.append(taut.cost_s / best.cost_s)
        ratios.append(plan_path(regions, graph.node_m[a], graph.node_m[b]).cost_s / best.cost_s)
    assert min(ratios) >= 1.0 - 1e-9
    # The aim of the project: 1.01 in the median, 1.05 at worst.
    assert np.median(route_ratios) <= 1.01
    assert max(ratios) <= 1.05
