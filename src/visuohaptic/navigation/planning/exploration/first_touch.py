"""The first touch of an object: the contact that is reached at the lowest cost, and the task that explores there."""

from __future__ import annotations

import numpy as np

from ...problem import Task, failure_probability
from ...pushing.contact_candidates import PushContact
from ..arrays import Path
from ..search.bodies import Body
from ..search.drives import pull_string
from ..search.search_domain import SearchDomain, world_from_grid


def nearest_contact(domain: SearchDomain, body: Body) -> tuple[Path, float, PushContact] | None:
    """The contact of a body with the cheapest drive to its approach pose, without pushing.

    Parameters
    ----------
    domain
        Start, map, robot and bodies at their mapped positions.
    body
        The body to touch.

    Returns
    -------
    The drive in grid coordinates, its cost [cells at full speed] and the contact; ``None`` if none can be reached.
    """
    shifts = np.zeros((len(domain.bodies), 2))
    stand_off = domain.robot.stand_off_m / domain.map.resolution_m
    drives = []
    for contact in body.contacts:
        path, cost = pull_string(
            domain, shifts, domain.start, body.centre + contact.robot - stand_off * contact.direction
        )
        if len(path):
            drives.append((path, cost, contact))
    return min(drives, key=lambda drive: drive[1], default=None)


def explore_task(domain: SearchDomain, body: Body, contact: PushContact) -> Task:
    """The task that touches a body at a contact and decides whether it moves.

    Parameters
    ----------
    domain
        Map, robot, duration of an exploration and the prior of an unknown object.
    body, contact
        What is touched, and where.
    """
    x, y = world_from_grid(domain.map, body.centre + contact.contact)
    return Task(
        "explore",
        domain.costs.explore_time_s,
        object=body.obj.id,
        contact_m=(float(x), float(y)),
        failure_probability=failure_probability(body.obj.tag, 0.0, domain.robot, domain.costs),
    )
