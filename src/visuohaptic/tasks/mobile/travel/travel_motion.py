"""Motion primitives of a navigation task, one command per control period: force stop, clock checks, standing still."""

from __future__ import annotations

import math
from collections.abc import Generator
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from ....core.clock_watch import ClockWatch
from ..force_guard import ForceGuard, GuardState
from .travel_types import TravelCommand, TravelObservation, TravelOutcome

#: Speed of a retreat [m/s].
RETREAT_M_S = 0.1
#: Error of the heading at which a turn on the spot is complete [rad].
ON_HEADING_RAD = 0.02

ResultT = TypeVar("ResultT")
#: A generator that yields one command per control period, and returns when the motion is complete.
Motion = Generator[TravelCommand, None, ResultT]


class TravelInterrupted(Exception):
    """Ends a navigation task from within any motion.

    Parameters
    ----------
    outcome
        Outcome of the task.
    reason
        One sentence.
    """

    def __init__(self, outcome: TravelOutcome, reason: str) -> None:
        super().__init__(reason)
        self.outcome, self.reason = outcome, reason


class TravelMotion:
    """Turning, driving straight, looking and standing still under the force stop.

    Every motion is a generator: when it is resumed, :attr:`seen` holds the observation made after
    its last command.

    Parameters
    ----------
    max_force_N
        Maximum push force of the platform [N].
    timeout_s
        Maximum duration of the task, by the base's clock or by the number of periods, whichever is longer [s].
    start_m
        Estimated pose of the robot before the first observation.
    """

    def __init__(self, max_force_N: float, timeout_s: float, start_m: Float[np.ndarray, "2"]) -> None:
        x, y = (float(value) for value in start_m)
        self.seen = TravelObservation(0.0, math.nan, (x, y, 0.0), 0.0, 0.0, math.nan, None)
        self._max_force_N, self._timeout_s = max_force_N, timeout_s
        # Replays do not have the host's clock: the number of periods measures time.
        self._clock = ClockWatch(host_clock=lambda: self.seen.t_s)
        self._start_s = math.nan
        self._guard = ForceGuard(max_force_N)

    def observe(self, seen: TravelObservation) -> None:
        """Process the observation of a control period.

        Parameters
        ----------
        seen
            The newest observation.

        Raises
        ------
        TravelInterrupted
            The time-out is reached, or the robot's clock has stopped.
        """
        self.seen = seen
        if math.isnan(self._start_s):
            self._start_s = seen.base_t_s
        if why := self._clock.update(seen.base_t_s):
            raise TravelInterrupted(TravelOutcome.CLOCK_STOPPED, why)
        if self.elapsed_s() >= self._timeout_s:
            raise TravelInterrupted(TravelOutcome.TIMED_OUT, f"after {self._timeout_s:.0f} s")

    def now_s(self) -> float:
        """Time of the base [s]."""
        return self.seen.base_t_s

    def pose_m(self) -> Float[np.ndarray, "3"]:
        """Pose of the robot in the map: x, y [m], heading [rad]."""
        return np.array(self.seen.pose_m)

    def point_m(self) -> Float[np.ndarray, "2"] | None:
        """Contact point of the rim in the map [m]; ``None`` without contact."""
        return None if self.seen.point_m is None else np.array(self.seen.point_m)

    def elapsed_s(self) -> float:
        """Duration of the task so far [s]."""
        return max(self.seen.t_s, self.now_s() - self._start_s)

    def remaining_s(self) -> float:
        """Time until the time-out [s]."""
        return max(self._timeout_s - self.elapsed_s(), 0.0)

    def new_guard(self) -> None:
        """Reset the force readings before a new motion."""
        self._guard = ForceGuard(self._max_force_N)

    def place_m(self, id: str) -> Float[np.ndarray, "3"] | None:
        """Pose of an object located in this period.

        Parameters
        ----------
        id
            Identifier of an object that the last command asked for.

        Returns
        -------
        (3,) array or None
            x, y of its centroid [m], rotation [rad]; ``None`` if it was not located.
        """
        for sighting in self.seen.sightings:
            if sighting.id == id and sighting.place_m is not None:
                return np.array(sighting.place_m)
        return None

    def look(self, id: str) -> Motion[Float[np.ndarray, "3"] | None]:
        """Stand still for one period and locate an object.

        Parameters
        ----------
        id
            Identifier of the object.

        Returns
        -------
        (3,) array or None
            As :meth:`place_m`.
        """
        yield TravelCommand(look=(id,))
        return self.place_m(id)

    def go(self, speed_m_s: float, turn_rate_rad_s: float, *, leaving: bool = False) -> Motion[bool]:
        """Drive for one period, as far as the force limit permits.

        Parameters
        ----------
        speed_m_s, turn_rate_rad_s
            Velocity of the platform [m/s, rad/s].
        leaving
            Whether the motion is the reverse of the one that led to a contact.

        Returns
        -------
        bool
            Whether the motion may continue.

        Raises
        ------
        TravelInterrupted
            No valid force for too long.
        """
        pressing = not leaving and self._pressing(speed_m_s, turn_rate_rad_s)
        state = self._guard.update(self.seen.force_N, pressing=pressing)
        if state is GuardState.UNREAD:
            raise force_unread()
        if state is GuardState.GO:
            yield TravelCommand(speed_m_s, turn_rate_rad_s)
        else:
            yield TravelCommand()
        return state is not GuardState.TOO_HEAVY

    def turn_to(self, heading_rad: float, *, leaving: bool = False) -> Motion[None]:
        """Turn on the spot.

        Parameters
        ----------
        heading_rad
            Heading in the map [rad].
        leaving
            As :meth:`go`.
        """
        self.new_guard()
        start_s = self.now_s()
        while self.now_s() - start_s < 20.0:
            error = math.remainder(heading_rad - float(self.pose_m()[2]), 2.0 * math.pi)
            if abs(error) < ON_HEADING_RAD:
                break
            rate = math.copysign(turn_rate(abs(error)), error)
            if not (yield from self.go(0.0, rate, leaving=leaving)):
                break
        yield from self.halt()

    def straight(self, speed_m_s: float, length_m: float, timeout_s: float) -> Motion[None]:
        """Drive straight, and stop.

        Parameters
        ----------
        speed_m_s
            Speed; negative: backward [m/s].
        length_m
            Distance after which the motion is complete [m].
        timeout_s
            Time after which it ends [s].
        """
        self.new_guard()
        start, start_s = self.pose_m(), self.now_s()
        while float(np.hypot(*(self.pose_m()[:2] - start[:2]))) < length_m:
            if self.now_s() - start_s > timeout_s:
                break
            if not (yield from self.go(speed_m_s, 0.0)):
                break
        yield from self.halt()

    def leave(self, point_m: Float[np.ndarray, "2"], length_m: float) -> Motion[None]:
        """Retreat from a wall in contact: a disc can turn on the spot, and drive away from the contact point.

        Parameters
        ----------
        point_m
            Contact point in the map frame [m].
        length_m
            Distance of the retreat [m].
        """
        away = self.pose_m()[:2] - point_m
        ahead = math.atan2(away[1], away[0])
        behind = abs(math.remainder(ahead - float(self.pose_m()[2]), 2.0 * math.pi)) > 0.5 * math.pi
        yield from self.turn_to(math.remainder(ahead + math.pi, 2.0 * math.pi) if behind else ahead)
        yield from self.straight(-0.05 if behind else 0.05, length_m, 3.0)

    def halt(self) -> Motion[None]:
        """Stand still."""
        for _ in range(50):
            yield TravelCommand()
            if abs(self.seen.speed_m_s) < 1e-3 and abs(self.seen.turn_rate_rad_s) < 1e-3:
                break

    def _pressing(self, speed_m_s: float, turn_rate_rad_s: float) -> bool:
        """Whether a motion presses against the contact; if its position is unknown, every motion except a retreat does."""
        if speed_m_s == 0.0:
            return turn_rate_rad_s != 0.0
        if self.seen.point_m is None:
            return speed_m_s > 0.0
        x, y, heading = self.seen.pose_m
        px, py = self.seen.point_m
        return speed_m_s * (math.cos(heading) * (px - x) + math.sin(heading) * (py - y)) > 0.0


def turn_rate(left_rad: float) -> float:
    """Rate of a turn on the spot [rad/s].

    Parameters
    ----------
    left_rad
        Angle that is left [rad].
    """
    return max(min(1.0, 3.0 * left_rad), 0.05)


def force_unread() -> TravelInterrupted:
    """Exception that ends a task whose force sensor has failed."""
    return TravelInterrupted(TravelOutcome.SENSOR_FAILED, "the force on the rim is not read (NaN)")
