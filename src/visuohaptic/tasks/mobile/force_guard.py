"""The force stop that every loop passes through which may drive against something."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from enum import StrEnum

import numpy as np

from ...core.errors import InputError
from ...core.measurement import ForceProfile
from ...sensing.push.push_record import reaches_limit
from ..framework.supervisor import CHECK_RATE_HZ, SafetyLimits
from .explore_records import ExploreSettings

__all__ = ["FoamLimit", "ForceGuard", "GuardState", "ReactionTime"]

#: Readings whose median decides whether a force is friction or the blow of a contact that rattles.
MEDIAN_OF = 5
#: Readings in a row that are not valid before the sensor counts as failed: half a second at 50 Hz.
MAX_UNREAD = 25
#: The frame in which a touch is read [s], at 30 Hz.
READ_S = 1 / 30
#: A supervisor stops what has not been read anew at this age, a check later [s]: beyond that no command is needed.
MAX_AGE_S = SafetyLimits().max_age_s + 1 / CHECK_RATE_HZ


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


class ReactionTime:
    """Longest time from a touch to the brake, by the age that readings have shown.

    A touch right after one reading shows in the next one: it has waited for an interval between readings, and for as
    much as that one came later after its own time than the quickest before it.

    Parameters
    ----------
    reaction_s
        As long as nothing else is seen [s].
    """

    def __init__(self, reaction_s: float) -> None:
        self.reaction_s = reaction_s
        self._read_s, self._delay_s = math.nan, math.inf

    def update(self, t_s: float, now_s: float) -> None:
        """Take a reading that is newer than those before.

        Parameters
        ----------
        t_s
            Its own time, by the camera's clock [s].
        now_s
            When it came, by the platform's clock [s].
        """
        self._delay_s = min(self._delay_s, now_s - t_s)
        interval_s = 0.0 if math.isnan(self._read_s) else now_s - self._read_s
        age_s = interval_s + now_s - t_s - self._delay_s
        self.reaction_s = max(self.reaction_s, min(age_s, MAX_AGE_S) + READ_S)
        self._read_s = now_s


class FoamLimit:
    """How fast the foam may go against what it may meet anywhere along its front: as fast as it takes up there.

    Parameters
    ----------
    explore
        For the speed from which the platform stands within a depth, and the reaction until readings come later.
    full_m
        Deflection at which the foam is full [m].
    """

    def __init__(self, explore: ExploreSettings, full_m: float) -> None:
        self.reaction = ReactionTime(explore.reaction_s)
        self._explore, self._full_m = explore, full_m
        self._s_m = self._delta_m = np.zeros(1)

    def update(self, t_s: float, now_s: float, profile: ForceProfile) -> None:
        """Take a reading of the foam.

        Parameters
        ----------
        t_s, now_s
            As :meth:`ReactionTime.update`.
        profile
            Deflection along the front.
        """
        self.reaction.update(t_s, now_s)
        # What is not read has not come back either: it is as it was, and at the zero nothing touched the strip.
        read = np.isfinite(profile.delta_m)
        self._s_m, self._delta_m = profile.s_m, np.where(read, profile.delta_m, self._delta_m)

    @property
    def settings(self) -> ExploreSettings:
        """Of an exploration, with the reaction that readings have shown."""
        return replace(self._explore, reaction_s=self.reaction.reaction_s)

    def limited(self, speed_m_s: float, turn_rate_rad_s: float) -> tuple[float, float]:
        """Both velocities reduced alike; a turn moves the ends of the front: v - w s at s to the left of its middle.

        Parameters
        ----------
        speed_m_s, turn_rate_rad_s
            As they are wanted.
        """
        closing = speed_m_s - turn_rate_rad_s * self._s_m
        left_m = np.maximum(self._full_m - self._delta_m, 0.0)
        safe = self._explore.stopping_speed_m_s(left_m, self.reaction.reaction_s)
        part = float(np.min(safe[closing > 0.0] / closing[closing > 0.0], initial=1.0))
        return part * speed_m_s, part * turn_rate_rad_s
