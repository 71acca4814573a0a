"""State of supervised parts and streams: motions that are executed, held or press, and freshness of readings."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

#: Motion that changes the reading of any device, and distance from a target within which a part may stand [m or rad].
STANDING_M = 1e-3


@runtime_checkable
class SupervisedPart(Protocol):
    """Interface of a wrapped part to the supervisor."""

    name: str

    def execute(self) -> None:
        """Send the requested command to the device."""

    def halt(self) -> None:
        """Stop the device."""

    def pressing(self) -> object:
        """Requested motion; ``None`` at its target."""

    def retreats(self, pressing: object) -> bool:
        """Whether the requested motion retreats from the contact.

        Parameters
        ----------
        pressing
            Value returned by :meth:`pressing`; ``None``: no motion is known to press.
        """

    def only_opens(self) -> bool:
        """Whether the requested motion can only open fingers."""


class Stream:
    """Freshness of one sensor or state on the supervisor's clock.

    Parameters
    ----------
    name
        Name in messages.
    max_jump_s
        Maximum jump of its clock against the supervisor's [s].
    """

    def __init__(self, name: str, max_jump_s: float) -> None:
        self.name, self._max_jump_s = name, max_jump_s
        self.read_s = (
            self.fresh_s
        ) = -math.inf  #: arrival of the newest reading, and of the newest fresh one [s]
        self._t_s, self._ahead_s = -math.inf, -math.inf
        self.repeats = (
            False  #: whether the newest reading has a new time, but a value that should have changed
        )

    def note(self, now_s: float, t_s: float, as_of_s: float) -> str:
        """Record a reading; returns a description of a clock error, or an empty string.

        Parameters
        ----------
        now_s, t_s
            Time of the supervisor, and time stamp of the reading [s].
        as_of_s
            As of :meth:`.SupervisorCore.note` [s].
        """
        self.read_s = now_s
        if not math.isfinite(t_s):
            return ""
        ahead_s = t_s - now_s
        if math.isfinite(self._t_s):
            back_s, jump_s = self._t_s - t_s, ahead_s - self._ahead_s
            if back_s > self._max_jump_s or jump_s > self._max_jump_s:
                return f"the clock of {self.name} jumped by {jump_s:+.3g} s"
        self._ahead_s = max(self._ahead_s, ahead_s)
        self.repeats = t_s > self._t_s and as_of_s < now_s
        if t_s > self._t_s and as_of_s > -math.inf:
            self.fresh_s = min(as_of_s, now_s)
        self._t_s = max(t_s, self._t_s)
        return ""


class RepeatedState:
    """How long motions were executed whose effect on a constant state is missing.

    A state that has not changed is new if nothing was to change it: the part stood, or was held. New commands do not make it
    new, or a task whose commands depend on it would drive on for ever; only a part that may have been blocked is given
    one chance to move elsewhere.
    """

    def __init__(self) -> None:
        self._executed_s, self._missing_s, self._missing_m = 0.0, 0.0, 0.0
        self._turned_back = False

    def missing_s(self, changed: bool, executed_s: float, rate_m_s: float) -> float:
        """Record a reading; returns the duration of motions that should have changed it [s].

        Parameters
        ----------
        changed
            Whether the state has changed.
        executed_s
            Duration of all motions so far [s], as of :meth:`PartMotion.executed_s`.
        rate_m_s
            Rate at which the present motion has to change the state [m/s or rad/s]; infinite: at any reading.
        """
        passed_s, self._executed_s = executed_s - self._executed_s, executed_s
        if changed:
            self._missing_s, self._missing_m, self._turned_back = 0.0, 0.0, False
        elif passed_s > 0.0 and rate_m_s > 0.0:
            self._missing_s += passed_s
            self._missing_m += rate_m_s * passed_s
        return self._missing_s if self._missing_m > STANDING_M else 0.0

    def turn_back(self) -> None:
        """Start counting again for a motion away from what may have blocked the part; once until the state changes."""
        if not self._turned_back:
            self._missing_s, self._missing_m, self._turned_back = 0.0, 0.0, True

    def arrive(self) -> None:
        """Start counting again for another target, after the part has stood as near to the last one as it gets."""
        self._missing_s = self._missing_m = 0.0


@dataclass(slots=True)
class PartMotion:
    """Motion of a part, requested and executed."""

    part: SupervisedPart
    moving: bool = False  #: whether a motion is requested
    held: str = ""  #: why it is not executed; empty if it is
    since_s: float = -math.inf  #: time of the request [s]
    held_since_s: float = math.nan
    ran_s: float = 0.0  #: duration of all executed motions up to the last start [s]
    started_s: float = math.nan  #: time of that start; NaN: it is not executed
    executed: object = None  #: last motion that was executed
    halted_s: float = -math.inf  #: time of its end [s]; it brakes after it
    pressing: object = None  #: motion at which the force reached the limit; None: it stood
    #: motions by which the present force rose, from and to [N]
    rises: list[tuple[float, float, object]] = field(default_factory=list)

    def execute(self, now_s: float) -> None:
        """Execute the requested motion.

        Parameters
        ----------
        now_s
            Time of the supervisor [s].
        """
        self.held, self.held_since_s, self.executed = "", math.nan, self.part.pressing()
        self.started_s = now_s if math.isnan(self.started_s) else self.started_s
        self.part.execute()

    def pause(self, now_s: float) -> None:
        """Record that the motion is not executed any more.

        Parameters
        ----------
        now_s
            Time of the supervisor [s].
        """
        if not math.isnan(self.started_s):
            self.ran_s, self.halted_s, self.started_s = self.executed_s(now_s), now_s, math.nan

    def executed_s(self, now_s: float) -> float:
        """Duration of all motions so far [s], without holds.

        Parameters
        ----------
        now_s
            Time of the supervisor [s].
        """
        return self.ran_s + (0.0 if math.isnan(self.started_s) else now_s - self.started_s)

    def feel(self, before_N: float, force_N: float, brakes: bool) -> None:
        """Keep which motions raised the force, up to the present one.

        Parameters
        ----------
        before_N, force_N
            Last and present force [N].
        brakes
            Whether the part may still move after it was stopped.
        """
        runs = self.moving and not self.held
        if runs:
            self.executed = self.part.pressing()
        self.rises = [(low, min(high, force_N), by) for low, high, by in self.rises if low < force_N]
        if self.executed is None or force_N <= before_N or not (runs or brakes):
            return
        low = before_N
        if self.rises and self.rises[-1][1] == before_N:
            _, _, by = self.rises[-1]
            goes_on = not self.part.retreats(by) if runs else by is self.executed
            low = self.rises.pop()[0] if goes_on else before_N
        self.rises.append((low, force_N, self.executed))

    def towards(self, force_N: float, over_N: float, excess_N: float) -> object:
        """Motion that presses; ``None`` if none is known to.

        What has raised the force since the limit was reached counts first, then the motion there, then that of most of the force.

        Parameters
        ----------
        force_N, over_N
            Present force, and that when the limit was reached [N].
        excess_N
            Rise beyond it that is no noise any more [N].
        """
        for low, high, by in reversed(self.rises):
            if high - max(low, over_N) > excess_N:
                return by
        if self.pressing is not None:
            return self.pressing
        return next((by for low, high, by in self.rises if high - low > 0.5 * force_N), None)
