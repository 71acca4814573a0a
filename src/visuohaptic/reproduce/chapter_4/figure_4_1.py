"""Skeleton, distance map and navigation graph (Fig. 4.1).

Several rooms and a hallway: (a) distance from obstacles with the skeleton, (b) navigation graph, regions in
pale colours (synthetic floor plan; the dissertation used the map of a real building).
"""

from __future__ import annotations

import numpy as np

from ...navigation.plots.map_plots import plot_navigation
from ...rigs.virtual_office import ROBOT
from .._building import building, regions_of
from ..output import Output


def run(out: Output) -> None:
    """Build the graph of the floor and draw it.

    Parameters
    ----------
    out
        Receives the tables ``nodes`` and ``edges``, picture ``navigation``, and the comparisons; its seed and size are used.
    """
    regions = regions_of(building())
    graph = regions.graph
    out.picture("navigation", plot_navigation(regions), dpi=80)
    out.table("nodes", {"node": np.arange(graph.nodes), "x_m": graph.node_m[:, 0], "y_m": graph.node_m[:, 1],
                        "edges": graph.degree})  # fmt: skip
    out.table("edges", {"a": graph.edges[:, 0], "b": graph.edges[:, 1], "length_m": graph.edge_length_m,
                        "cost_s": graph.edge_cost_s, "clearance_m": graph.edge_clearance_m})  # fmt: skip
    out.compare("nodes", graph.nodes)
    out.compare("edges", len(graph.edges))
    out.compare("connected parts", graph.components, note="1: all rooms can be reached")
    reachable = int((regions.layers.distance_m >= ROBOT.radius_m).sum())
    assigned = int(((regions.node >= 0) & (regions.layers.distance_m >= ROBOT.radius_m)).sum())
    out.compare("reachable cells that belong to a region", 100 * assigned / max(reachable, 1), "%")
    out.compare("least clearance of an edge", float(graph.edge_clearance_m.min()), "m",
                note=f"the platform's radius is {ROBOT.radius_m} m")  # fmt: skip
