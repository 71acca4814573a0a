"""Graphs as GeoJSON: navigation graphs without loss, and route graphs for the Nav2 route server.

Both contain one ``Point`` per node and one ``MultiLineString`` per edge, in metres of the map frame. Ids are
integers that are unique over nodes and edges, as the route server requires. In a route graph edges
are directed, so each undirected edge appears twice; edges from a node to itself are not useful there.
The route server drives the straight line between nodes: edges are split until that line is free.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.files import write_text
from ...io.maps.occupancy_map import OccupancyMap
from ..graph.navigation_graph import NavigationGraph
from ..grid.cost_grid import GridLayers
from .route_edges import route_pieces


def save_graph(path: Path | str, graph: NavigationGraph, map: OccupancyMap, *, frame: str = "map") -> None:
    """Write a graph with the path of each edge and the grid of its map.

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
        row, column = graph.node_cells[node].tolist()
        metadata = {"row": row, "column": column, "component": int(graph.component[node])}
        properties = {"id": node, "frame": frame, "metadata": metadata}
        features.append(feature("Point", graph.node_m[node].tolist(), properties))
    for edge in range(len(graph.edges)):
        line = map.world_from_cell(graph.edge_path(edge)).tolist()
        start, end = graph.edges[edge].tolist()
        cost_s, length_m, clearance_m = (
            float(of[edge]) for of in (graph.edge_cost_s, graph.edge_length_m, graph.edge_clearance_m)
        )
        properties = edge_properties(
            graph.nodes + edge, start, end, cost_s, length_m=length_m, clearance_m=clearance_m
        )
        features.append(feature("MultiLineString", [line], properties))
    x, y, yaw = map.origin
    rows, columns = map.shape
    grid = {"rows": rows, "columns": columns, "resolution_m": map.resolution_m, "origin": [x, y, yaw]}
    write_features(path, features, {"grid": grid})


def save_route_graph(
    path: Path | str, graph: NavigationGraph, layers: GridLayers, *, frame: str = "map"
) -> None:
    """Write a graph for the Nav2 route server.

    Each edge appears in both directions, split at cells of its path until every straight piece keeps the robot's
    radius from the occupied cells, with cost, length and clearance of the straight piece. The finest pieces connect
    neighbouring cells of the path, both of which keep it: at radius r [cells] the middle of a diagonal step past
    a corner keeps at least ``sqrt(r^2 - 1/2)``. All parallel edges are kept; edges from a node to itself
    are omitted.

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
    write_route(path, frame, node_m, route.ends, route.measures, {}, {})


def write_route(
    path: Path | str,
    frame: str,
    node_m: Float[np.ndarray, "n 2"],
    ends: Int[np.ndarray, "m 2"],
    measures: Float[np.ndarray, "m k"],
    objects: Mapping[int, dict[str, Any]],
    operations: Mapping[int, dict[str, Any]],
) -> None:
    """Write nodes and undirected edges for the Nav2 route server: each edge in both directions.

    Parameters
    ----------
    path
        ``.geojson`` file.
    frame
        Name of the map frame.
    node_m
        Positions of the nodes [m].
    ends, measures
        Nodes of each edge, and its cost [s], or cost [s], length [m] and clearance [m].
    objects, operations
        Metadata of the nodes of objects, and operations of the edges into them, by the number of the node.
    """
    features = []
    for node, place in enumerate(node_m.tolist()):
        more = {"metadata": objects[node]} if node in objects else {}
        features.append(feature("Point", place, {"id": node, "frame": frame, **more}))
    for (first, second), (cost_s, *others) in zip(ends.tolist(), measures.tolist(), strict=True):
        metadata = dict(zip(("length_m", "clearance_m"), others, strict=False))
        for start, end in ((first, second), (second, first)):
            properties = edge_properties(len(features), start, end, cost_s, **metadata)
            if end in operations:
                properties["operations"] = operations[end]
            features.append(feature("MultiLineString", [node_m[[start, end]].tolist()], properties))
    write_features(path, features)


def edge_properties(number: int, start: int, end: int, cost_s: float, **metadata: float) -> dict[str, Any]:
    """Properties of an edge that the route server reads.

    Parameters
    ----------
    number, start, end
        Ids of the edge and of its nodes.
    cost_s
        Cost of driving along it [s].
    **metadata
        Further properties by name.
    """
    properties = {"id": number, "startid": start, "endid": end, "cost": cost_s, "overridable": True}
    return {**properties, "metadata": metadata} if metadata else properties


def feature(kind: str, coordinates: Any, properties: dict[str, Any]) -> dict[str, Any]:
    """A GeoJSON feature.

    Parameters
    ----------
    kind, coordinates
        Type and coordinates of its geometry [m].
    properties
        Properties for the file's reader.
    """
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def write_features(
    path: Path | str, features: list[dict[str, Any]], more: dict[str, Any] | None = None
) -> None:
    """Write a feature collection, one feature per line.

    Parameters
    ----------
    path
        ``.geojson`` file.
    features
        From :func:`feature`.
    more
        Additional members of the collection.
    """
    lines = ",\n".join(json.dumps(one, allow_nan=False) for one in features)
    head = json.dumps({"type": "FeatureCollection", "name": Path(path).stem, **(more or {})})
    write_text(path, f'{head[:-1]}, "features": [\n{lines}\n]}}\n')
