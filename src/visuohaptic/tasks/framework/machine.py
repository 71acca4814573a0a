"""Base class of tasks: an explicit state machine whose decisions can be replayed.

A task is a subclass of :class:`Machine`. Its ``decide`` maps one observation
(a frozen dataclass of numbers) to one command (another dataclass), and
depends only on the observations and its own state: the same observations
give the same decisions, on a robot, in simulation or from a trace. A loop around
the machine communicates with the robot: it makes the observations and executes
the commands.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from ...core import ClockWatch, InputError, from_dict, to_dict
from .trace import Ending, Step, Trace


class Observation(Protocol):
    """Fields common to all observations."""

    @property
    def t_s(self) -> float:
        """Time of the observation [s]."""


StateT = TypeVar("StateT", bound=StrEnum)
ObservationT = TypeVar("ObservationT", bound=Observation)
CommandT = TypeVar("CommandT")


@dataclass(frozen=True, slots=True)
class Rule(Generic[StateT]):
    """Allowed transitions of a state, its time-out, and what follows a failure."""

    leads_to: tuple[StateT, ...] = ()
    timeout_s: float = math.inf
    otherwise: StateT | None = None  #: next state after a failure, instead of ending the task
    attempts: int = 0  #: maximum number of such transitions, counted over all states that lead there


class Machine(ABC, Generic[StateT, ObservationT, CommandT]):
    """A task as states, allowed transitions, time-outs and an ending.

    Subclasses set ``task`` and ``rules`` (the first state is the initial one) and implement
    ``decide`` and ``halt``. In ``decide`` they call :meth:`go` to change the
    state, :meth:`end` to finish, and :meth:`fail` if another attempt may help:
    the rule of the state defines the next state and the number of attempts.

    Parameters
    ----------
    settings
        Stored in the trace: a dataclass, or a mapping of numbers, texts and dataclasses.

    Examples
    --------
    >>> class State(StrEnum):
    ...     WAIT = "wait"
    ...     PUSH = "push"
    >>> @dataclass(frozen=True)
    ... class Seen:
    ...     t_s: float
    ...     force_N: float
    >>> @dataclass(frozen=True)
    ... class Told:
    ...     speed_m_s: float
    >>> class Push(Machine[State, Seen, Told]):
    ...     task = "push"
    ...     rules = {State.WAIT: Rule((State.PUSH,), 5.0), State.PUSH: Rule()}
    ...     def decide(self, seen):
    ...         if self.state is State.WAIT:
    ...             self.go(State.PUSH, "asked to")
    ...         elif seen.force_N > 1.0:
    ...             self.end(True, "touched", f"{seen.force_N:.1f} N")
    ...         return Told(0.1)
    ...     def halt(self):
    ...         return Told(0.0)
    >>> push = Push()
    >>> [push.step(Seen(t, force)).speed_m_s for t, force in ((0.0, 0.0), (0.1, 0.5), (0.2, 1.5))]
    [0.1, 0.1, 0.0]
    >>> push.trace().ending.outcome
    'touched'
    """

    task: ClassVar[str]
    rules: Mapping[Any, Rule[Any]]  #: a class attribute, or set before ``super().__init__``
    host_clock: Callable[[], float] = staticmethod(time.monotonic)  #: detects a robot clock that has stopped

    def __init__(self, settings: object = None) -> None:
        self._settings = {} if settings is None else to_dict(settings)
        self.state: StateT = next(iter(self.rules))
        self.entered_s = math.nan  #: time at which the present state was entered [s]
        self.ending: Ending | None = None
        self._steps: list[Step] = []
        self._why = ""
        self._attempts: dict[str, int] = {}  #: number of attempts, by the state that follows a failure
        self._last_s = -math.inf
        self._blind = 0  #: number of consecutive invalid readings
        # Callers may poll faster than observations arrive, so calls are not counted: only the host's time is used.
        self._clock = ClockWatch(max_periods=None, host_clock=lambda: self.host_clock())

    @abstractmethod
    def decide(self, seen: ObservationT) -> CommandT:
        """Compute the command for an observation; implemented by subclasses.

        Parameters
        ----------
        seen
            The newest observation.
        """

    @abstractmethod
    def halt(self) -> CommandT:
        """Command that stops the robot; returned whenever the task has ended."""

    def step(self, seen: ObservationT) -> CommandT:
        """Process one observation and return the command.

        For an observation that is not newer than the last one the stop command
        is returned. If no newer one arrives for
        :data:`~visuohaptic.core.clock_watch.MAX_STILL_S` of the host's clock, the task ends.

        Parameters
        ----------
        seen
            Observation; its time has to be newer than that of the last one.

        Raises
        ------
        InputError
            The task has already ended.
        """
        if self.ending is not None:
            found = f"has ended ({self.ending.outcome})"
            raise InputError(self.task, found, remedy="create a new one for each run")
        stopped = self._clock.update(seen.t_s)
        if not seen.t_s > self._last_s:
            if stopped:
                self.end(False, "clock_stopped", stopped)
            return self.halt()
        if math.isnan(self.entered_s):
            self.entered_s = seen.t_s
        self._last_s, before, self._why = seen.t_s, self.state, ""
        if seen.t_s - self.entered_s > self.rules[self.state].timeout_s:
            limit = self.rules[self.state].timeout_s
            self.fail("timed_out", f"{self.state} took longer than {limit:g} s")
            command = self.halt()
        else:
            command = self.decide(seen)
            command = self.halt() if self.ended else command
        self._steps.append(Step(seen.t_s, before, to_dict(seen), to_dict(command), self.state, self._why))
        return command

    def go(self, state: StateT, why: str) -> None:
        """Change the state.

        Parameters
        ----------
        state
            The next state.
        why
            One sentence, kept in the trace.

        Raises
        ------
        InputError
            The rules do not allow the transition: an error in the task.
        """
        allowed = self.rules[self.state].leads_to
        if state not in allowed:
            raise InputError(
                self.task,
                f"found a change from {self.state} to {state}, expected one of {[str(s) for s in allowed]}",
            )
        self.state, self.entered_s, self._why = state, self._last_s, why

    def end(self, success: bool, outcome: str, why: str) -> None:
        """Finish the task. Only the first call has an effect.

        Parameters
        ----------
        success
            Whether the task has reached its goal.
        outcome
            A value of the task's enumeration of outcomes.
        why
            One sentence with the numbers that led to the decision.
        """
        if self.ending is None:
            self.ending = Ending(bool(success), str(outcome), why)

    def fail(self, outcome: str, why: str) -> bool:
        """Start another attempt if the rule of the present state permits one, else finish without success.

        Parameters
        ----------
        outcome
            Outcome without another attempt: a value of the task's enumeration of outcomes.
        why
            One sentence with the numbers that led to the decision; stored in the trace in both cases.

        Returns
        -------
        bool
            Whether the task continues, in the state given by the rule.
        """
        rule = self.rules[self.state]
        if rule.otherwise is None or self._attempts.get(rule.otherwise, 0) >= rule.attempts:
            self.end(False, outcome, why)
            return False
        self._attempts[rule.otherwise] = self._attempts.get(rule.otherwise, 0) + 1
        self.go(rule.otherwise, f"{outcome}: {why}; another attempt")
        return True

    def give_up(self, outcome: str, why: str) -> CommandT:
        """Finish without success; returns the stop command.

        Parameters
        ----------
        outcome, why
            As of :meth:`end`.
        """
        self.end(False, outcome, why)
        return self.halt()

    def unread(self, felt: bool, outcome: str, max_frames: int) -> bool:
        """Count consecutive invalid readings, and end the task if there are too many.

        Parameters
        ----------
        felt
            Whether the newest reading is valid.
        outcome
            Outcome of the task in that case.
        max_frames
            Number of consecutive invalid readings that ends the task.

        Returns
        -------
        bool
            Whether the task has ended.
        """
        self._blind = 0 if felt else self._blind + 1
        if self._blind >= max_frames:
            self.end(False, outcome, f"{self._blind} successive frames were not valid")
        return self._blind >= max_frames

    @property
    def ended(self) -> bool:
        """Whether the task has ended."""
        return self.ending is not None

    def since_s(self, t_s: float) -> float:
        """Duration of the present state [s].

        Parameters
        ----------
        t_s
            Time of the present observation [s].
        """
        return t_s - self.entered_s

    def trace(self) -> Trace:
        """Trace of all steps so far."""
        return Trace(self.task, self._settings, tuple(self._steps), self.ending)


def replay(
    trace: Trace, machine: Machine[Any, ObservationT, Any], observation: type[ObservationT]
) -> Ending | None:
    """Replay the observations of a trace on a new machine and verify that it makes the same decisions.

    Parameters
    ----------
    trace
        Trace of a run.
    machine
        Machine created with the settings of the trace.
    observation
        Dataclass of its observations.

    Returns
    -------
    Ending or None
        Ending of the replayed run.

    Raises
    ------
    InputError
        A step differs; the message states which one, and the difference.
    """
    if machine.task != trace.task:
        raise InputError("replay", f"found a trace of {trace.task!r}, expected one of {machine.task!r}")
    for number, step in enumerate(trace.steps):
        seen = from_dict(observation, dict(step.observation), where=f"step {number}")
        command = to_dict(machine.step(seen))
        if command != step.command or machine.state != step.next_state:
            raise InputError(
                "replay",
                f"found {command} and state {machine.state}, expected {step.command} and {step.next_state}",
                field=f"step {number} at {step.t_s:.3f} s",
            )
    return machine.ending
