"""Graphs as GeoJSON: a lossless format for navigation graphs, and route graphs of the Nav2 route server.

Both contain one ``Point`` per node and one ``MultiLineString`` per edge, in metres of the map frame. Ids are
integers that are unique over nodes and edges, as the route server requires. In a route graph edges
are directed, so each undirected edge appears twice; edges from a node to itself are not useful there.
The route server drives the straight line between nodes: edges are split until that line is free.
"""

from __future__ import annotations

import json
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ...core.files import load_json, write_text
from ...io.maps.occupancy_map import OccupancyMap
from ..graph.navigation_graph import NavigationGraph, components_of
from ..grid.cost_grid import GridLayers
from .route_edges import route_pieces

__all__ = ["RouteGraph", "load_graph", "load_route_graph", "save_graph", "save_route_graph"]

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class RouteGraph:
    """A route graph of Nav2: n nodes, m directed edges."""

    node_ids: Int[np.ndarray, "n"]
    node_m: Float[np.ndarray, "n 2"]  #: (x, y) in ``frame`` [m]
    frame: str  #: empty if the file does not specify it
    edge_ids: Int[np.ndarray, "m"]
    edges: Int[np.ndarray, "m 2"]  #: start and end as indices into ``node_ids``
    edge_cost: Float[np.ndarray, "m"]  #: NaN if the file leaves it to the server


