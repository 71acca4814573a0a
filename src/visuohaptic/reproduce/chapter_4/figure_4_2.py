"""Visuo-haptic graph with manipulation nodes (Fig. 4.2).

(a) Four movable obstacles (brown) are on the map, two of them in doorways: the graph is disconnected. (b)
Manipulation nodes (blue) with their regions (yellow) connect it again (synthetic floor plan, tags of Table
4.1).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.collections import LineCollection

from ...navigation.planning import JointGraph, extend_graph
from ...navigation.problem.node_types import push_node
from ...report.style import COLOURS, draw_axes
from ...rigs.virtual_office import ROBOT
from .._building import OBJECTS, building, draw_map, regions_of, with_all
from ..output import Output


def run(out: Output) -> None:
    """Build both graphs and report which parts the nodes connect.

    Parameters
    ----------
    out
        Receives the tables ``manipulation_nodes`` and ``edges``, picture ``joint_graph``, and the comparisons; its seed and size are used.
    """
    empty, regions = regions_of(building()).graph, regions_of(with_all())
    graph = regions.graph
    joint = extend_graph(graph, regions, ROBOT, [push_node(item, ROBOT) for item in OBJECTS])
    benefit = [joint.benefit_s(item.id) for item in OBJECTS]
    out.table(
        "manipulation_nodes",
        {
            "object": [node.kind.id for node in joint.added],
            "neighbours": [len(node.neighbours) for node in joint.added],
            "t_mani_s": [node.task_s for node in joint.added],
            "benefit_s": benefit,
        },
    )
    ends, cost = joint.edges()
    out.table("edges", {"a": ends[:, 0], "b": ends[:, 1], "cost_s": cost})
    out.picture("joint_graph", draw_axes(2, 1, lambda *axes: _draw(axes, joint), size=(9.0, 11.0)), dpi=80)
    parts = _parts(joint.visual.nodes + len(joint.added), ends, joint.visual.nodes)
    out.compare("connected parts without obstacles", empty.components)
    out.compare("connected parts with obstacles", graph.components, note="two passages are blocked")
    out.compare("connected parts with manipulation nodes", parts, dissertation=1,
                note="access is possible through these nodes again")  # fmt: skip
    out.compare("objects that open a passage", float(np.isinf(benefit).sum()), dissertation=2)


def _parts(nodes: int, ends: np.ndarray, visual: int) -> int:
    """Connected components of the nodes of the map."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    matrix = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(nodes, nodes))
    return len(np.unique(connected_components(matrix, directed=False)[1][:visual]))


def _draw(axes: Any, joint: JointGraph) -> None:
    graph, regions = joint.visual, joint.regions
    grid = regions.layers.map
    for axis, letter in zip(axes, "ab", strict=True):
        draw_map(axis, grid)
        for item in OBJECTS:
            axis.fill(*item.footprint_m.T, color="#8a5a2b", lw=0, zorder=2)
        if letter == "b":
            for node in joint.added:
                cells = np.column_stack(np.unravel_index(node.region, grid.shape))
                axis.plot(*grid.world_from_cell(cells).T, "s", ms=1.6, color="#f4e27a", mew=0, zorder=1)
        lines = [grid.world_from_cell(graph.edge_path(edge)) for edge in range(len(graph.edges))]
        axis.add_collection(LineCollection(lines, colors=COLOURS["orange"], linewidths=0.9, zorder=3))
        axis.plot(*graph.node_m.T, "o", color=COLOURS["ink"], ms=2.6, zorder=4)
    axes[0].set_title(f"a  graph of the map, {graph.components} connected parts")
    axes[1].set_title("b  with manipulation nodes")
    for node in joint.added:
        at = node.kind.outline_m.mean(axis=0)
        for other in node.neighbours:
            axes[1].plot(*np.vstack([at, graph.node_m[other]]).T, color=COLOURS["blue"], lw=0.8, zorder=5)
        axes[1].plot(*at, "o", mfc="none", mec=COLOURS["blue"], mew=1.6, ms=8, zorder=6)
        axes[1].annotate(f"{node.kind.id}, {node.task_s:.0f} s", at, xytext=(7, 6), fontsize=8, zorder=7,
                         textcoords="offset points", color=COLOURS["blue"])  # fmt: skip
