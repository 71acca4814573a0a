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
        """Record a reading; returns a description of a clock error, or an empty string."""
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
class Motion:
    """Motion state of a part."""

    part: SupervisedPart
    moving: bool = False  #: whether a motion is requested
    held: str = ""  #: why it is not executed; empty if it is
    since_s: float = -math.inf  #: time of the request [s]
    held_since_s: float = math.nan
    halted_s: float = -math.inf  #: time of the last stop [s]
    pressing: object = None  #: motion at which the force reached the limit; None: it stood
    #: motions by which the present force rose, from and to [N]
    rises: list[tuple[float, float, object]] = field(default_factory=list)

    def feel(self, before_N: float, force_N: float, moves: bool) -> None:
        """Keep which motions raised the force, up to the present one."""
        self.rises = [(low, min(high, force_N), by) for low, high, by in self.rises if low < force_N]
        by = self.part.pressing() if moves and force_N > before_N else None
        if by is not None:
            low = before_N
            if self.rises and self.rises[-1][1] == before_N and not self.part.retreats(self.rises[-1][2]):
                low = self.rises.pop()[0]
            self.rises.append((low, force_N, by))

    def towards(self, force_N: float, limit_N: float) -> object:
        """Motion that presses; ``None`` if none is known to: neither by most of the force nor by what exceeds the limit."""
        if self.pressing is not None:
            return self.pressing
        known = [rise for rise in self.rises if rise[1] - rise[0] > 0.5 * force_N or rise[1] > limit_N]
        return max(known, key=lambda rise: rise[1] - rise[0])[2] if known else None
