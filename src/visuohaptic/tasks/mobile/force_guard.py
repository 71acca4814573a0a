"""Force limit common to all control loops that may drive into contact."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from enum import StrEnum

import numpy as np

from ...core import POSITIVE, ForceProfile, check_numbers
from ...core.camera.frame import USUAL_RATE_Hz
from ...sensing.push.push_record import reaches_limit
from ..framework.supervisor import CHECK_RATE_HZ, SafetyLimits
from .explore_records import ExploreSettings

#: Number of readings whose median distinguishes friction from the impacts of a rattling contact.
MEDIAN_OF = 5
#: Maximum number of consecutive invalid readings before the sensor counts as failed: half a second at 50 Hz.
MAX_UNREAD = 25
#: Time to process the frame of a contact [s].
READ_S = 1.0 / USUAL_RATE_Hz
#: Age of a reading at which the supervisor stops the motion, plus one check [s]: no command is needed beyond that.
MAX_AGE_S = SafetyLimits().max_age_s + 1 / CHECK_RATE_HZ


class GuardState(StrEnum):
    """What a reading permits."""

    GO = "go"
    HOLD = "hold"  #: stand still in this control period
    TOO_HEAVY = "too heavy"  #: permanent stop: the force remains at the limit
    UNREAD = "force unread"  #: permanent stop: no valid force for too long


class ForceGuard:
    """Holds a platform at its force limit.

    A single reading at the limit, or an invalid one, holds the platform in the same
    control period. A rigid contact rattles, and its impacts are not friction: the stop is permanent only if the
    median of the newest readings during motion is at the limit. Readings below the limit that were made
    while the platform was held do not show the force that motion needs, and do not count.

    Parameters
    ----------
    max_force_N
        Maximum push force of the platform [N].
    median_of
        Number of readings in the median, odd; 1 for a compliant sensor, for which a single reading is reliable.
    max_unread
        Number of consecutive invalid readings that ends the task.
    """

    def __init__(
        self, max_force_N: float, *, median_of: int = MEDIAN_OF, max_unread: int = MAX_UNREAD
    ) -> None:
        check_numbers("ForceGuard", POSITIVE, max_force_N=max_force_N)
        self.max_force_N = max_force_N
        self._above: deque[bool] = deque(maxlen=median_of)
        self._needed = median_of // 2 + 1
        self._max_unread, self._unread, self._held = max_unread, 0, False

    @property
    def speed_fraction(self) -> float:
        """Fraction of the speed at which a platform continues: half for each of the counted readings at the limit."""
        return 0.5 ** sum(self._above)

    def update(self, force_N: float, sigma_N: float = 0.0, *, pressing: bool = True) -> GuardState:
        """Evaluate one reading.

        Parameters
        ----------
        force_N
            Force [N]; NaN if not measured.
        sigma_N
            Its standard deviation [N].
        pressing
            Whether the commanded motion presses against the contact; a retreat is not held.
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
    """Longest time from contact to braking, from the observed age of the readings.

    A contact right after one reading appears in the next one: after one interval between readings, plus the
    delay of that reading relative to the smallest delay so far.

    Parameters
    ----------
    reaction_s
        Initial value [s].
    """

    def __init__(self, reaction_s: float) -> None:
        self.reaction_s = reaction_s
        self._read_s, self._delay_s = math.nan, math.inf

    def update(self, t_s: float, now_s: float) -> None:
        """Process a reading that is newer than the previous ones.

        Parameters
        ----------
        t_s
            Time stamp on the camera's clock [s].
        now_s
            Arrival on the platform's clock [s].
        """
        self._delay_s = min(self._delay_s, now_s - t_s)
        interval_s = 0.0 if math.isnan(self._read_s) else now_s - self._read_s
        age_s = interval_s + now_s - t_s - self._delay_s
        self.reaction_s = max(self.reaction_s, min(age_s, MAX_AGE_S) + READ_S)
        self._read_s = now_s


class FoamLimit:
    """Speed limit along the front of the foam, from the remaining foam depth at each point.

    Parameters
    ----------
    explore
        Provides the stopping speed within a depth, and the initial reaction time.
    full_m
        Deflection at which the foam is densified [m].
    """

    def __init__(self, explore: ExploreSettings, full_m: float) -> None:
        self.reaction = ReactionTime(explore.reaction_s)
        self._explore, self._full_m = explore, full_m
        self._s_m = self._delta_m = np.zeros(1)

    def update(self, t_s: float, now_s: float, profile: ForceProfile) -> None:
        """Process a measurement of the foam.

        Parameters
        ----------
        t_s, now_s
            As :meth:`ReactionTime.update`.
        profile
            Deflection along the front.
        """
        self.reaction.update(t_s, now_s)
        # Points that are not measured keep their last deflection; at the zero reference the strip was free.
        read = np.isfinite(profile.delta_m)
        self._s_m, self._delta_m = profile.s_m, np.where(read, profile.delta_m, self._delta_m)

    @property
    def settings(self) -> ExploreSettings:
        """Settings of an exploration with the observed reaction time."""
        return replace(self._explore, reaction_s=self.reaction.reaction_s)

    def limited(self, speed_m_s: float, turn_rate_rad_s: float) -> tuple[float, float]:
        """Reduce both velocities by the same factor; the speed of the front at s to the left of its middle is v - w s.

        Parameters
        ----------
        speed_m_s, turn_rate_rad_s
            Requested velocities.
        """
        closing = speed_m_s - turn_rate_rad_s * self._s_m
        left_m = np.maximum(self._full_m - self._delta_m, 0.0)
        safe = self._explore.stopping_speed_m_s(left_m, self.reaction.reaction_s)
        part = float(np.min(safe[closing > 0.0] / closing[closing > 0.0], initial=1.0))
        return part * speed_m_s, part * turn_rate_rad_s
