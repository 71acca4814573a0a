"""Grasps verified under large deformation (Fig. 6.12).

Force against deformation of the grasps in the dissertation, green if it states that the grasp holds, red if it
does not; the dotted line is the maximum allowed deformation (nonlinear simulation; the dissertation grasped
real objects).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...deformation.shapes.load_shell import load_object
from ...grasping import GraspTask, confirm_grasp
from ...grasping.planner import GraspPlan, plan_grasps
from ...report.style import COLOURS, draw_axes
from ..output import Columns, Output


@dataclass(frozen=True)
class Case:
    """Statement of Alt 2016, Sec. 6.4.2 about a single grasp."""

    name: str
    container: str
    force_N: float
    low: float  #: height of the location, as a fraction of the object's
    high: float
    side: str  #: "x", "y": narrow or flat side; "" is either
    good: bool


CASES = (
    Case("cleaner near its lid", "cleaner", 20.0, 0.85, 1.0, "", True),
    Case("cleaner on its side", "cleaner", 20.0, 0.45, 0.55, "x", True),
    Case("cleaner at its soft, flat centre", "cleaner", 20.0, 0.48, 0.53, "y", False),
    Case("cup-rim on top", "cup-rim", 20.0, 0.9, 1.0, "", True),
    Case("cup-rim in the centre", "cup-rim", 20.0, 0.45, 0.55, "", False),
    # The cup in the dissertation was grasped at the height where the rim supported the other cup.
    Case("cup on top, 5 N", "cup", 5.0, 0.96, 1.0, "", False),
)


def best_vertex(plan: GraspPlan, case: Case) -> int:
    """The vertex with the best score within the described part of the surface.

    Parameters
    ----------
    plan
        Scores of the surface.
    case
        Described part.
    """
    points = plan.surface.vertices_m
    height = points[:, 2] / points[:, 2].max()
    there = (height >= case.low) & (height <= case.high)
    if case.side:
        # The centre of that side: within 5 degrees of its axis.
        angle = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 180
        away = np.minimum(angle, 180 - angle) if case.side == "x" else np.abs(angle - 90)
        there &= away < 5
    return int(np.argmax(np.where(there, plan.scores.pair, -1.0)))


def run(out: Output) -> None:
    """Every statement of the dissertation: the map's prediction, and the result of the nonlinear simulation.

    Parameters
    ----------
    out
        Receives the table ``grasps``, picture ``grasps``, and the comparisons; its seed and size are used.
    """
    cases = CASES[3:5] if out.quick else CASES
    rows = Columns("grasp force_N text_holds score map_mm simulated_mm map_holds simulated_holds why")
    curves = []
    plans: dict[tuple[str, float], Any] = {}
    for case in cases:
        key = (case.container, case.force_N)
        if key not in plans:
            container = load_object(case.container, around=32 if out.quick else None)
            plans[key] = (
                container,
                plan_grasps(container, GraspTask(force_N=case.force_N, pairs="axis"), count=1, confirm=False),
            )
        container, plan = plans[key]
        vertex = best_vertex(plan, case)
        confirmation = confirm_grasp(container, vertex, case.force_N)
        score = float(plan.scores.pair[vertex])
        rows.add(case.name, case.force_N, case.good, score, 1e3 * float(plan.scores.deformation_m[vertex]),
                 1e3 * min(confirmation.deformation_m, float(confirmation.curve_m[-1])), score >= plan.task.min_score, confirmation.holds,
                 confirmation.reason)  # fmt: skip
        curves.append((case, confirmation))
    out.table("grasps", rows)

    def draw(axes: Any) -> None:
        for number, (case, confirmation) in enumerate(curves):
            colour = COLOURS["green"] if case.good else "#c62828"
            style = ("-", "--", ":", "-.", "--", "-.")[number % 6]
            axes.plot(
                1e3 * confirmation.curve_m,
                confirmation.curve_N,
                style,
                color=colour,
                label=f"{case.name.removesuffix(', 5 N')}, {case.force_N:g} N",
            )
            axes.plot(1e3 * min(confirmation.deformation_m, float(confirmation.curve_m[-1])),
                      np.interp(min(confirmation.deformation_m, float(confirmation.curve_m[-1])), confirmation.curve_m, confirmation.curve_N), "o",
                      color=colour)  # fmt: skip
        axes.axvline(5, color=COLOURS["grey"], ls=":")
        axes.set(xlabel="deformation of one side [mm]", ylabel="force [N]")
        axes.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)

    out.picture("grasps", draw_axes(1, 1, draw, size=(8.0, 4.8)))
    for name, flag in (("on the map", "map_holds"), ("by the nonlinear simulation", "simulated_holds")):
        right = sum(a == b for a, b in zip(rows[flag], rows["text_holds"], strict=True))
        out.compare(f"grasps told right {name}", right, f"of {len(cases)}", dissertation=len(cases),
                    note="predictions of stable and unstable locations are confirmed")  # fmt: skip
