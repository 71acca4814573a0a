"""Trace of a task: observation, command and state transition of every step, as JSON lines."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...core import FINITE, InputError, check_ranges, from_dict, read_text, to_dict, write_text


@dataclass(frozen=True, slots=True)
class Step:
    """One observation with the resulting command and state."""

    t_s: float = field(metadata=FINITE)  #: time of the observation [s]
    state: str  #: state before the step
    observation: Mapping[str, Any]  #: as JSON types
    command: Mapping[str, Any]  #: to the robot, as JSON types
    next_state: str  #: state after the step
    why: str  #: reason of the transition; empty without one

    check_read = check_ranges


@dataclass(frozen=True, slots=True)
class Ending:
    """How a task ended."""

    success: bool
    outcome: str  #: a value of the task's enumeration of outcomes
    why: str  #: one sentence with the numbers that led to the decision


@dataclass(frozen=True, slots=True)
class Trace:
    """All steps of one run.

    Examples
    --------
    >>> step = Step(0.5, "approach", {"t_s": 0.5, "force_N": 1.0}, {"speed_m_s": 0.0}, "push", "force above 0.5 N")
    >>> trace = Trace("example", {}, (step,), Ending(True, "pushed", "done"))
    >>> Trace.from_lines(trace.lines()) == trace
    True
    """

    task: str
    settings: Mapping[str, Any]  #: settings of the run, as JSON types
    steps: tuple[Step, ...]
    ending: Ending | None  #: ``None``: the run was interrupted

    def states(self) -> tuple[str, ...]:
        """The states that were visited, in order."""
        names = [self.steps[0].state] if self.steps else []
        for step in self.steps:
            if step.next_state != names[-1]:
                names.append(step.next_state)
        return tuple(names)

    def story(self) -> tuple[str, ...]:
        """One line per state transition, for printing."""
        lines = [
            f"{step.t_s:8.2f} s  {step.state} -> {step.next_state}: {step.why}"
            for step in self.steps
            if step.next_state != step.state
        ]
        if self.ending is not None:
            lines.append(f"{self.task}: {self.ending.outcome}, {self.ending.why}")
        return tuple(lines)

    def lines(self) -> tuple[str, ...]:
        """JSON lines: a head, the steps, and the ending."""
        head = {"task": self.task, "settings": to_dict(self.settings)}
        rows = [head, *(to_dict(step) for step in self.steps)]
        if self.ending is not None:
            rows.append({"ending": to_dict(self.ending)})
        return tuple(json.dumps(row, ensure_ascii=False, allow_nan=False) for row in rows)

    def save(self, path: Path | str) -> None:
        """Write the JSON lines atomically.

        Parameters
        ----------
        path
            File to write.
        """
        write_text(path, "\n".join(self.lines()) + "\n")

    @classmethod
    def load(cls, path: Path | str) -> Trace:
        """Read a file written by :meth:`save`.

        Parameters
        ----------
        path
            File of JSON lines.

        Raises
        ------
        InputError
            The file is missing, too large, not UTF-8, or not a trace.
        """
        return cls.from_lines(read_text(path).splitlines(), where=path)

    @classmethod
    def from_lines(cls, lines: Iterable[str], where: object = "trace") -> Trace:
        """Parse JSON lines.

        Parameters
        ----------
        lines
            Lines of the file.
        where
            Name of the source in errors.

        Raises
        ------
        InputError
            A line is not JSON, or not a step.
        """
        rows = []
        for number, line in enumerate(lines, 1):
            try:
                row = json.loads(line)
            except (ValueError, RecursionError) as error:
                raise InputError(where, f"is not JSON ({error})", field=f"line {number}") from error
            if not isinstance(row, dict):
                raise InputError(
                    where, f"found {type(row).__name__}, expected an object", field=f"line {number}"
                )
            rows.append(row)
        if (
            not rows
            or not isinstance(rows[0].get("task"), str)
            or not isinstance(rows[0].get("settings"), dict)
        ):
            raise InputError(where, "expected a header with task and settings", field="line 1")
        last = rows[-1].get("ending") if len(rows) > 1 else None
        ending = from_dict(Ending, last, where=f"{where}: ending") if last is not None else None
        body = rows[1:-1] if last is not None else rows[1:]
        steps = tuple(from_dict(Step, row, where=f"{where}: line {k}") for k, row in enumerate(body, 2))
        return cls(rows[0]["task"], rows[0]["settings"], steps, ending)
