"""Detection of a stopped robot clock, by counting control periods and by the host's clock."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

#: A clock counts as stopped after this time on the host's clock without advancing [s]: no robot's odometry or camera
#: is that slow.
MAX_STILL_S = 5.0
#: Or after as many control periods as a loop at 50 Hz has in that time.
MAX_STILL_PERIODS = round(50 * MAX_STILL_S)


class ClockWatch:
    """Detects a stopped robot clock, by counting control periods and by the host's clock.

    A time-out on the robot's clock never expires while that clock is stopped. Each control period
    calls :meth:`update`; the clock counts as stopped when it has not advanced for ``max_periods`` calls,
    or for ``max_host_s`` of the host's monotonic clock.

    Parameters
    ----------
    max_periods
        Number of control periods; ``None`` if the periods have no fixed length, as in polling.
    max_host_s
        Time on the host's clock [s].
    host_clock
        Returns the host's monotonic time [s].
    """

    def __init__(
        self,
        *,
        max_periods: int | None = MAX_STILL_PERIODS,
        max_host_s: float = MAX_STILL_S,
        host_clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._max_periods, self._max_host_s, self._host_clock = max_periods, max_host_s, host_clock
        self._newest_s, self._since_s, self.periods = -math.inf, math.nan, 0

    def update(self, t_s: float) -> str:
        """Process the robot's time, and check whether its clock is running.

        Parameters
        ----------
        t_s
            Time on the robot's clock [s].

        Returns
        -------
        str
            Why the clock counts as stopped; empty while it is running.
        """
        if t_s > self._newest_s or math.isnan(self._since_s):
            self._newest_s = t_s if math.isfinite(t_s) else self._newest_s
            self._since_s, self.periods = self._host_clock(), 0
            return ""
        self.periods += 1
        host_s = self._host_clock() - self._since_s
        if host_s > self._max_host_s or (self._max_periods is not None and self.periods >= self._max_periods):
            return f"the robot's clock has stood still at {t_s:g} s for {self.periods} control periods"
        return ""
