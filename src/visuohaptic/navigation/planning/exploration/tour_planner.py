"""Learn a floor within a time budget: a tour over the unknown objects that are worth touching (Alt 2016, Sec. 4.2.1, 4.4).

The dissertation explores objects one by one, by proximity and by the benefit of Eq. (4.2). Here both are one problem: the
tour with the greatest expected benefit of those that end within the budget.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from ....core import POSITIVE, HapticTag, check_numbers
from ...graph import assign_regions, build_graph
from ...grid.cost_grid import SpeedLimits, grid_layers
from ...problem import Plan, PlanningProblem, PushCosts, Task, failure_probability
from ...problem.node_types import nodes_of, push_node
from ...pushing.contact_candidates import PushContact
from ..arrays import Path
from ..drive_tasks import drive_tasks
from ..joint_builder import extend_graph
from ..search.bodies import Body
from ..search.domain_builder import build_search_domain
from ..search.drives import pull_string
from ..search.search_domain import SearchDomain, world_from_grid
from .benefit_by_set import ExpectedBenefit, expected_benefit
from .orienteering import EXACT_OBJECTS, Orienteering, best_order, upper_bound

#: Tag with which the cost of a push is computed if an unknown object turns out to be movable.
MOVES = HapticTag(fixed=False, explored=1)
#: Units of the search per second, and per opening.
_US, _OPENINGS = 1e6, 1e9


@dataclass(frozen=True, slots=True)
class TourStep:
    """One exploration of a tour."""

    object: str  #: id of the object
    opens: float  #: probability that it connects parts of the floor that were separate
    benefit_s: float  #: expected reduction of path costs, Eq. (4.2), after the steps before [s]
    time_s: float  #: to drive there and to explore [s]


@dataclass(frozen=True, slots=True)
class Tour:
    """The explorations that are worth their time, in order."""

    steps: tuple[TourStep, ...]
    tasks: tuple[Task, ...]  #: drives and explorations in order, and the drive to the goal
    budget_s: float  #: limit of the duration [s]
    #: no tour within the budget has more expected openings, or a greater benefit [s]
    bound: tuple[float, float]
    left_out: dict[str, str] = field(default_factory=dict)  #: reasons by the ids of the other unknown objects
    notes: tuple[str, ...] = ()  #: approximations that apply

    @property
    def benefit_s(self) -> float:
        """Expected reduction of path costs by all steps [s]; openings are counted apart."""
        return sum(step.benefit_s for step in self.steps)

    @property
    def opens(self) -> float:
        """Expected number of objects that connect separate parts of the floor."""
        return sum(step.opens for step in self.steps)

    @property
    def time_s(self) -> float:
        """Duration of all tasks [s]."""
        return sum(round(task.cost_s, 6) for task in self.tasks)

    @property
    def plan(self) -> Plan:
        """The tasks as a plan, for plots and for the local planners."""
        return Plan(True, self.tasks, name="exploration", gap=math.inf, notes=self.notes)

    @property
    def summary(self) -> str:
        """Number of steps, duration and benefit in one line."""
        if not self.steps:
            return "nothing to explore"
        return (
            f"{len(self.steps)} of {len(self.steps) + len(self.left_out)} unknown objects in {self.time_s:.1f} of "
            f"{self.budget_s:g} s: {self.opens:.2f} passages opened and {self.benefit_s:.1f} s saved (expected)"
        )

    def to_json(self) -> dict[str, Any]:
        """Plain data for ``json.dumps``."""
        return {
            **{name: round(getattr(self, name), 6) for name in ("time_s", "budget_s", "opens", "benefit_s")},
            "bound": {"opens": round(self.bound[0], 6), "benefit_s": round(self.bound[1], 6)},
            "steps": [
                {name: value if isinstance(value, str) else round(value, 6) for name, value in one.items()}
                for one in map(asdict, self.steps)
            ],
            "left_out": dict(self.left_out),
            "notes": list(self.notes),
            "tasks": [task.to_json() for task in self.tasks],
        }


def exploration_tour(
    problem: PlanningProblem, budget_s: float, costs: PushCosts | None = None, *, to_goal: bool = False
) -> Tour:
    """The tour over unknown objects with the greatest expected benefit within a time budget.

    An object counts if it connects separate parts of the floor, else with the expected reduction of path costs by its
    manipulation node: see :func:`~visuohaptic.navigation.planning.exploration.benefit_by_set.expected_benefit`.
    Openings come first. Each object is touched at the contact nearest to the start. The tour is planned as if no object
    moved: after an exploration, add the tag, and plan again with the remaining budget.

    Up to 12 objects all orders are covered. Beyond, benefits are those of each object alone, and not every order is tried;
    ``bound`` limits what is missed.

    Parameters
    ----------
    problem
        Map, objects, robot and start; objects without a tag are unknown.
    budget_s
        Maximum duration of the tour [s].
    costs
        Prior probability that an unknown object can be pushed, and the duration of an exploration.
    to_goal
        Whether the tour ends at the goal; otherwise, at its last object.

    Raises
    ------
    InputError
        The budget is not positive and finite.
    """
    problem.robot.check_disc("tours are planned")
    check_numbers("exploration_tour", POSITIVE, budget_s=budget_s)
    if all(item.tag is not None for item in problem.objects):
        return Tour((), (), budget_s, (0.0, 0.0))
    domain = build_search_domain(problem, costs)
    ways = _Ways(domain, to_goal)
    ids = tuple(ways.touch)
    by_set = len(ids) <= EXACT_OBJECTS
    benefit = _benefit(domain, ids, by_set)
    values = np.stack([benefit.opens * _OPENINGS, benefit.saved_s * _US], axis=2)
    search = Orienteering(*ways.times(), int(budget_s * _US), np.rint(values).astype(np.int64))
    order = best_order(search)
    steps, tasks, at, visited = [], [], 0, 0
    for index in order:
        opens, saved = search.value(visited, index)
        time_s = float(search.visit_us[at, index]) / _US
        steps.append(TourStep(ids[index], opens / _OPENINGS, saved / _US, time_s))
        tasks += [*ways.drive(at, index + 1), ways.touch[ids[index]]]
        at, visited = index + 1, visited | 1 << index
    if to_goal and order:
        tasks += ways.drive(at, len(ids) + 1)
    found = search.tour(order)
    opens, saved = (found[0] if found else (0, 0)) if by_set else upper_bound(search)
    rest = {id: _why_not(search, index) for index, id in enumerate(ids) if index not in order}
    notes = () if by_set else (f"more than {EXACT_OBJECTS} objects: benefits are those of each alone",)
    return Tour(
        tuple(steps), tuple(tasks), budget_s, (opens / _OPENINGS, saved / _US), ways.unreachable | rest, notes
    )


def _why_not(search: Orienteering, index: int) -> str:
    """Why an object that can be touched is not explored."""
    if not search.values[:, index].any():
        return "opens no shorter way"
    if search.finish_us[index + 1] < 0:
        return "the goal cannot be reached from there without pushing"
    alone_us = int(search.visit_us[0, index] + search.finish_us[index + 1])
    if alone_us > search.budget_us:
        return f"takes {alone_us / _US:.1f} s by itself"
    return "other objects gain more within the budget"


def _benefit(domain: SearchDomain, ids: tuple[str, ...], by_set: bool) -> ExpectedBenefit:
    """Expected benefits on the joint graph of the problem's map."""
    if not ids:
        return ExpectedBenefit(np.zeros((1, 0)), np.zeros((1, 0)))
    problem, robot, costs = domain.problem, domain.robot, domain.costs
    layers = grid_layers(problem.map, SpeedLimits(robot.radius_m, robot.v_max_m_s, robot.v_min_m_s))
    graph = build_graph(layers)
    known = [item for item in problem.objects if item.tag is not None]
    assumed = (replace(item, tag=MOVES) for item in problem.objects if item.id in ids)
    nodes = nodes_of(known, problem.passages, robot) + [push_node(o, robot, costs=costs) for o in assumed]
    joint = extend_graph(graph, assign_regions(layers, graph), robot, nodes)
    return expected_benefit(joint, ids, costs.unknown_movable, by_set=by_set)


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


