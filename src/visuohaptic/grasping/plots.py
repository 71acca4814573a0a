"""Plots of scores and grasps, as figure 6.4."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.files import draw_surface, frame_box, literal, new_figure, ramp_colours, save_figure
from .planner import GraspPlan


def plot_plan(path: Path | str, plans: Sequence[tuple[str, GraspPlan]]) -> None:
    """Figure 6.4: each object coloured by its grasp score, arrows at the ranked grasps.

    Parameters
    ----------
    path
        .png, .pdf or .svg.
    plans
        Titles and plans, one column each: the object above, its scores over the height below.
    """
    figure, views = new_figure(
        2, len(plans), size=(4.6 * len(plans), 8.5), layout="constrained", projection="3d"
    )
    for column, (title, plan) in enumerate(plans):
        _draw_object(views[column], title, plan)
        views[len(plans) + column].remove()
        axes = figure.add_subplot(2, len(plans), len(plans) + column + 1)
        _draw_profile(axes, plan)
        if column == 0:
            axes.set_ylabel("height [mm]")
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3, fontsize=8)
    save_figure(path, figure)


def _draw_object(axes: Any, title: str, plan: GraspPlan) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    points = plan.surface.vertices_m * 1e3
    faces = np.asarray(plan.surface.faces)
    shade = ramp_colours(plan.scores.pair)[faces].mean(axis=1) / 255
    low, high = points[np.unique(faces)].min(axis=0), points[np.unique(faces)].max(axis=0)
    draw_surface(axes, points[faces], shade)
    reach = 0.28 * float((high - low)[:2].max())
    for rank, grasp in enumerate(plan.grasps):
        for place, force in ((grasp.first_m, grasp.direction), (grasp.second_m, -grasp.direction)):
            tip = 1e3 * place
            start = tip - reach * force
            axes.quiver(*start, *(tip - start), color="crimson", lw=2.2 if rank == 0 else 1.0)
            if rank == 0:
                axes.text(*(start - 0.4 * reach * force), "1", color="crimson", ha="center", va="center")
    frame_box(axes, low - reach, high + reach)
    axes.set_axis_off()
    best = f"best score {plan.grasps[0].score:.2f}" if plan.grasps else "no grasp"
    axes.set_title(literal(f"{title}\n{best}"))
    axes.figure.colorbar(
        ScalarMappable(Normalize(0, 1), "viridis"), ax=axes, label="grasp score", shrink=0.6, pad=0.02
    )


def _draw_profile(axes: Any, plan: GraspPlan) -> None:
    """Best value at each height: the product, and its factors."""
    used = np.unique(plan.surface.faces)
    z = plan.surface.vertices_m[used, 2] * 1e3
    edges = np.linspace(z.min(), z.max(), 49)
    level = np.clip(np.digitize(z, edges) - 1, 0, 47)
    parts = (
        ("contact", plan.scores.contact, "tab:blue", 1.0),
        ("curvature", plan.scores.curvature, "tab:orange", 1.0),
        ("height", plan.scores.height, "tab:green", 1.0),
        ("deformation", plan.scores.deformation, "tab:red", 1.0),
        ("grasp score", plan.scores.pair, "black", 2.5),
    )
    best = np.full(48, -1, dtype=np.int64)
    order = np.argsort(plan.scores.pair[used], kind="stable")
    best[level[order]] = order
    rows = np.flatnonzero(best >= 0)
    for name, values, colour, width in parts:
        axes.plot(values[used][best[rows]], z[best[rows]], color=colour, lw=width, label=name)
    axes.axvline(plan.task.min_score, color="grey", ls=":", lw=1)
    for grasp in plan.grasps:
        axes.plot(grasp.score, 1e3 * grasp.first_m[2], "o", color="crimson", ms=5)
    axes.set_xlim(-0.02, 1.02)
    axes.set_xlabel("score, at the best place of each height")
    axes.grid(alpha=0.3)
