"""Selection of the plan of a navigation task: the largest feasible margin, or an off-centre push, or none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ....navigation.planning.off_centre_push import plan_off_centre_pushes
from ....navigation.problem.path_plan import Plan, Task
from ....navigation.problem.planning_problem import PlanningProblem
from .travel_memory import TravelMemory
from .travel_types import TravelSettings


@dataclass(slots=True, eq=False)
class TravelPlans:
    """Calls the planner with one margin after the other, and remembers which margins failed."""

    memory: TravelMemory
    settings: TravelSettings
    planner: Callable[[PlanningProblem], Plan]
    note: Callable[..., None]  #: logs an event and its values
    calls: int = 0  #: number of planner calls
    turns: int = 0  #: number of off-centre pushes
    #: infeasible margins, since the last change
    without_plan: set[tuple[float, float]] = field(default_factory=set)
    #: number of contacts with known walls, by margin
    max_bumps: dict[float, int] = field(default_factory=dict)

    def largest_margin(
        self, pose_m: Float[np.ndarray, "3"]
    ) -> tuple[tuple[float, PlanningProblem, Plan] | None, Plan]:
        """The feasible plan with the largest margin, with its margin and problem; and the last plan that was tried.

        Parameters
        ----------
        pose_m
            Pose of the robot: x, y [m], heading [rad].
        """
        margins = self.settings.margins_m
        # While no object has moved, margins without a plan stay infeasible, also from a slightly different pose.
        untried = [pair for pair in margins if self._trusted(pair[0]) and pair not in self.without_plan]
        first, *rest = untried or margins[:1]
        best = None
        # If the smallest margin has no plan, larger ones have none: try it before those in between.
        for pair in (first, *rest[-1:], *rest[:-1]):
            found, problem = self._planned(pose_m, pair)
            if found.reachable:
                between = best is None and pair != first and len(rest) > 1
                best = pair[0], problem, found
                if not between:
                    break
                continue
            if not found.proved:
                self.without_plan.add(pair)
            if best is None and pair != first:
                break
        return best, found

    def turning(
        self, pose_m: Float[np.ndarray, "3"]
    ) -> tuple[float, PlanningProblem, tuple[Task, ...]] | None:
        """The tasks of an off-centre push that rotates an object, if no straight push helps; with its margin and problem.

        Parameters
        ----------
        pose_m
            Pose of the robot: x, y [m], heading [rad].
        """
        if self.turns >= self.settings.turns or self.memory.problem(pose_m).robot.footprint_m:
            return None
        for margin_m in self.settings.turn_margins_m:
            if not self._trusted(margin_m):
                continue
            problem = self.memory.problem(pose_m, margin_m)
            found = plan_off_centre_pushes(problem, self.planner, margin_m=margin_m)
            self.note("planned turns", margin_m=margin_m, found=len(found))
            if found:
                self.turns += 1
                return margin_m, problem, found[0]
        return None

    def bumped(self, margin_m: float) -> None:
        """Record that a drive with a margin has hit a known wall.

        Parameters
        ----------
        margin_m
            Margin of the plan [m].
        """
        self.max_bumps[margin_m] = self.max_bumps.get(margin_m, 0) + 1

    def changed(self) -> None:
        """Reset the infeasible margins, after an object has moved or an estimate has changed."""
        self.without_plan.clear()

    def reset_failures(self) -> bool:
        """Permit failed objects and margins again; returns whether there are any."""
        found = self.memory.reset_failures() or bool(self.max_bumps)
        self.max_bumps.clear()
        self.without_plan.clear()
        return found

    def _planned(
        self, pose_m: Float[np.ndarray, "3"], margins_m: tuple[float, float]
    ) -> tuple[Plan, PlanningProblem]:
        margin_m, push_margin_m = margins_m
        problem = self.memory.problem(pose_m, margin_m, push_margin_m=push_margin_m)
        found = self.planner(problem)
        self.calls += 1
        self.note(
            "planned", margin_m=margin_m, push_margin_m=push_margin_m, reachable=found.reachable,
            cost_s=found.cost_s if found.reachable else None, reason=found.reason,
            tasks=[f"{task.kind} {task.object}".strip() for task in found.tasks],
        )  # fmt: skip
        return found, problem

    def _trusted(self, margin_m: float) -> bool:
        """Whether plans with a margin have hit walls less often than the limit."""
        return all(margin_m > m or count < self.settings.max_bumps for m, count in self.max_bumps.items())
