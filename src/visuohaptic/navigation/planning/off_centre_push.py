"""Off-centre pushes, which turn an object where no straight push through its centre clears a passage (Sec. 4.3.2).

A box that stands obliquely in a door has no face left that a straight push
could use. Pushed at its end it turns, and then either the passage is clear or a
straight push works again. The object's motion is predicted by the quasi-static
model, and each push is rated by what it leaves: a clear passage at best, a
problem that the planner can solve otherwise. Alt 2016 has sideward pushes only.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ..problem.path_plan import Plan
from ..problem.planning_problem import PlanningProblem
from ..problem.push_costs import PushCosts, failure_probability
from ..pushing.push_failure import PushUncertainty
from ..pushing.quasi_static import simulate_push
from .off_centre_rollouts import (
    BACK_OFF_M,
    Rollout,
    contacts_after,
    drive_of,
    fits,
    opens_passage,
    retreat,
    rollouts,
)
from .replanning import after_push
from .search.domain_builder import build_search_domain
from .search.drives import pull_string
from .search.search_domain import grid_from_world, world_from_grid

__all__ = ["OffCentrePush", "plan_off_centre_pushes"]


@dataclass(frozen=True, slots=True, eq=False)
class OffCentrePush:
    """A straight drive against an object that turns it; map frame."""

    object: str
    approach_m: Float[np.ndarray, "k 2"]  #: path of the robot's centre to where the push starts
    direction_rad: float
    length_m: float  #: path length of the robot from there
    free_m: float  #: ... of which so much before the contact
    displacement_m: Float[np.ndarray, "2"]  #: predicted, of the object's centroid
    turn_rad: float  #: predicted
    failure_probability: float
    cost_s: float  #: setup and drive
    opens: bool  #: whether nothing else has to be pushed after it

    @property
    def start_m(self) -> Float[np.ndarray, "2"]:
        """Approach pose: where the push starts, x, y [m]."""
        return self.approach_m[-1]

    @property
    def retreat_m(self) -> Float[np.ndarray, "2"]:
        """Retreat pose: where the robot is after it has backed off, x, y [m]."""
        ahead = np.array([math.cos(self.direction_rad), math.sin(self.direction_rad)])
        return self.start_m + max(self.length_m - BACK_OFF_M, 0.0) * ahead


def plan_off_centre_pushes(
    problem: PlanningProblem,
    planner: Callable[[PlanningProblem], Plan] | None = None,
    costs: PushCosts | None = None,
    *,
    margin_m: float = 0.0,
    samples: int = 12,
    max_plans: int = 6,
    rng: np.random.Generator | None = None,
) -> tuple[OffCentrePush, ...]:
    """Pushes that turn an object and clear a passage, the best first; empty where none was found.

    Parameters
    ----------
    problem
        Map, objects, robot, start and goal; objects that were never touched stay where they are.
    planner
        Tells whether the problem after a push can be solved, where no push clears a passage by itself.
    costs
        What may be pushed.
    margin_m
        By which the problem's robot is larger than the rim that pushes [m].
    samples
        Simulated pushes per candidate with sampled friction, centre and pose, for its probability of failure.
    max_plans
        Candidates that are simulated, at most.
    rng
        Of the simulated pushes.

    Returns
    -------
    Sorted by expected cost, cost / (1 - probability of failure); those that clear a passage come first.

    Raises
    ------
    InputError
        The margin is not less than the robot's radius.
    """
    costs = costs or PushCosts()
    rng = rng if rng is not None else np.random.default_rng(0)
    if not 0 <= margin_m < problem.robot.radius_m:
        raise InputError(
            "plan_off_centre_pushes", f"found a margin of {margin_m} m, expected 0 to the robot's radius"
        )
    domain = build_search_domain(problem, costs)
    start = grid_from_world(problem.map, problem.start_m)
    goal = grid_from_world(problem.map, problem.goal_m)
    ends = rollouts(domain, start, goal, margin_m)
    opening = [rollout for rollout in ends if opens_passage(rollout, rollout.pose)]
    if opening:
        chosen = _diverse(sorted(opening, key=_seconds), max_plans)
    elif planner is not None:
        ranked = sorted(ends, key=lambda rollout: (-contacts_after(rollout), _seconds(rollout)))
        chosen = [
            rollout for rollout in _diverse(ranked, max_plans) if _solved_after(problem, rollout, planner)
        ]
    else:
        chosen = []
    plans = [_evaluated(problem, rollout, samples, rng, costs, opens=bool(opening)) for rollout in chosen]
    pushes = [push for push in plans if len(push.approach_m)]
    return tuple(sorted(pushes, key=lambda push: push.cost_s / max(1.0 - push.failure_probability, 1e-3)))


def _solved_after(
    problem: PlanningProblem, rollout: Rollout, planner: Callable[[PlanningProblem], Plan]
) -> bool:
    moved_m, _ = _predicted(rollout)
    after = after_push(
        problem,
        rollout.scene.body.obj.id,
        moved_m,
        world_from_grid(problem.map, retreat(rollout)),
        turn_rad=float(rollout.pose[2]),
    )
    return planner(after).reachable


def _predicted(rollout: Rollout) -> tuple[Float[np.ndarray, "2"], float]:
    """Displacement of the body's centroid in the map frame [m], and the direction of the drive there [rad]."""
    yaw = rollout.scene.domain.map.origin[2]
    c, s = math.cos(yaw), math.sin(yaw)
    turned = np.array([[c, s], [-s, c]])
    ahead = rollout.direction @ turned
    return rollout.pose[:2] @ turned, math.atan2(ahead[1], ahead[0])


