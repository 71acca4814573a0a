"""Plans: ordered driving, pushing and exploration tasks with durations and risks; conversion to and from JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np

from ...core import InputError, from_dict

#: Kinds of tasks. ``explore`` touches an unknown object and decides; ``sideward`` displaces an object while driving
#: past it; ``turn`` rotates it by a push beside its centre; ``wait`` and ``door`` come from passages.
Kind = Literal["navigate", "push", "sideward", "turn", "explore", "wait", "door"]

#: Costs of drives are integers: smaller gaps are due to rounding.
OPTIMAL_GAP = 0.005

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Task:
    """One task for a local planner."""

    kind: Kind
    cost_s: float  #: expected duration, with the penalty for failures
    length_m: float = 0.0  #: path length of the robot
    path_m: tuple[Point, ...] = ()  #: path of the robot's centre, map frame
    object: str = ""  #: id of the object that is pushed, explored or waited for
    contact_m: Point | None = None  #: contact of the robot on the outline
    goal_m: Point | None = None  #: final position of the object's centre
    displacement_m: Point | None = None  #: motion of the object
    #: rotation of the object about its centre; the drives after an oblique push are planned without it
    turn_rad: float = 0.0
    failure_probability: float = 0.0
    #: of a push, x, y [m] and rotation [rad] of the object about its planned pose: its 90 % ellipsoid holds 90 % of the samples
    end_covariance: tuple[tuple[float, ...], ...] = ()
    sigma_s: float = 0.0  #: standard deviation of the duration, if known

    def to_json(self) -> dict[str, Any]:
        """Plain data in the documented format; fields that do not apply are omitted."""
        data: dict[str, Any] = {"kind": self.kind, "length_m": self.length_m, "cost_s": self.cost_s}
        if self.kind != "navigate":
            data["failure_probability"] = self.failure_probability
        for name in ("object", "path_m", "contact_m", "goal_m", "displacement_m", "turn_rad", "sigma_s"):
            if value := getattr(self, name):
                data[name] = value
        data = {name: _rounded(value, 6) for name, value in data.items()}
        if self.end_covariance:
            data["end_covariance"] = _rounded(self.end_covariance, 9)
        return data


@dataclass(frozen=True, slots=True)
class Plan:
    """The solution of a planning problem."""

    reachable: bool
    tasks: tuple[Task, ...] = ()
    reason: str = ""  #: why there is no plan
    proved: bool = False  #: whether "no plan" holds for every sequence of pushes of the model
    expanded: int = 0  #: configurations expanded by the search
    name: str = "cheapest"  #: side condition of the plan
    #: including the drives if an exploration finds that the object does not move
    expected_s: float | None = None
    notes: tuple[str, ...] = ()  #: e.g. objects that are never pushed, with reasons
    gap: float = 0.0  #: no plan of the model is cheaper by more than this fraction of the bound
    narrow: bool = False  #: whether the bound is that of a passage which the robot may be too wide for

    @property
    def answer(self) -> str:
        """Proved quality of the plan, or whether infeasibility is proved."""
        if not self.reachable:
            return "no plan (proved)" if self.proved else "no plan found (not proved)"
        if not np.isfinite(self.gap):
            return "no bound"
        return "optimal" if self.gap < OPTIMAL_GAP else f"within {np.ceil(100 * self.gap):.0f} %"

    @property
    def summary(self) -> str:
        """Answer, cost, length, pushes and risk in one line; without a plan, the answer and its reason."""
        if not self.reachable:
            return f"{self.answer}: {self.reason}"
        return (
            f"{self.answer}{' of the optimum' * self.answer.startswith('within')}: {self.cost_s:.1f} s, {self.length_m:.2f} m, "
            f"{len(self.pushes)} push{'' if len(self.pushes) == 1 else 'es'}, "
            f"failure probability {self.failure_probability:.2f}"
        )

    @property
    def cost_s(self) -> float:
        """Sum over the tasks; infinite without a plan."""
        # Sum of the rounded values that are written, so that a reader computes the same sum.
        return sum(round(task.cost_s, 6) for task in self.tasks) if self.reachable else float("inf")

    @property
    def length_m(self) -> float:
        """Path length of the robot [m]; infinite without a plan."""
        return sum(round(task.length_m, 6) for task in self.tasks) if self.reachable else float("inf")

    @property
    def pushes(self) -> tuple[Task, ...]:
        """The manipulation tasks."""
        return tuple(task for task in self.tasks if task.kind in ("push", "sideward", "turn"))

    @property
    def failure_probability(self) -> float:
        """Probability that at least one task fails, with independent tasks."""
        return 1.0 - math.prod(1.0 - task.failure_probability for task in self.tasks)

    def to_json(self) -> dict[str, Any]:
        """Plain data for ``json.dumps``; costs are null if there is no plan."""
        totals = ("cost_s", "length_m", "failure_probability")
        data: dict[str, Any] = {
            **{name: round(getattr(self, name), 6) if self.reachable else None for name in totals},
            **{name: getattr(self, name) for name in ("reachable", "name", "answer", "expanded")},
            "gap": round(self.gap, 6) if self.reachable and np.isfinite(self.gap) else None,
            "tasks": [task.to_json() for task in self.tasks],
        }
        if self.expected_s is not None:
            data["expected_cost_s"] = round(self.expected_s, 6) if np.isfinite(self.expected_s) else None
        if not self.reachable:
            data |= {"reason": self.reason, "proved": self.proved}
        if self.notes:
            data["notes"] = list(self.notes)
        return data


def plan_from_json(data: Mapping[str, Any], *, where: str = "plan") -> Plan:
    """Read a plan written by :meth:`Plan.to_json`.

    Parameters
    ----------
    data
        Plain data, as ``json.load`` returns them.
    where
        Name of the source, for error messages.

    Raises
    ------
    InputError
        A field is missing or of the wrong type.
    """
    if not isinstance(data, Mapping) or not isinstance(listed := data.get("tasks"), list):
        raise InputError(where, "is missing", field="tasks")
    tasks = [_known(Task, entry) for entry in listed]
    plan = from_dict(Plan, {**_known(Plan, data), "tasks": tasks, "gap": data.get("gap") or 0.0}, where=where)
    expected_s = data.get("expected_cost_s", plan.expected_s)
    return replace(
        plan,
        gap=float("inf") if data.get("gap") is None else plan.gap,
        expected_s=float("inf") if "expected_cost_s" in data and expected_s is None else expected_s,
    )


def _known(kind: type, data: Any) -> Any:
    """The entries that correspond to fields of a record; sums and answers are derived from them."""
    names = {one.name for one in fields(kind)}
    return {name: data[name] for name in data if name in names} if isinstance(data, Mapping) else data


def _rounded(value: Any, digits: int) -> Any:
    if isinstance(value, tuple):
        return [_rounded(one, digits) for one in value]
    return round(value, digits) if isinstance(value, float) else value
