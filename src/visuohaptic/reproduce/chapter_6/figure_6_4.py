"""Grasping scores of a bottle and of a cup with and without a rim (Fig. 6.4).

Grasp score on the surface, yellow is good, arrows at feasible grasps, and the scores over the height
(simulated maps, as in the dissertation).
"""

from __future__ import annotations

import numpy as np

from ...deformation.shapes.load_shell import load_object
from ...grasping import GraspTask, plot_plan
from ...grasping.planner import plan_grasps
from ..output import Columns, Output

#: Object -> force [N].
TASKS = {"cleaner": 20.0, "cup-rim": 20.0, "cup": 5.0}


def run(out: Output) -> None:
    """Plan for the three objects.

    Parameters
    ----------
    out
        Receives the table ``grasps``, picture ``scores``, and the comparisons; its seed and size are used.
    """
    plans = []
    rows = Columns("object rank height_share angle_deg score deformation_mm")
    for name, force in TASKS.items():
        container = load_object(name, around=24 if out.quick else None)
        plan = plan_grasps(container, GraspTask(force_N=force, pairs="axis"), count=5, confirm=False)
        plans.append((f"{name}, {force:g} N", plan))
        for rank, grasp in enumerate(plan.grasps, start=1):
            x, y, z = grasp.first_m
            angle_deg = float(np.degrees(np.arctan2(y, x)))
            rows.add(name, rank, z / container.height_m, angle_deg, grasp.score, 1e3 * grasp.deformation_m)
    out.drawn("scores", lambda path: plot_plan(path, plans))
    out.table("grasps", rows)
    for name, threshold, printed in (
        ("cleaner", 0.85, "one near the lid, one on the side"),
        ("cup-rim", 0.9, "on top"),
    ):
        heights = [h for n, h in zip(rows["object"], rows["height_share"], strict=True) if n == name]
        out.compare(f"{name}: highest grasp, share of the height", max(heights, default=0.0),
                    note=f"printed: {printed}; above {threshold} is there")  # fmt: skip
    out.compare("cup without rim, 5 N: feasible grasps", rows["object"].count("cup"),
                note="printed: a grasp there slips off (Fig. 6.12e)")  # fmt: skip
