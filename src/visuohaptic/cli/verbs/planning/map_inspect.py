"""``visuohaptic map inspect``: summarise a map, and where a robot of a given radius can drive.

reads   a map_server YAML file with its image
writes  nothing

example: visuohaptic map inspect office.yaml --radius 0.25
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .... import io
from ....core.files.plain_json import picked
from ....navigation import mapping

#: Modules with kernels of the verb, the last needed first.
KERNELS = (
    "navigation.graph.tracing._line_kernels",
    "navigation.graph.tracing._skeleton_kernels",
)
#: Maximum number of narrow passages in the output.
_NARROWEST = 5


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("map", Path, "map_server YAML file")
    add("--radius", 0.17, "radius of the robot [m] (0.17)", dest="radius_m")
    add("--doors", bool, "also list doors, and isolated objects that may be movable")
    add("--unknown-is-free", bool, "treat unknown cells as free")


def run(args: Any) -> dict[str, Any]:
    """Summarise the map; returns the mapping that ``--json`` prints."""
    from ....navigation.graph.navigation_graph import build_graph
    from ....navigation.grid.cost_grid import SpeedLimits, grid_layers

    grid = io.OccupancyMap.load(args.map)
    limits = SpeedLimits(args.radius_m, v_min_m_s=0.05, v_max_m_s=0.3)
    layers = grid_layers(grid, limits, unknown_is_free=args.unknown_is_free)
    graph = build_graph(layers)
    return {"map": str(args.map), **describe(layers, graph), **(_seen(grid) if args.doors else {})}


def _seen(grid: Any) -> dict[str, Any]:
    """Doors with their probability, and outlines that stand alone."""
    from ....navigation.grid.footprints import find_footprints

    return {
        "doors": [
            {
                "at_m": [round(float(v), 3) for v in door.middle_m],
                "width_m": round(door.width_m, 3),
                "probability": round(door.confidence, 3),
            }
            for door in mapping.find_doors(grid).doors
        ],
        "candidates": [
            {
                "at_m": [round(float(v), 3) for v in candidate.centre_m],
                "size_m": [round(v, 3) for v in candidate.size_m],
            }
            for candidate in find_footprints(grid)
        ],
    }


def describe(layers: Any, graph: Any) -> dict[str, Any]:
    """Figures of a map and its graph, as both verbs print them.

    Parameters
    ----------
    layers
        Costmap layers of the map.
    graph
        Navigation graph of the map.
    """
    import numpy as np

    grid = layers.map
    cells = grid.cells.size
    area_m2 = grid.resolution_m**2
    reachable = layers.reachable
    # Each passage once: the narrowest cell of an edge.
    passages = []
    for edge in np.argsort(graph.edge_clearance_m)[:_NARROWEST]:
        path = graph.edge_path(int(edge))
        narrow = path[np.argmin(layers.distance_m[path[:, 0], path[:, 1]])]
        x, y = grid.world_from_cell(narrow)
        passages.append(
            {
                "width_m": 2 * float(graph.edge_clearance_m[edge]),
                "at_m": [float(x), float(y)],
                "edge": int(edge),
            }
        )
    sizes = np.bincount(graph.component, minlength=graph.components)
    return {
        "rows": grid.shape[0],
        "columns": grid.shape[1],
        "resolution_m": grid.resolution_m,
        "size_m": list(grid.size_m),
        "origin": list(grid.origin),
        "share_occupied": float((grid.cells >= 50).sum() / cells),
        "share_free": float(((grid.cells >= 0) & (grid.cells < 50)).sum() / cells),
        "share_unknown": float(grid.unknown.sum() / cells),
        "radius_m": layers.radius_m,
        "reachable_m2": float(reachable.sum() * area_m2),
        "max_width_m": 2 * float(layers.distance_m[reachable].max()) if reachable.any() else None,
        **picked(graph, "components loops nodes"),
        "edges": len(graph.edges),
        "nodes_of_largest_component": int(sizes.max(initial=0)),
        "length_m": float(graph.edge_length_m.sum()),
        "narrowest_passages": passages,
    }
