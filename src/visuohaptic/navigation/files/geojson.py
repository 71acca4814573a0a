"""Graphs as GeoJSON: our own with the cells of its edges, and the route graphs of the Nav2 route server.

Both hold one ``Point`` per node and one ``MultiLineString`` per edge, in metres of the map frame. Ids are
whole numbers that nodes and edges share, as the route server wants it. In a route graph an edge
leads one way only, so each of ours appears twice; edges from a node to itself are no use there.
The route server drives the straight line between the nodes: ours are split until that line is free.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core.files import write_text
from ...io.maps.occupancy_map import OccupancyMap
from ..graph.navigation_graph import NavigationGraph
from ..grid.cost_grid import GridLayers
from .route_edges import route_pieces

__all__ = ["save_graph", "save_route_graph"]


def save_graph(path: Path | str, graph: NavigationGraph, map: OccupancyMap, *, frame: str = "map") -> None:
    """Write a graph with the cells of its edges.

    Parameters
    ----------
    path
        ``.geojson`` file.
    graph, map
        The graph and the map that it belongs to.
    frame
        Name of the map frame.
    """
    features = []
    for node in range(graph.nodes):
        properties = {
            "id": node,
            "frame": frame,
            "metadata": {
                "row": int(graph.node_cells[node, 0]),
                "column": int(graph.node_cells[node, 1]),
                "component": int(graph.component[node]),
            },
        }
        features.append(_feature("Point", _point(graph.node_m[node]), properties))
    for edge in range(len(graph.edges)):
        line = [_point(point) for point in map.world_from_cell(graph.edge_path(edge))]
        start, end = graph.edges[edge].tolist()
        measures = (graph.edge_cost_s[edge], graph.edge_length_m[edge], graph.edge_clearance_m[edge])
        properties = _properties(graph.nodes + edge, start, end, *(float(value) for value in measures))
        features.append(_feature("MultiLineString", [line], properties))
    x, y, yaw = map.origin
    grid = {
        "rows": map.shape[0],
        "columns": map.shape[1],
        "resolution_m": map.resolution_m,
        "origin": [x, y, yaw],
    }
    _write(path, features, {"grid": grid})


def save_route_graph(
    path: Path | str, graph: NavigationGraph, layers: GridLayers, *, frame: str = "map"
) -> None:
    """Write a graph for the Nav2 route server.

    Each edge appears in both directions, split at cells of its path until every straight piece keeps the robot's
    radius from the occupied cells, with cost, length and clearance of the straight piece. The finest pieces join
    neighbouring cells of the path, both of which keep it: at radius r [cells] the middle of a diagonal step past
    a corner is at least ``sqrt(r^2 - 1/2)`` off. Of parallel edges all are kept; edges from a node to itself
    are left out.

    Parameters
    ----------
    path
        ``.geojson`` file.
    graph, layers
        The graph and the layers that it was built from.
    frame
        Name of the map frame.
    """
    route = route_pieces(graph, layers)
    node_m = np.concatenate([graph.node_m, layers.map.world_from_cell(route.cells)])
    features = [
        _feature("Point", _point(node_m[node]), {"id": node, "frame": frame}) for node in range(len(node_m))
    ]
    number = len(node_m)
    for (first, second), (cost_s, length_m, clearance_m) in zip(
        route.ends.tolist(), route.measures.tolist(), strict=True
    ):
        for start, end in ((first, second), (second, first)):
            properties = _properties(number, start, end, cost_s, length_m, clearance_m)
            line = [_point(node_m[start]), _point(node_m[end])]
            features.append(_feature("MultiLineString", [line], properties))
            number += 1
    _write(path, features, {})


def _properties(
    number: int, start: int, end: int, cost_s: float, length_m: float, clearance_m: float
) -> dict[str, Any]:
    return {
        "id": number,
        "startid": start,
        "endid": end,
        "cost": cost_s,
        "overridable": True,
        "metadata": {"length_m": length_m, "clearance_m": clearance_m},
    }


def _feature(kind: str, coordinates: Any, properties: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": kind, "coordinates": coordinates},
    }


def _point(point_m: Float[np.ndarray, "2"]) -> list[float]:
    return [float(point_m[0]), float(point_m[1])]


def _write(path: Path | str, features: list[dict[str, Any]], more: dict[str, Any]) -> None:
    name = Path(path).stem
    lines = ",\n".join(json.dumps(feature, allow_nan=False) for feature in features)
    head = "".join(f', "{key}": {json.dumps(value)}' for key, value in more.items())
    write_text(
        path,
        f'{{"type": "FeatureCollection", "name": {json.dumps(name)}{head}, "features": [\n{lines}\n]}}\n',
    )
