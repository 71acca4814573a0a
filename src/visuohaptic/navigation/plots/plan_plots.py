"""Plots of plans, as in figure 4.6 of the dissertation."""

from __future__ import annotations

import itertools
import math
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core import rotation_2d
from ...core.files import literal, new_figure, save_figure
from ..problem import Plan, PlanningProblem

#: Margin around the plan: at least this [m], or this fraction of its greater extent.
_MARGIN_m, _MARGIN = 1.0, 0.1


def plot_path_plan(
    problem: PlanningProblem, plan: Plan, path: Path | str, *, title: str | None = None
) -> None:
    """Draw map, objects, path (green), pushes (red) and numbered explorations into a PNG, zoomed to the plan.

    Parameters
    ----------
    problem
        Map, objects, start and goal.
    plan
        Plan to draw.
    path
        File name of the image.
    title
        Text above the plot; the plan's summary by default.

    Examples
    --------
    >>> import numpy as np
    >>> from visuohaptic.io.maps import OccupancyMap
    >>> from visuohaptic.navigation.planning import make_plan
    >>> from visuohaptic.navigation.problem import PlanningProblem, RobotModel
    >>> walls = np.zeros((30, 40), dtype=bool)
    >>> walls[[0, -1]] = walls[:, [0, -1]] = True
    >>> problem = PlanningProblem(
    ...     OccupancyMap(walls, 0.05), RobotModel(0.15), np.array([0.4, 0.7]), np.array([1.6, 0.7])
    ... )
    >>> plot_path_plan(problem, make_plan(problem), "plan.png")
    """
    from matplotlib.patches import Polygon
    from matplotlib.transforms import Affine2D

    grid = problem.map
    low_m, high_m = _view(problem, plan)
    wide_m, tall_m = high_m - low_m
    size = (8, 8 * max(0.4, min(2.5, tall_m / wide_m)))
    figure, (axes,) = new_figure(1, 1, size=size, layout="constrained")
    axes.set_aspect("equal")
    shade = np.where(grid.cells < 0, 0.8, 1.0 - np.clip(grid.cells, 0, 100) / 100.0)
    width, height = grid.size_m
    x, y, yaw = grid.origin
    turn = Affine2D().rotate(yaw).translate(x, y) + axes.transData
    axes.imshow(
        shade, cmap="gray", vmin=0, vmax=1, origin="lower", extent=(0, width, 0, height), transform=turn,
        interpolation="nearest",
    )  # fmt: skip
    _draw_objects(axes, problem, plan)
    _draw_passages(axes, problem, plan)
    for number, task in enumerate((task for task in plan.tasks if task.kind == "explore"), 1):
        x, y = task.contact_m or problem.start_m
        axes.plot(x, y, "o", color="tab:red", ms=12, ls="none", label="exploration", zorder=6)
        axes.annotate(f"{number}", (x, y), ha="center", va="center", color="white", fontsize=8, zorder=7)
    colours = dict.fromkeys(("push", "sideward", "turn"), "tab:red") | {"door": "tab:purple"}
    for task in plan.tasks:
        if task.path_m:
            dashes = "-." if task.kind == "sideward" else "-"
            colour = colours.get(task.kind, "tab:green")
            axes.plot(*np.array(task.path_m).T, dashes, color=colour, lw=2, label=task.kind)
    for pose in _poses(plan) if problem.robot.footprint_m else ():
        turned = np.array(problem.robot.footprint_m) @ rotation_2d(pose[2]).T + pose[:2]
        axes.add_patch(Polygon(turned, fill=False, edgecolor="tab:blue", lw=0.5, label="footprint"))
    for end_m in _ends(problem, plan):
        axes.add_patch(Polygon(end_m, fill=False, edgecolor="tab:red", ls="--", lw=1, label="after the push"))
    axes.plot(*problem.start_m, "o", color="tab:blue", label="start")
    if (problem.goal_m != problem.start_m).any():
        axes.plot(*problem.goal_m, "*", color="tab:blue", ms=11, label="goal")
    axes.set(xlim=(low_m[0], high_m[0]), ylim=(low_m[1], high_m[1]), xlabel="x [m]", ylabel="y [m]")
    axes.set_title(literal(textwrap.fill(title or plan.summary, 80)), fontsize=10)
    handles, labels = axes.get_legend_handles_labels()
    first = {label: handle for handle, label in zip(handles[::-1], labels[::-1], strict=True)}
    figure.legend([*first.values()][::-1], [*first][::-1], loc="outside lower center", ncols=4, fontsize=8)
    save_figure(path, figure)


