"""Exploring an object on the way: drive to a contact, touch, decide, drive on (Alt 2016, Sec. 4.4)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..problem.path_plan import Plan, Task
from ..problem.planning_problem import MovableObject, PlanningProblem
from ..problem.push_costs import PushCosts, failure_probability
from .planner import plan_world, pull_string
from .push_search import STAND_OFF
from .push_states import SearchLimits
from .search_domain import grid_from_world, push_world, world_from_grid

__all__ = ["via_exploration"]


def via_exploration(
    problem: PlanningProblem,
    item: MovableObject,
    costs: PushCosts | None = None,
    limits: SearchLimits | None = None,
) -> Plan:
    """A plan to the goal that touches one object on its way, without relying on what is found.

    The contact is the one that is reached cheapest without pushing anything.
    """
    costs = costs or PushCosts()
    world = push_world(problem, costs)
    index = next((k for k, body in enumerate(world.bodies) if body.item.id == item.id), None)
    refused = Plan(False, reason=f"{item.id} cannot be touched from where the robot gets")
    if index is None:
        return refused
    body = world.bodies[index]
    clearance = world.clearance_with(np.zeros((len(world.bodies), 2)))
    start = grid_from_world(problem.map, problem.start_m)
    ways = []
    for contact in body.contacts:
        stand = body.centre + contact.robot - STAND_OFF * contact.direction
        path, cost = pull_string(world, clearance, start, stand)
        if len(path):
            ways.append((cost, path, contact))
    if not ways:
        return refused
    cost, path, contact = min(ways, key=lambda way: way[0])
    path_m = world_from_grid(problem.map, path)
    contact_m = world_from_grid(problem.map, body.centre + contact.contact)
    drive = Task(
        "navigate",
        world.seconds(cost),
        float(np.hypot(*np.diff(path_m, axis=0).T).sum()),
        tuple((float(x), float(y)) for x, y in path_m),
    )
    touch = Task(
        "explore",
        costs.explore_time_s,
        object=item.id,
        contact_m=(float(contact_m[0]), float(contact_m[1])),
        failure_probability=failure_probability(item.tag, 0.0, problem.robot, costs),
    )
    onward = replace(problem, start_m=path_m[-1])
    rest = plan_world(onward, push_world(onward, costs, unknown=False), costs, limits)
    if not rest.reachable:
        return replace(rest, tasks=())
    return replace(rest, tasks=(*((drive,) if len(path) > 1 else ()), touch, *rest.tasks))
