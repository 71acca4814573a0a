"""What every motion of a travel passes through: the force stop, the clocks, and the ways to stand still."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from ....core.robots import ClockWatch, MobileBase
from ..force_guard import ForceGuard, GuardState
from .travel_types import TravelOutcome, TravelSenses

__all__ = ["PERIOD_S", "TravelInterrupted", "TravelMotion"]

PERIOD_S = 0.02


class TravelInterrupted(Exception):
    """Ends a travel from within any motion."""

    def __init__(self, outcome: TravelOutcome, reason: str) -> None:
        super().__init__(reason)
        self.outcome, self.reason = outcome, reason


class TravelMotion:
    """One control period after the other.

    Parameters
    ----------
    base, senses, wait
        See :func:`~visuohaptic.tasks.mobile.travel.navigate.travel`.
    max_force_N
        What the platform can push [N].
    timeout_s
        Of the whole travel, by the base's clock or by the periods that were waited, whichever is longer.
    """

    def __init__(
        self,
        base: MobileBase,
        senses: TravelSenses,
        wait: Callable[[float], None],
        max_force_N: float,
        timeout_s: float,
    ) -> None:
        self._base, self._senses, self._wait = base, senses, wait
        self._max_force_N, self._timeout_s = max_force_N, timeout_s
        self._clock, self._periods = ClockWatch(), 0
        self._begin_s = self.now_s()
        self._guard = self.new_guard()

    def now_s(self) -> float:
        """Time of the base [s]."""
        return self._base.state().t_s

    def pose_m(self) -> Float[np.ndarray, "3"]:
        """Where the robot is in the map: x, y [m], heading [rad]."""
        return np.array(self._senses.pose())

    def passed_s(self) -> float:
        """How long the travel has lasted [s]."""
        return max(self.now_s() - self._begin_s, self._periods * PERIOD_S)

    def left_s(self) -> float:
        """Time until the travel ends [s]."""
        return max(self._timeout_s - self.passed_s(), 0.0)

    def new_guard(self) -> ForceGuard:
        """Forget what was felt: another motion begins."""
        self._guard = ForceGuard(self._max_force_N)
        return self._guard

    def command(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """Drive for one period; whoever calls has judged the force.

        Raises
        ------
        TravelInterrupted
            The time is over, or the robot's clock stands still.
        """
        self._base.drive(speed_m_s, turn_rate_rad_s)
        self._pass()

    def go(self, speed_m_s: float, turn_rate_rad_s: float) -> bool:
        """Drive for one period as far as the force allows; whether the motion may go on.

        Raises
        ------
        TravelInterrupted
            As :meth:`command`; or the force was not read for too long.
        """
        force_N, point_m = self._senses.touch()
        pressing = self._pressing(speed_m_s, turn_rate_rad_s, point_m)
        state = self._guard.update(force_N, pressing=pressing)
        if state is GuardState.GO:
            self.command(speed_m_s, turn_rate_rad_s)
            return True
        self._base.stop()
        if state is GuardState.UNREAD:
            raise force_unread()
        self._pass()
        return state is GuardState.HOLD

    def turn_to(self, heading_rad: float) -> None:
        """Turn on the spot."""
        self.new_guard()
        begin_s = self.now_s()
        while self.now_s() - begin_s < 20.0:
            error = math.remainder(heading_rad - float(self.pose_m()[2]), 2.0 * math.pi)
            rate = math.copysign(max(min(1.0, 3.0 * abs(error)), 0.05), error)
            if abs(error) < 0.02 or not self.go(0.0, rate):
                break
        self.halt()

    def straight(self, speed_m_s: float, way_m: float, timeout_s: float) -> None:
        """Drive straight for a way or a time, and stand."""
        self.new_guard()
        begin, begin_s = self.pose_m(), self.now_s()
        while float(np.hypot(*(self.pose_m()[:2] - begin[:2]))) < way_m:
            if self.now_s() - begin_s > timeout_s or not self.go(speed_m_s, 0.0):
                break
        self.halt()

    def halt(self) -> None:
        """Stand still."""
        self._base.stop()
        for _ in range(50):
            self._pass()
            state = self._base.state()
            if abs(state.speed_m_s) < 1e-3 and abs(state.turn_rate_rad_s) < 1e-3:
                break

    def _pass(self) -> None:
        """Let a period pass."""
        self._wait(PERIOD_S)
        self._periods += 1
        if why := self._clock.update(self.now_s()):
            raise TravelInterrupted(TravelOutcome.CLOCK_STOPPED, why)
        if self.passed_s() >= self._timeout_s:
            raise TravelInterrupted(TravelOutcome.TIMED_OUT, f"after {self._timeout_s:.0f} s")

    def _pressing(
        self, speed_m_s: float, turn_rate_rad_s: float, point_m: tuple[float, float] | None
    ) -> bool:
        """Whether a motion goes against what is touched; where that is not known, any but a retreat does."""
        if speed_m_s == 0.0:
            return turn_rate_rad_s != 0.0
        if point_m is None:
            return speed_m_s > 0.0
        x, y, heading = (float(value) for value in self.pose_m())
        ahead = math.cos(heading) * (point_m[0] - x) + math.sin(heading) * (point_m[1] - y)
        return speed_m_s * ahead > 0.0


def force_unread() -> TravelInterrupted:
    """The end of a travel whose robot feels nothing any more."""
    return TravelInterrupted(TravelOutcome.SENSOR_FAILED, "the force on the rim is not read (NaN)")
