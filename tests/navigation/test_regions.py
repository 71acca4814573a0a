"""Regions and potential against SciPy's Dijkstra."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.graph import assign_regions, build_graph
from visuohaptic.navigation.grid import SpeedLimits, grid_layers

from .random_maps import RADII_M, random_map


def grid_graph(cost: np.ndarray, resolution_m: float, *, mean: bool = False) -> csr_matrix:
    """Cells as nodes; a move costs the cell that is entered, or the mean of both, times its length."""
    rows, columns = cost.shape
    number = np.arange(rows * columns).reshape(rows, columns)
    flat = cost.ravel()
    parts = []
    for down in (-1, 0, 1):
        for across in (-1, 0, 1):
            if down == across == 0:
                continue
            a = number[
                max(0, -down) : rows - max(0, down), max(0, -across) : columns - max(0, across)
            ].ravel()
            b = number[
                max(0, down) : rows - max(0, -down), max(0, across) : columns - max(0, -across)
            ].ravel()
            passable = np.isfinite(flat[a]) & np.isfinite(flat[b])
            a, b = a[passable], b[passable]
            each = (flat[a] + flat[b]) / 2 if mean else flat[b]
            parts.append((a, b, each * np.hypot(down, across) * resolution_m))
    a, b, weight = (np.concatenate(column) for column in zip(*parts, strict=True))
    return csr_matrix((weight, (a, b)), shape=(rows * columns, rows * columns))


def test_potential_and_nodes_are_those_of_dijkstra():
    rng = np.random.default_rng(5)
    for _ in range(40):
        layers = grid_layers(random_map(rng), SpeedLimits(float(rng.choice(RADII_M))))
        graph = build_graph(layers)
        regions = assign_regions(layers, graph)
        if graph.nodes == 0:
            assert (regions.node == -1).all()
            continue
        cost = layers.limits.cost_s_per_m(layers.distance_m)
        seeds = graph.node_cells[:, 0].astype(int) * layers.shape[1] + graph.node_cells[:, 1]
        every = dijkstra(grid_graph(cost, 0.1), indices=seeds).reshape(graph.nodes, *layers.shape)
        truth_s = every.min(axis=0)
        found_s = regions.potential_s
        np.testing.assert_array_equal(np.isinf(found_s), np.isinf(truth_s))
        reached = np.isfinite(truth_s)
        # Each step is rounded to 1/4096 of the fastest one: half of that, relatively.
        np.testing.assert_allclose(found_s[reached], truth_s[reached], rtol=2e-4, atol=1e-6)
        node = regions.node
        rows, columns = np.nonzero(reached)
        chosen_s = every[node[rows, columns], rows, columns]
        np.testing.assert_allclose(chosen_s, truth_s[reached], rtol=4e-4, atol=1e-6)
        assert (node[~reached] == -1).all()


def test_ties_go_to_the_smaller_cell():
    strip = OccupancyMap(np.zeros((1, 7), np.int8), 0.1)
    layers = grid_layers(strip, SpeedLimits(0.1), unknown_is_free=True)
    graph = build_graph(layers, spacing_m=None)
    assert graph.nodes == 1
    from dataclasses import replace

    two = replace(
        graph,
        node_cells=np.array([[0, 0], [0, 6]], np.int32),
        node_m=np.zeros((2, 2)),
        component=np.zeros(2, np.int32),
    )
    assert assign_regions(layers, two).node.tolist() == [[0, 0, 0, 0, 1, 1, 1]]
