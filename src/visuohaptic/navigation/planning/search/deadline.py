"""When a search has to stop: by the time that it was given of the processor, and by the clock on the wall."""

from __future__ import annotations

import time
from dataclasses import dataclass

__all__ = ["WALL_PER_CPU", "Deadline"]

#: A search that shares its processor may take so many times its budget on the wall.
WALL_PER_CPU = 3.0


@dataclass(frozen=True, slots=True)
class Deadline:
    """The end of a budget. On an idle machine both times pass alike; on a busy one an answer stays the same longer."""

    cpu_s: float  #: time of this thread
    wall_s: float  #: monotonic clock

    @classmethod
    def after(cls, budget_s: float) -> Deadline:
        """A budget from now on.

        Parameters
        ----------
        budget_s
            Time of the processor [s].
        """
        return cls(time.thread_time() + budget_s, time.monotonic() + WALL_PER_CPU * budget_s)

    def earlier(self, seconds: float) -> Deadline:
        """The deadline of a part of the budget.

        Parameters
        ----------
        seconds
            Of the budget that are left after it [s].
        """
        return Deadline(self.cpu_s - seconds, self.wall_s - WALL_PER_CPU * seconds)

    @property
    def left_s(self) -> float:
        """What is left of the budget [s]."""
        return min(self.cpu_s - time.thread_time(), (self.wall_s - time.monotonic()) / WALL_PER_CPU)

    @property
    def passed(self) -> bool:
        """Whether the budget is spent."""
        return self.left_s < 0.0
