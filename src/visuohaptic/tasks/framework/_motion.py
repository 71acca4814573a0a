"""State of supervised parts and streams: motions that are executed, held or press, and freshness of readings."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable


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

    def note(self, now_s: float, t_s: float, frozen: bool) -> str:
        """Record a reading; returns a description of a clock error, or an empty string.

        Parameters
        ----------
        now_s, t_s
            Time of the supervisor, and time stamp of the reading [s].
        frozen
            Whether it is a copy of the last one although the value should have changed.
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
        if t_s > self._t_s and not frozen:
            self.fresh_s = now_s
        self._t_s = max(t_s, self._t_s)
        return ""


@dataclass(slots=True)
class PartMotion:
    """Motion of a part, requested and executed."""

    part: SupervisedPart
    moving: bool = False  #: whether a motion is requested
    held: str = ""  #: why it is not executed; empty if it is
    since_s: float = -math.inf  #: time of the request [s]
    held_since_s: float = math.nan
    executed: object = None  #: last motion that was executed
    halted_s: float = -math.inf  #: time of its end [s]; it brakes after it
    pressing: object = None  #: motion at which the force reached the limit; None: it stood
    #: motions by which the present force rose, from and to [N]
    rises: list[tuple[float, float, object]] = field(default_factory=list)

    def execute(self) -> None:
        """Execute the requested motion."""
        self.held, self.held_since_s, self.executed = "", math.nan, self.part.pressing()
        self.part.execute()

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
