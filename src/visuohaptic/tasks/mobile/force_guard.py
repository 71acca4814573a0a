"""The force stop that every loop passes through which may drive against something."""

from __future__ import annotations

import math
from collections import deque
from enum import StrEnum

from ...core.errors import InputError
from ...sensing.push.push_record import reaches_limit

__all__ = ["ForceGuard", "GuardState"]

#: Readings whose median decides whether a force is friction or the blow of a contact that rattles.
MEDIAN_OF = 5
#: Readings in a row that are not valid before the sensor counts as failed: half a second at 50 Hz.
MAX_UNREAD = 25


class GuardState(StrEnum):
    """What a reading allows."""

    GO = "go"
    HOLD = "hold"  #: stand still in this control period
    TOO_HEAVY = "too heavy"  #: stop for good: the force stays at the limit
    UNREAD = "force unread"  #: stop for good: the force has not been read for too long


class ForceGuard:
    """Holds a platform back at its force limit.

    A single reading at the limit, or one that is not valid, makes the platform stand in that same
    control period. A rigid contact rattles, and its blows are not friction: the stop is for good only once the
    median of the newest readings under way is at the limit. Readings below it that were made
    while the platform was held say nothing of the force that motion needs, and do not count.

    Parameters
    ----------
    max_force_N
        What the platform can push [N].
    median_of
        Readings in the median, odd; 1 for a compliant sensor, whose first reading is enough.
    max_unread
        Invalid readings in a row that end the task.
    """

    def __init__(
        self, max_force_N: float, *, median_of: int = MEDIAN_OF, max_unread: int = MAX_UNREAD
    ) -> None:
        if not max_force_N > 0:
            raise InputError(
                "ForceGuard", f"found {max_force_N} N, expected more than 0", field="max_force_N"
            )
        self.max_force_N = max_force_N
        self._above: deque[bool] = deque(maxlen=median_of)
        self._needed = median_of // 2 + 1
        self._max_unread, self._unread, self._held = max_unread, 0, False

    def update(self, force_N: float, sigma_N: float = 0.0, *, pressing: bool = True) -> GuardState:
        """Judge one reading.

        Parameters
        ----------
        force_N
            NaN when it was not read [N].
        sigma_N
            Its standard deviation [N].
        pressing
            Whether the platform is about to move against what it touches: a retreat is not held back.
        """
        if math.isnan(force_N):
            self._unread += 1
            self._held = True
            return GuardState.UNREAD if self._unread >= self._max_unread else GuardState.HOLD
        self._unread = 0
        if not pressing:
            self._above.clear()
            self._held = False
            return GuardState.GO
        above = reaches_limit(force_N, sigma_N, self.max_force_N)
        if above or not self._held:
            self._above.append(above)
        self._held = above
        if sum(self._above) >= self._needed:
            return GuardState.TOO_HEAVY
        return GuardState.HOLD if above else GuardState.GO
