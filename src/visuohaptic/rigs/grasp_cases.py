"""What Alt 2016, Sec. 6.4.2 says of single grasps, as cases that can be checked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..grasping.planner import GraspPlan

__all__ = ["CASES", "Case", "best_vertex"]


@dataclass(frozen=True)
class Case:
    """One sentence of the text."""

    name: str
    thing: str
    force_N: float
    low: float  #: the place's height, as a fraction of the object's
    high: float
    side: str  #: "x", "y": narrow or flat side; "" is any
    good: bool


CASES = (
    Case("cleaner near its lid", "cleaner", 20.0, 0.85, 1.0, "", True),
    Case("cleaner on its side", "cleaner", 20.0, 0.45, 0.55, "x", True),
    Case("cleaner at its soft, flat centre", "cleaner", 20.0, 0.48, 0.53, "y", False),
    Case("cup-rim on top", "cup-rim", 20.0, 0.9, 1.0, "", True),
    Case("cup-rim in the centre", "cup-rim", 20.0, 0.45, 0.55, "", False),
    # The text's cup was grasped where the rim held the other one.
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
        # The middle of that side: within 5 degrees of its axis.
        angle = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 180
        away = np.minimum(angle, 180 - angle) if case.side == "x" else np.abs(angle - 90)
        there &= away < 5
    return int(np.argmax(np.where(there, plan.scores.pair, -1.0)))
