"""Which plan a travel takes: the one that keeps most room, a push that turns something, or none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ....navigation.planning.off_centre_push import OffCentrePush, plan_off_centre_pushes
from ....navigation.problem.path_plan import Plan
from ....navigation.problem.planning_problem import PlanningProblem
from .travel_memory import TravelMemory
from .travel_types import TravelSettings

__all__ = ["TravelPlans"]


@dataclass(slots=True, eq=False)
class TravelPlans:
    """Asks the planner with one margin after the other, and keeps in mind what became of them."""

    memory: TravelMemory
    settings: TravelSettings
    planner: Callable[[PlanningProblem], Plan]
    note: Callable[..., None]  #: takes an event and its values
    asked: int = 0  #: how often the planner was
    turns: int = 0  #: pushes beside the centre of an object
    without_plan: set[tuple[float, float]] = field(default_factory=set)  #: margins, since anything has moved
    bumps: dict[float, int] = field(default_factory=dict)  #: into known walls, by margin

    def with_room(
        self, pose_m: Float[np.ndarray, "3"]
    ) -> tuple[tuple[float, PlanningProblem, Plan] | None, Plan]:
        """The plan that keeps most room, with its margin and problem; and the last answer.

        Parameters
        ----------
        pose_m
            Of the robot: x, y [m], heading [rad].
        """
        margins = self.settings.margins_m
        # While everything stands where it stood, what had no plan has none, from a few steps on either.
        wanted = [pair for pair in margins if self._trusted(pair[0]) and pair not in self.without_plan]
        first, *rest = wanted or margins[:1]
        best = None
        # What has no plan with the least room has none with more: ask for that before those between.
        for pair in (first, *rest[-1:], *rest[:-1]):
            found, problem = self._asked(pose_m, pair)
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

    def turning(self, pose_m: Float[np.ndarray, "3"]) -> tuple[float, PlanningProblem, OffCentrePush] | None:
        """A push that turns an object, where there is no plan of straight ones; with its margin and problem.

        Parameters
        ----------
        pose_m
            Of the robot: x, y [m], heading [rad].
        """
        if self.turns >= self.settings.turns:
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
        """A drive with a margin led into a wall that is known.

        Parameters
        ----------
        margin_m
            Of the plan that was driven [m].
        """
        self.bumps[margin_m] = self.bumps.get(margin_m, 0) + 1

    def changed(self) -> None:
        """Something has moved or was learnt: ask for everything again."""
        self.without_plan.clear()

    def reset_failures(self) -> bool:
        """Give objects and margins another chance; whether there are any."""
        found = self.memory.reset_failures() or bool(self.bumps)
        self.bumps.clear()
        self.without_plan.clear()
        return found

    def _asked(
        self, pose_m: Float[np.ndarray, "3"], margins_m: tuple[float, float]
    ) -> tuple[Plan, PlanningProblem]:
        margin_m, push_margin_m = margins_m
        problem = self.memory.problem(pose_m, margin_m, push_margin_m=push_margin_m)
        found = self.planner(problem)
        self.asked += 1
        self.note(
            "planned", margin_m=margin_m, push_margin_m=push_margin_m, reachable=found.reachable,
            cost_s=found.cost_s if found.reachable else None, reason=found.reason,
            tasks=[f"{task.kind} {task.object}".strip() for task in found.tasks],
        )  # fmt: skip
        return found, problem

    def _trusted(self, margin_m: float) -> bool:
        """Whether plans with a margin have not led into walls too often."""
        return all(margin_m > m or count < self.settings.bumps for m, count in self.bumps.items())