class _Ways:
    """Drives between the start, the approach poses and the goal, with no object moved."""

    def __init__(self, domain: SearchDomain, to_goal: bool) -> None:
        self.domain = domain
        self.still = np.zeros((len(self.domain.bodies), 2))
        self.touch: dict[str, Task] = {}
        self.unreachable: dict[str, str] = {}
        self.to_goal = to_goal
        self.places = [domain.start]
        for body in (body for body in domain.bodies if body.allowed.unknown):
            reached = nearest_contact(domain, body)
            if reached is None:
                self.unreachable[body.obj.id] = "cannot be touched from where the robot gets without pushing"
                continue
            path, _, contact = reached
            x, y = world_from_grid(domain.map, body.centre + contact.contact)
            risk = failure_probability(body.obj.tag, 0.0, domain.robot, domain.costs)
            self.touch[body.obj.id] = Task(
                "explore", domain.costs.explore_time_s, object=body.obj.id, contact_m=(float(x), float(y)),
                failure_probability=risk,
            )  # fmt: skip
            self.places.append(path[-1])
        if to_goal:
            self.places.append(domain.goal)
        self._drives: dict[tuple[int, int], tuple[Task, ...] | None] = {}

    def drive(self, begin: int, end: int) -> tuple[Task, ...]:
        """Tasks of the drive between two places by their indices; start, objects, goal."""
        return self._drive(begin, end) or ()

    def times(self) -> tuple[np.ndarray, np.ndarray]:
        """Times of drive and exploration to each object, and from each place to the end of the tour [us]."""
        count = len(self.touch)
        every = np.array([[self._drive_us(a, b + 1) for b in range(count)] for a in range(count + 1)])
        every = every.reshape(count + 1, count).astype(np.int64)
        explore_us = np.array([round(task.cost_s * _US) for task in self.touch.values()], np.int64)
        visit_us = np.where(every < 0, -1, every + explore_us)
        home = [self._drive_us(a, count + 1) if self.to_goal else 0 for a in range(count + 1)]
        return visit_us, np.array(home, np.int64)

    def _drive_us(self, begin: int, end: int) -> int:
        tasks = self._drive(begin, end)
        return -1 if tasks is None else sum(round(task.cost_s * _US) for task in tasks)

    def _drive(self, begin: int, end: int) -> tuple[Task, ...] | None:
        """Computed once for both directions; ``None`` without a way."""
        if (begin, end) not in self._drives:
            low, high = min(begin, end), max(begin, end)
            path, cost = pull_string(self.domain, self.still, self.places[low], self.places[high])
            ways = [tuple(drive_tasks(self.domain, self.still, way, cost)) for way in (path, path[::-1])]
            self._drives[low, high], self._drives[high, low] = ways if len(path) else (None, None)
        return self._drives[begin, end]