def save_graph(path: Path | str, graph: NavigationGraph, map: OccupancyMap, *, frame: str = "map") -> None:
    """Write a graph with the cells of its edges; :func:`load_graph` restores it.

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
    features = [
        feature("Point", node_m[node].tolist(), {"id": node, "frame": frame}) for node in range(len(node_m))
    ]
    number = len(node_m)
    for (first, second), (cost_s, length_m, clearance_m) in zip(
        route.ends.tolist(), route.measures.tolist(), strict=True
    ):
        for start, end in ((first, second), (second, first)):
            properties = edge_properties(
                number, start, end, cost_s, length_m=length_m, clearance_m=clearance_m
            )
            line = node_m[[start, end]].tolist()
            features.append(feature("MultiLineString", [line], properties))
            number += 1
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


def load_route_graph(path: Path | str) -> RouteGraph:
    """Read a graph of the Nav2 route server, also one drawn by hand or written by another program.

    Parameters
    ----------
    path
        File name.

    Raises
    ------
    InputError
        Names the file and the feature, with what was found and what was expected.
    """
    nodes, edges, _ = _read(path)
    ids = np.array([node["id"] for node in nodes], dtype=np.int64)
    place = {int(number): k for k, number in enumerate(ids)}
    frames = {node["properties"].get("frame", "") for node in nodes}
    if len(frames) > 1:
        raise InputError(path, f"found frames {sorted(map(str, frames))}, expected one", field="frame")
    joined = np.array([(place[e["start"]], place[e["end"]]) for e in edges], dtype=np.int64).reshape(-1, 2)
    return RouteGraph(
        ids,
        np.array([node["points"][0] for node in nodes]).reshape(-1, 2),
        str(next(iter(frames), "")),
        np.array([edge["id"] for edge in edges], dtype=np.int64),
        joined,
        np.array([_number(path, edge, "cost", float("nan")) for edge in edges]),
    )


def load_graph(path: Path | str) -> tuple[NavigationGraph, OccupancyMap]:
    """Read a file written by :func:`save_graph`; the map has the geometry of the grid, with all cells unknown.

    Parameters
    ----------
    path
        See :func:`load_route_graph`.

    Raises
    ------
    InputError
        See :func:`load_route_graph`; also if the file has no grid.
    """

    nodes, edges, data = _read(path)
    grid: Any = data.get("grid")
    try:
        rows, columns = int(grid["rows"]), int(grid["columns"])
        resolution_m, origin = float(grid["resolution_m"]), [float(value) for value in grid["origin"]]
        if rows < 1 or columns < 1 or rows * columns > 2**28 or len(origin) != 3:
            raise ValueError
    except (TypeError, KeyError, ValueError, OverflowError) as error:
        raise InputError(
            path,
            "found no grid of rows, columns, resolution_m and origin",
            field="grid",
            remedy="read route graphs of other programs with load_route_graph",
        ) from error
    map = OccupancyMap(np.full((rows, columns), -1, np.int8), resolution_m, (origin[0], origin[1], origin[2]))
    node_m = np.array([node["points"][0] for node in nodes]).reshape(-1, 2)
    cells = map.cell_from_world(node_m).astype(np.int32)
    place = {node["id"]: k for k, node in enumerate(nodes)}
    joined = np.array([(place[e["start"]], place[e["end"]]) for e in edges], dtype=np.int32).reshape(-1, 2)
    paths = [map.cell_from_world(np.array(edge["points"])).astype(np.int32) for edge in edges]
    every = [cells, *paths]
    if not all(map.inside(part).all() for part in every):
        raise InputError(path, "found a point outside its grid", field="coordinates")
    component, components = components_of(len(nodes), joined)
    start = np.concatenate([[0], np.cumsum([len(part) for part in paths])]).astype(np.int32)
    path_cells = np.concatenate(paths) if paths else np.empty((0, 2), np.int32)
    graph = NavigationGraph(
        cells,
        map.world_from_cell(cells),
        joined,
        np.array([_number(path, edge, "cost") for edge in edges]),
        np.array([_number(path, edge, "length_m") for edge in edges]),
        np.array([_number(path, edge, "clearance_m") for edge in edges]),
        start,
        path_cells,
        component,
        components,
    )
    return graph, map


def _number(path: Path | str, edge: dict[str, Any], name: str, default: float | None = None) -> float:
    properties = edge["properties"]
    metadata = properties.get("metadata")
    value = properties.get(name, metadata.get(name) if isinstance(metadata, dict) else None)
    if value is None and default is not None:
        return default
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError(path, f"found {value!r}, expected a number", field=f"edge {edge['id']}: {name}")
    return float(value)


def _read(path: Path | str) -> tuple[list[dict[str, Any]], list[dict[str, Any]], dict[str, Any]]:
    """Nodes and edges of a file, each with id, points and properties, with all references checked."""
    data: Any = load_json(path, "a GeoJSON FeatureCollection", lambda data: data)
    features = data.get("features") if isinstance(data, dict) else None
    if not isinstance(features, list):
        raise InputError(path, "found no list of features, expected a GeoJSON FeatureCollection")
    nodes: list[dict[str, Any]] = []
    edges: list[dict[str, Any]] = []
    for k, feature in enumerate(features):
        where = f"feature {k + 1}"
        try:
            kind = feature["geometry"]["type"]
            coordinates = feature["geometry"]["coordinates"]
            properties = feature["properties"]
            if kind == "Point":
                points = [coordinates]
            elif kind == "LineString":
                points = coordinates
            elif kind == "MultiLineString":
                points = [point for line in coordinates for point in line]
            else:
                continue  # drawings may be in the same file; the route server skips them too
            found = {"id": _whole(properties["id"]), "properties": properties}
            found["points"] = [(float(point[0]), float(point[1])) for point in points]
            if kind != "Point":
                found["start"] = _whole(properties["startid"])
                found["end"] = _whole(properties["endid"])
            if not np.isfinite(found["points"]).all() or not found["points"]:
                raise ValueError("points that are not finite")
        except (TypeError, KeyError, IndexError, ValueError, OverflowError) as error:
            what = f"no {error}" if isinstance(error, KeyError) else str(error)
            raise InputError(path, f"is not a node or edge of a route graph: {what}", field=where) from error
        (nodes if kind == "Point" else edges).append(found)
    known = {node["id"] for node in nodes}
    if len(known) < len(nodes):
        raise InputError(path, "found two nodes with the same id", field="id")
    if len({edge["id"] for edge in edges}) < len(edges):
        # This occurs in graphs drawn by hand, and the route server accepts it.
        _log.warning("%s: some edges have the same id", path)
    for edge in edges:
        for end in ("start", "end"):
            if edge[end] not in known:
                raise InputError(path, f"found no node {edge[end]}", field=f"edge {edge['id']}: {end}id")
    return nodes, edges, data


def _whole(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**32:
        raise ValueError(f"id {value!r}, expected a whole number")
    return value
