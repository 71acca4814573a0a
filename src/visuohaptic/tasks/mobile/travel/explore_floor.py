"""Learn a floor within a time: drive an exploration tour, tag the objects, and plan again (Alt 2016, Sec. 4.2)."""

from __future__ import annotations

from dataclasses import replace

from ....core.ranges import POSITIVE, check_numbers
from ....navigation.planning.exploration.tour_planner import Tour, exploration_tour
from ....navigation.planning.policies import make_plan
from ....navigation.problem.path_plan import Plan
from ....navigation.problem.planning_problem import PlanningProblem
from ....navigation.problem.push_costs import PushCosts
from .travel_task import TravelTask
from .travel_types import TravelOutcome, TravelSettings


class FloorExploration(TravelTask):
    """The tour with the greatest expected benefit in the remaining time, planned again after each exploration.

    It ends at the goal, or where nothing is left that is worth the time; the result is in the tags of ``Travel.problem``.
    :func:`~visuohaptic.tasks.mobile.travel.navigate.drive_task` runs it.

    Parameters
    ----------
    problem
        Map, objects, robot and, with ``to_goal``, the goal; objects without a tag are unknown.
    budget_s
        Time for the tour [s].
    settings
        Margins, limits and tolerances.
    costs
        Prior probability that an unknown object can be pushed, and the duration of an exploration.
    to_goal
        Whether the tour ends at the goal in time.
    without_passage_sensors
        Whether there are no sensors for open passages.

    Raises
    ------
    InputError
        The budget is not positive and finite, or the robot has a footprint.
    """

    task = "explore floor"

    def __init__(
        self,
        problem: PlanningProblem,
        budget_s: float,
        settings: TravelSettings | None = None,
        costs: PushCosts | None = None,
        *,
        to_goal: bool = False,
        without_passage_sensors: bool = False,
    ) -> None:
        problem.robot.check_disc("tours are driven")
        check_numbers("FloorExploration", POSITIVE, budget_s=budget_s)
        self.budget_s, self.costs, self.to_goal = budget_s, costs, to_goal
        self.tours: list[Tour] = []  #: all that were planned, in order
        # Nothing is pushed out of the way but what was touched.
        settings = replace(settings or TravelSettings(), turns=0)
        super().__init__(problem, settings, self._tour, without_passage_sensors=without_passage_sensors)

    def _tour(self, problem: PlanningProblem) -> Plan:
        """The tour in the remaining time; without one, the plan to the goal, if it ends there."""
        left_s = self.budget_s - self.motion.elapsed_s()
        if left_s > 0:
            self.tours.append(exploration_tour(problem, left_s, self.costs, to_goal=self.to_goal))
            if self.tours[-1].steps:
                return self.tours[-1].plan
        if self.to_goal:
            return make_plan(problem, self.costs)
        return Plan(False, reason="nothing more is worth exploring" if left_s > 0 else "the time is over")

    def _finish(self, outcome: TravelOutcome, reason: str) -> None:
        if outcome is TravelOutcome.NO_PLAN and not self.to_goal:
            outcome = TravelOutcome.EXPLORED
        super()._finish(outcome, reason)
