"""Exploring an object in passing: drive to a contact, touch, decide, drive on (Alt 2016, Sec. 4.4)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..problem.path_plan import Plan, Task
from ..problem.planning_problem import MovableObject, PlanningProblem
from ..problem.push_costs import PushCosts, failure_probability
from .planner import plan_in_domain
from .search.domain_builder import build_search_domain
from .search.drives import pull_string
from .search.push_heuristic import STAND_OFF_M
from .search.push_states import SearchLimits
from .search.search_domain import grid_from_world, world_from_grid

__all__ = ["via_exploration"]


def via_exploration(
    problem: PlanningProblem,
    obj: MovableObject,
    costs: PushCosts | None = None,
    limits: SearchLimits | None = None,
) -> Plan:
    """A plan to the goal that touches one object in passing, without relying on what is found.

    The contact is the one that is reached at the lowest cost without pushing anything.

    Parameters
    ----------
    problem
        Map, objects, robot, start and goal.
    obj
        The object to touch.
    costs
        What a push costs.
    limits
        How long to search.
    """
    costs = costs or PushCosts()
    domain = build_search_domain(problem, costs)
    index = next((k for k, body in enumerate(domain.bodies) if body.obj.id == obj.id), None)
    refused = Plan(False, reason=f"{obj.id} cannot be touched from where the robot gets")
    if index is None:
        return refused
    body = domain.bodies[index]
    shifts = np.zeros((len(domain.bodies), 2))
    stand_off = STAND_OFF_M / problem.map.resolution_m
    start = grid_from_world(problem.map, problem.start_m)
    paths = []
    for contact in body.contacts:
        approach = body.centre + contact.robot - stand_off * contact.direction
        path, cost = pull_string(domain, shifts, start, approach)
        if len(path):
            paths.append((cost, path, contact))
    if not paths:
        return refused
    cost, path, contact = min(paths, key=lambda one: one[0])
    path_m = world_from_grid(problem.map, path)
    contact_m = world_from_grid(problem.map, body.centre + contact.contact)
    drive = Task(
        "navigate",
        domain.seconds(cost),
        float(np.hypot(*np.diff(path_m, axis=0).T).sum()),
        tuple((float(x), float(y)) for x, y in path_m),
    )
    touch = Task(
        "explore",
        costs.explore_time_s,
        object=obj.id,
        contact_m=(float(contact_m[0]), float(contact_m[1])),
        failure_probability=failure_probability(obj.tag, 0.0, problem.robot, costs),
    )
    onward = replace(problem, start_m=path_m[-1])
    known = [k for k, other in enumerate(domain.bodies) if not other.allowed.unknown]
    rest = plan_in_domain(onward, domain, costs, limits, active=known)
    if not rest.reachable:
        return replace(rest, tasks=())
    return replace(rest, tasks=(*((drive,) if len(path) > 1 else ()), touch, *rest.tasks))
