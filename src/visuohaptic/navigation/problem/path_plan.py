"""Plans: what to drive, push and explore, in order, with seconds and risks; to and from JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...core.errors import InputError

__all__ = ["Plan", "Task", "plan_from_json"]

#: Kinds of tasks. ``explore`` touches an unknown object and decides; ``sideward`` drives past an object and brushes
#: it aside; ``wait`` and ``door`` come from passages.
KINDS = ("navigate", "push", "sideward", "explore", "wait", "door")

#: Costs of drives are whole units: a gap below this is rounding.
OPTIMAL_GAP = 0.005

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Task:
    """One task for a local planner."""

    kind: str
    cost_s: float  #: expected duration, with the penalty for failures
    length_m: float = 0.0  #: path length of the robot
    path_m: tuple[Point, ...] = ()  #: path of the robot's centre, map frame
    object: str = ""  #: id of what is pushed, explored or waited for
    contact_m: Point | None = None  #: where the robot touches the outline
    goal_m: Point | None = None  #: where the centre of the object goes
    displacement_m: Point | None = None  #: motion of the object
    turn_rad: float = 0.0  #: of the object, about its centre
    failure_probability: float = 0.0
    #: of a push, x, y [m] and turn [rad] of the object about its planned end: its 90 % ellipsoid holds 90 % of the ends
    end_covariance: tuple[tuple[float, ...], ...] = ()
    sigma_s: float = 0.0  #: standard deviation of the duration, where it is known

    def to_json(self) -> dict[str, Any]:
        """As in the contract; what does not apply is left out."""
        data: dict[str, Any] = {"kind": self.kind}
        if self.object:
            data["object"] = self.object
        if self.path_m:
            data["path_m"] = [_rounded(point) for point in self.path_m]
        for name in ("contact_m", "goal_m", "displacement_m"):
            if (value := getattr(self, name)) is not None:
                data[name] = _rounded(value)
        if self.turn_rad:
            data["turn_rad"] = round(self.turn_rad, 6)
        data["length_m"] = round(self.length_m, 6)
        data["cost_s"] = round(self.cost_s, 6)
        if self.kind != "navigate":
            data["failure_probability"] = round(self.failure_probability, 6)
        if self.end_covariance:
            data["end_covariance"] = [[round(value, 9) for value in row] for row in self.end_covariance]
        if self.sigma_s:
            data["sigma_s"] = round(self.sigma_s, 6)
        return data


@dataclass(frozen=True, slots=True)
class Plan:
    """The answer to a planning problem."""

    reachable: bool
    tasks: tuple[Task, ...] = ()
    reason: str = ""  #: why there is no plan
    proved: bool = False  #: whether "no plan" holds for every sequence of pushes of the model
    expanded: int = 0  #: configurations that the search has looked at
    name: str = "cheapest"  #: side condition it was made under
    expected_s: float | None = None  #: with what is driven when an exploration finds that nothing moves
    notes: tuple[str, ...] = field(default=())  #: e.g. objects that are never pushed, and why
    gap: float = 0.0  #: no plan of the model is cheaper by more than this fraction of the bound

    @property
    def answer(self) -> str:
        """How good the plan is known to be, or how certain it is that there is none."""
        if not self.reachable:
            return "no plan (proved)" if self.proved else "no plan found (not proved)"
        if not np.isfinite(self.gap):
            return "no bound"
        return "optimal" if self.gap < OPTIMAL_GAP else f"within {np.ceil(100 * self.gap):.0f} %"

    @property
    def cost_s(self) -> float:
        """Sum over the tasks; infinite without a plan."""
        # Of what is written, so that a reader's sum is the same.
        return sum(round(task.cost_s, 6) for task in self.tasks) if self.reachable else float("inf")

    @property
    def length_m(self) -> float:
        """Path length of the robot [m]; infinite without a plan."""
        return sum(round(task.length_m, 6) for task in self.tasks) if self.reachable else float("inf")

    @property
    def pushes(self) -> tuple[Task, ...]:
        """The manipulation tasks."""
        return tuple(task for task in self.tasks if task.kind in ("push", "sideward"))

    @property
    def failure_probability(self) -> float:
        """Probability that at least one task fails, tasks taken as independent."""
        holds = 1.0
        for task in self.tasks:
            holds *= 1.0 - task.failure_probability
        return 1.0 - holds

    def to_json(self) -> dict[str, Any]:
        """Plain data for ``json.dumps``; costs are null where there is no plan."""
        data: dict[str, Any] = {
            "reachable": self.reachable,
            "cost_s": round(self.cost_s, 6) if self.reachable else None,
            "length_m": round(self.length_m, 6) if self.reachable else None,
            "failure_probability": round(self.failure_probability, 6) if self.reachable else None,
            "name": self.name,
            "answer": self.answer,
            "gap": round(self.gap, 6) if self.reachable and np.isfinite(self.gap) else None,
            "tasks": [task.to_json() for task in self.tasks],
            "expanded": self.expanded,
        }
        if self.expected_s is not None:
            data["expected_cost_s"] = round(self.expected_s, 6) if np.isfinite(self.expected_s) else None
        if not self.reachable:
            data["reason"] = self.reason
            data["proved"] = self.proved
        if self.notes:
            data["notes"] = list(self.notes)
        return data


def plan_from_json(data: Mapping[str, Any], *, where: str = "plan") -> Plan:
    """Read what :meth:`Plan.to_json` wrote.

    Parameters
    ----------
    data
        Plain data, as ``json.load`` returns them.
    where
        Name of the source, for error messages.

    Raises
    ------
    InputError
        A field that is missing or of the wrong kind.
    """
    try:
        tasks = tuple(_task(entry, f"{where}: tasks[{i}]") for i, entry in enumerate(data["tasks"]))
        return Plan(
            bool(data["reachable"]),
            tasks,
            str(data.get("reason", "")),
            bool(data.get("proved", False)),
            int(data.get("expanded", 0)),
            str(data.get("name", "cheapest")),
            _expected(data),
            tuple(str(note) for note in data.get("notes", ())),
            float("inf") if data.get("gap") is None else float(data["gap"]),
        )
    except KeyError as error:
        raise InputError(where, "is missing", field=str(error.args[0])) from error
    except (TypeError, ValueError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(where, f"is not a plan ({error})") from error


def _expected(data: Mapping[str, Any]) -> float | None:
    if "expected_cost_s" not in data:
        return None
    value = data["expected_cost_s"]
    return float("inf") if value is None else float(value)


def _task(entry: Mapping[str, Any], where: str) -> Task:
    kind = entry["kind"]
    if kind not in KINDS:
        raise InputError(where, f"found {kind!r}, expected one of {', '.join(KINDS)}", field="kind")
    points = {
        name: _point(entry[name]) if entry.get(name) is not None else None
        for name in ("contact_m", "goal_m", "displacement_m")
    }
    return Task(
        kind,
        float(entry["cost_s"]),
        float(entry.get("length_m", 0.0)),
        tuple(_point(point) for point in entry.get("path_m", ())),
        str(entry.get("object", "")),
        failure_probability=float(entry.get("failure_probability", 0.0)),
        end_covariance=tuple(tuple(float(value) for value in row) for row in entry.get("end_covariance", ())),
        sigma_s=float(entry.get("sigma_s", 0.0)),
        turn_rad=float(entry.get("turn_rad", 0.0)),
        **points,
    )


def _point(values: Sequence[float]) -> Point:
    x, y = (float(value) for value in values)
    if not np.isfinite([x, y]).all():
        raise ValueError(f"a point with {x}, {y}")
    return x, y


def _rounded(point: Point) -> list[float]:
    return [round(point[0], 6), round(point[1], 6)]