def _poses(plan: Plan) -> list[tuple[float, float, float]]:
    """Poses of the robot about half a metre apart [m, m, rad]."""
    poses = []
    for task in plan.tasks:
        for (ax, ay), (bx, by) in itertools.pairwise(task.path_m[:2] if task.kind == "push" else task.path_m):
            parts = max(1, round(math.hypot(bx - ax, by - ay) / 0.5))
            heading = math.atan2(by - ay, bx - ax)
            poses += [
                (ax + k / parts * (bx - ax), ay + k / parts * (by - ay), heading) for k in range(parts + 1)
            ]
    return poses


def _ends(problem: PlanningProblem, plan: Plan) -> list[Float[np.ndarray, "k 2"]]:
    """Footprints of the objects after their pushes [m]."""
    items = {item.id: item for item in problem.objects}
    pushed = [(items[task.object], task) for task in plan.pushes if task.object and task.goal_m]
    return [
        (item.footprint_m - item.centre_m) @ rotation_2d(task.turn_rad).T + task.goal_m
        for item, task in pushed
    ]


def _view(problem: PlanningProblem, plan: Plan) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Lower left and upper right corner [m] of start, goal and plan with a margin; of all objects too where there is no plan."""
    moved = {task.object for task in plan.pushes}
    seen = [item.footprint_m for item in problem.objects if item.id in moved or not plan.reachable]
    seen += [np.array(task.path_m) for task in plan.tasks if task.path_m]
    points = np.concatenate([[problem.start_m, problem.goal_m], *seen, *_ends(problem, plan)])
    margin_m = max(_MARGIN_m, _MARGIN * np.ptp(points, axis=0).max())
    size, (x, y, yaw) = problem.map.size_m, problem.map.origin
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * size @ rotation_2d(yaw).T + (x, y)
    low_m, high_m = points.min(axis=0) - margin_m, points.max(axis=0) + margin_m
    return np.maximum(low_m, corners.min(axis=0)), np.minimum(high_m, corners.max(axis=0))


def _draw_objects(axes: Any, problem: PlanningProblem, plan: Plan) -> None:
    """Outlines and names of the objects; the colour shows which ones are pushed, and which ones cannot be pushed."""
    from matplotlib.patches import Polygon

    moved = {task.object for task in plan.pushes}
    colours = {"pushed": "tab:orange", "fixed": "tab:gray", "not pushed": "tan"}
    box = {"facecolor": "white", "lw": 0, "alpha": 0.75, "pad": 0.8}
    for item in problem.objects:
        kind = "pushed" if item.id in moved else "fixed" if item.known_immovable else "not pushed"
        style: dict[str, Any] = {"facecolor": colours[kind], "edgecolor": "black", "lw": 0.6, "alpha": 0.9}
        axes.add_patch(Polygon(item.footprint_m, label=f"object, {kind}", **style))
        axes.annotate(
            literal(item.id), (item.centre_m[0], item.footprint_m[:, 1].max()), xytext=(0, 2), textcoords="offset points",
            ha="center", va="bottom", fontsize=7, clip_on=True, annotation_clip=True, bbox=box, zorder=5,
        )  # fmt: skip


def _draw_passages(axes: Any, problem: PlanningProblem, plan: Plan) -> None:
    """Doors and elevators, with the waiting or opening time of those that are used in the legend."""
    from matplotlib.patches import Polygon

    steps = {task.object: task for task in plan.tasks if task.kind in {"wait", "door"}}
    for passage in problem.passages:
        axes.add_patch(Polygon(passage.footprint_m, facecolor="tab:cyan", edgecolor="black", lw=0.6))
        x, y = passage.footprint_m.mean(axis=0)
        axes.annotate(literal(passage.id), (x, y), ha="center", va="center", fontsize=7, annotation_clip=True)
        if task := steps.get(passage.id):
            does = "wait at" if task.kind == "wait" else "push open"
            label = f"{does} {passage.id}: {task.cost_s:.0f} s, sigma {task.sigma_s:.0f} s"
            axes.plot(x, y, "o", mfc="none", mec="tab:purple", ms=14, mew=2, ls="none", label=literal(label))
