"""Lengths of the pushes of a plan, refined continuously: coordinate descent on the cost of the whole plan on the map.

The search tries lengths on a ladder. Which bodies are pushed, from where and in which order stays as it was found;
every candidate is replayed: pushes free of collisions, drives that the map has.
"""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Float

from .drives import changed_drives_cost
from .push_heuristic import PushHeuristic
from .push_risk import replanning_units
from .push_states import Deadline, PushStep, SearchResult, needed_clearance
from .search_domain import SearchDomain

__all__ = ["SWEEP_STEP", "free_length", "push_step", "refine_lengths", "stand_is_free"]

#: A push is followed in steps of this [cells].
SWEEP_STEP = 0.5
#: Steps of the descent [m]: the ladder's, which is doubled while it helps, and what a robot can execute.
STEPS_M = (0.05, 0.0125)


def refine_lengths(
    heuristic: PushHeuristic, start: Float[np.ndarray, "2"], plan: SearchResult, deadline: Deadline
) -> tuple[tuple[PushStep, ...], float]:
    """Pushes of a plan with the lengths of least expected cost, and what they and the drives cost [cells at full speed].

    Expected is what has to be pushed again where a push ends in the way of a later drive.

    Parameters
    ----------
    heuristic
        Of the search, for its domain, goal and costs of pushes.
    start
        Where the robot begins [cells].
    plan
        What was found.
    deadline
        When to stop.
    """
    domain, goal, scale = heuristic.domain, heuristic.goal, heuristic.domain.block / heuristic.units
    steps, cost = plan.steps, plan.cost
    risk = replanning_units(heuristic, steps, start) * scale
    # Shorter pushes first: what a longer one adds is rarely worth the drive that it saves.
    for step_m, index, sign in itertools.product(STEPS_M, range(len(steps)), (-1.0, 1.0)):
        first = longer = sign * step_m / domain.map.resolution_m
        while not deadline.passed:
            tried = _replayed(heuristic, steps, index, steps[index].length + longer)
            pushes = heuristic.pushes_units(tried) * scale
            tried_cost = float("inf")
            if tried:
                most = cost + risk - pushes
                tried_cost = pushes + changed_drives_cost(domain, steps, tried, start, goal, most)
            tried_risk = 0.0
            if tried_cost < cost + risk:
                tried_risk = replanning_units(heuristic, tried, start) * scale
            if tried_cost + tried_risk < cost + risk:
                steps, cost, risk, longer = tried, tried_cost, tried_risk, 2.0 * longer
            elif longer != first:
                longer = first
            else:
                break
    return steps, cost


def _replayed(
    heuristic: PushHeuristic, steps: tuple[PushStep, ...], changed: int, length: float
) -> tuple[PushStep, ...]:
    """The same pushes, one of them of another length; none where that or a later one is not free."""
    done = list(steps[:changed])
    shifts = steps[changed].shifts_before
    for index, step in enumerate(steps[changed:], start=changed):
        length = length if index == changed else step.length
        again = push_step(heuristic, shifts, step.body, step.contact, length)
        if (
            not 0.0 < length <= heuristic.longest(step.body)
            or not stand_is_free(heuristic, again)
            or free_length(heuristic, again, length) < length - 1e-6
        ):
            return ()
        done.append(again)
        shifts = again.shifts_after
    return tuple(done)


def push_step(
    heuristic: PushHeuristic, shifts: Float[np.ndarray, "bodies 2"], body: int, contact: int, length: float
) -> PushStep:
    """A push of some length from a configuration.

    Parameters
    ----------
    heuristic
        Of the search.
    shifts
        Of the bodies from where the map has them [cells].
    body, contact
        Index of the body, and of its contact.
    length
        Of the push [cells].
    """
    push = heuristic.contacts(body)[contact]
    after = shifts.copy()
    after[body] = shifts[body] + length * push.direction
    touch = heuristic.domain.bodies[body].centre + shifts[body] + push.robot
    approach = touch - heuristic.stand_off * push.direction
    return PushStep(body, contact, length, shifts, after, approach, touch, approach + length * push.direction)


def stand_is_free(heuristic: PushHeuristic, step: PushStep) -> bool:
    """Whether the robot gets from where it stands off the body to the contact, beside everything else.

    Parameters
    ----------
    heuristic
        Of the search.
    step
        The push.
    """
    others = np.arange(len(step.shifts_before)) != step.body
    return bool(
        heuristic.domain.clear_straight(step.shifts_before, step.approach, step.touch[None], others)[0]
    )


def free_length(heuristic: PushHeuristic, step: PushStep, limit: float) -> float:
    """How far a push is free of collisions [cells].

    Parameters
    ----------
    heuristic
        Of the search.
    step
        The push, of any length.
    limit
        As far as it is looked at [cells].
    """
    from ._push_search_kernels import free_push_length

    domain: SearchDomain = heuristic.domain
    body, shift = domain.bodies[step.body], step.shifts_before[step.body]
    direction = heuristic.contacts(step.body)[step.contact].direction
    outlines, starts = domain.obstacle_outlines(step.shifts_before, step.body)
    found: float = free_push_length(
        domain.occupied, domain.clearance, body.samples + shift, body.around + shift, body.outline + shift,
        outlines, starts, *step.touch, *direction, needed_clearance(body.radius, SWEEP_STEP), limit,
    )  # fmt: skip
    return found