def _evaluated(
    problem: PlanningProblem,
    rollout: Rollout,
    samples: int,
    rng: np.random.Generator,
    costs: PushCosts,
    *,
    opens: bool,
) -> OffCentrePush:
    robot, domain = problem.robot, rollout.scene.domain
    moved_m, direction_rad = _predicted(rollout)
    path, _ = pull_string(
        domain,
        np.zeros((len(domain.bodies), 2)),
        grid_from_world(problem.map, problem.start_m),
        rollout.approach_at,
    )
    tag = rollout.scene.body.obj.tag
    # Drift and turn of straight pushes say nothing here: the counters and the force do.
    holds = 1.0 - failure_probability(tag, 0.0, robot, costs)
    holds *= 1.0 - _missed(rollout, samples, rng, opens=opens)
    return OffCentrePush(
        rollout.scene.body.obj.id,
        world_from_grid(problem.map, path),
        direction_rad,
        rollout.length_m,
        rollout.scene.stand_off * problem.map.resolution_m,
        moved_m,
        float(rollout.pose[2]),
        1.0 - holds,
        robot.setup_time_s + _seconds(rollout),
        opens,
    )


def _missed(rollout: Rollout, samples: int, rng: np.random.Generator, *, opens: bool) -> float:
    """Fraction of simulated pushes that hit something or do not leave what they should."""
    path = drive_of(rollout.scene, rollout.direction, rollout.approach_at, rollout.length_m)
    failed = 0
    for _ in range(samples):
        model, place = PushUncertainty().sample(rollout.scene.model, (0.0, 0.0, 0.0), rng)
        try:
            trace = simulate_push(model, place, path, rollout.scene.radius_m)
        except InputError:
            continue  # sampled into the platform: no information
        pose = trace.object_m[-1]
        error_m = float(np.hypot(*(pose[:2] - rollout.pose[:2])))
        ok = bool(fits(rollout.scene, trace.object_m).all())
        ok = ok and (
            opens_passage(rollout, pose) if opens else error_m < 0.05 and abs(pose[2] - rollout.pose[2]) < 0.3
        )
        failed += not ok
    return failed / max(samples, 1)


def _seconds(rollout: Rollout) -> float:
    return rollout.approach_s + rollout.length_m / rollout.scene.domain.robot.v_push_m_s


def _diverse(ends: list[Rollout], max_plans: int) -> list[Rollout]:
    """The first ones that differ in object, place or turn."""
    kept: list[Rollout] = []
    for rollout in ends:
        if len(kept) == max_plans:
            break
        if all(
            rollout.scene is not other.scene
            or np.hypot(*(rollout.pose[:2] - other.pose[:2])) > 0.08
            or abs(rollout.pose[2] - other.pose[2]) > 0.25
            for other in kept
        ):
            kept.append(rollout)
    return kept
