"""Joint planning in an office (Fig. 4.6).

(a) Map with candidates for exploration (orange) and direct push plans (red). (b) Navigation graph of the
map and shortest path (green), a long detour. (c) With manipulation nodes (blue), a much shorter one (office
modelled after the figure, objects with the printed tags).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.collections import LineCollection

from ...navigation.grid.footprints import find_footprints
from ...navigation.planning import JointGraph, alternatives, extend_graph, make_plan
from ...navigation.problem import Plan, PushCosts, push_node
from ...report.style import COLOURS, draw_axes
from ...rigs.virtual_office import ROBOT, office
from .._building import draw_map, outline, regions_of
from ..output import Output


def run(out: Output) -> None:
    """Plan with and without pushing, and report lengths and times.

    Parameters
    ----------
    out
        Receives the tables ``tasks`` and ``candidates``, picture ``office``, and the comparisons; its seed and size are used.
    """
    problem = office()
    plans = alternatives(problem, PushCosts(price_ends=False))  # ends of pushes are known in the dissertation
    push, detour = plans["cheapest"], plans["no pushing"]
    detached = make_plan(office((5.3, 3.6)))
    regions = regions_of(problem.map)
    joint = extend_graph(
        regions.graph, regions, ROBOT, [push_node(item, ROBOT, 0.15) for item in problem.objects]
    )
    candidates = find_footprints(problem.map)
    direct = [*push.pushes, *detached.pushes]
    out.table(
        "tasks",
        {
            "plan": [name for name, plan in (("push", push), ("detour", detour)) for _ in plan.tasks],
            "task": [task.kind for plan in (push, detour) for task in plan.tasks],
            "object": [task.object or "" for plan in (push, detour) for task in plan.tasks],
            "length_m": [task.length_m for plan in (push, detour) for task in plan.tasks],
            "cost_s": [task.cost_s for plan in (push, detour) for task in plan.tasks],
        },
    )
    out.table("candidates", {"x_m": [c.centre_m[0] for c in candidates],
                             "y_m": [c.centre_m[1] for c in candidates],
                             "size_x_m": [c.size_m[0] for c in candidates],
                             "size_y_m": [c.size_m[1] for c in candidates]})  # fmt: skip

    def draw(*axes: Any) -> None:
        for axis in axes:
            draw_map(axis, problem.map)
        for candidate in candidates:
            axes[0].fill(*candidate.outline_m.T, color=COLOURS["orange"], alpha=0.75, lw=0)
        for one in direct:
            axes[0].plot(*np.array(one.path_m)[:, :2].T, color="red", lw=2)
        axes[0].set_title("a  candidates and direct pushes")
        _graph(axes[1], joint, False)
        _way(axes[1], detour)
        axes[1].set_title(f"b  navigation only: {detour.length_m:.1f} m")
        _graph(axes[2], joint, True)
        _way(axes[2], push)
        for item in problem.objects:
            outline(axes[2], item.footprint_m, color=COLOURS["orange"], lw=1.2)
            top = (float(item.centre_m[0]), float(item.footprint_m[:, 1].max()))
            axes[2].annotate(item.id, top, xytext=(0, 4), textcoords="offset points", ha="center", fontsize=8)
        axes[2].set_title(f"c  with manipulation: {push.length_m:.1f} m")

    out.picture("office", draw_axes(1, 3, draw, size=(15.0, 4.6)), dpi=90)
    note = "an office like the figure's, not to its scale"
    out.compare("length of the path, navigation only", detour.length_m, "m", dissertation=6.0, note=note)
    out.compare("length of the path, with manipulation", push.length_m, "m", dissertation=1.8, note=note)
    out.compare(
        "t_mani of the stool", push.pushes[0].cost_s, "s", dissertation=7.0, note="of which 4 s constant"
    )
    out.compare("time, navigation only", detour.cost_s, "s")
    out.compare("time, with manipulation", push.cost_s, "s")
    out.compare("detached nodes in the top right can be reached by a push", float(detached.reachable),
                dissertation=1)  # fmt: skip


def _graph(axis: Any, joint: JointGraph, added: bool) -> None:
    graph, grid = joint.visual, joint.regions.layers.map
    lines = [grid.world_from_cell(graph.edge_path(edge)) for edge in range(len(graph.edges))]
    axis.add_collection(LineCollection(lines, colors=COLOURS["yellow"], linewidths=1.0, zorder=2))
    axis.plot(*graph.node_m.T, "o", color=COLOURS["ink"], ms=3, zorder=3)
    for node in joint.added if added else ():
        at = node.kind.outline_m.mean(axis=0)
        for other in node.neighbours if np.isfinite(node.task_s) else ():
            axis.plot(*np.vstack([at, graph.node_m[other]]).T, color=COLOURS["blue"], lw=0.8, zorder=3)
        axis.plot(*at, "o", mfc="none", mec=COLOURS["blue"], mew=1.5, ms=12, zorder=4)


def _way(axis: Any, plan: Plan) -> None:
    for task in plan.tasks:
        if task.path_m:
            push = task.kind == "push"
            axis.plot(*np.array(task.path_m).T, color="red" if push else COLOURS["green"], lw=2.4, zorder=5)
