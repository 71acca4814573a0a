"""State machine of an exploration by pushing: approach, push, stand still, retreat (Alt 2016, Sec. 3.6.2)."""

from __future__ import annotations

import math
from dataclasses import replace

from ...sensing.push.push_record import StopLimits, StopReason, stop_reason
from ..framework.machine import Machine, Rule
from .explore_records import (
    ExploreCommand,
    ExploreObservation,
    ExploreOutcome,
    ExploreSettings,
    ExploreState,
)
from .force_guard import ForceGuard, GuardState, ReactionTime


class ExploreTask(Machine[ExploreState, ExploreObservation, ExploreCommand]):
    """Drive straight on until contact, push the obstacle, stand still, retreat.

    Parameters
    ----------
    settings
        Speeds, distances and limits.
    max_deflection_m
        Deflection at which the foam is densified [m].
    sight_m
        Range of the scene tracker ahead of the foam [m]; 0 without scene tracking.
    """

    task = "explore"

    def __init__(
        self,
        settings: ExploreSettings | None = None,
        *,
        max_deflection_m: float,
        sight_m: float = 0.0,
    ) -> None:
        self.settings = settings or ExploreSettings()
        s = ExploreState
        self.rules = {
            s.APPROACH: Rule((s.PUSH, s.HALT)),
            s.PUSH: Rule((s.HALT,)),
            s.HALT: Rule((s.BACK_OFF,)),
            s.BACK_OFF: Rule(),
        }
        super().__init__({"explore": self.settings, "max_deflection_m": max_deflection_m, "sight_m": sight_m})
        self.limits = StopLimits(max_deflection_m, self.settings.max_force_N, self.settings.push_m)
        self.reaction = ReactionTime(self.settings.reaction_s)
        self.ahead = LookAhead(sight_m, self.settings)
        self.stopped_by: StopReason | None = None
        self.touched = False
        # The foam is compliant: a single reading at the limit is reliable.
        self._guard = ForceGuard(
            self.settings.max_force_N, median_of=1, max_unread=self.settings.max_invalid_frames
        )
        self._first: ExploreObservation | None = None
        self._contact = False  #: whether the previous frame showed a contact
        self._halted_s = self._back_travel_m = self._read_s = self._interval_s = math.nan
        self._command = ExploreCommand(self._blind_m_s())

    def _blind_m_s(self) -> float:
        """Approach speed without vision: the foam has to absorb an unexpected contact."""
        s = self.settings
        return min(s.approach_m_s, s.stopping_speed_m_s(self.limits.deflection_m, self.reaction.reaction_s))

    def halt(self) -> ExploreCommand:
        """Command that stops the platform."""
        return ExploreCommand(0.0)

    def decide(self, seen: ExploreObservation) -> ExploreCommand:
        """Speed of the platform after one frame."""
        self._first = self._first or seen
        if seen.sight and not self.touched:
            self.ahead.update(seen.sight_valid, seen.ahead_m, seen.travel_m, at_border=seen.at_border)
        self.reaction.update(seen.t_s, seen.base_t_s)
        self._interval_s, self._read_s = seen.t_s - self._read_s, seen.t_s
        pressing = self.state in (ExploreState.APPROACH, ExploreState.PUSH)
        force_N = seen.force_N if seen.force_read else math.nan
        allowed = self._guard.update(force_N, seen.force_sigma_N, pressing=pressing)
        elapsed_s = max(seen.base_t_s - self._first.base_t_s, seen.t_s - self._first.t_s)
        if elapsed_s > self.settings.timeout_s:
            self.end(False, ExploreOutcome.TIMED_OUT, f"after {elapsed_s:.1f} s")
        elif allowed is GuardState.UNREAD and pressing:
            # Densified foam may remain unreadable: the retreat does not need a reading.
            why = f"{self.settings.max_invalid_frames} successive frames were not valid"
            self.end(False, ExploreOutcome.SENSOR_FAILED, why)
        elif allowed is GuardState.TOO_HEAVY:
            self.touched = True
            self._stop(StopReason.TOO_HEAVY, seen)
        else:
            self._follow(seen)
        self._contact = seen.contact
        return self._command

    def _follow(self, seen: ExploreObservation) -> None:
        """Determine the next state from the present one, and the speed in it."""
        s = self.settings
        if self.state is ExploreState.APPROACH:
            if seen.in_contact:
                self.touched = True
                self.go(ExploreState.PUSH, f"touched after {seen.travel_m:.3f} m")
                self._command = self._push(seen)
            elif seen.travel_m > s.search_m:
                self.end(False, ExploreOutcome.NOTHING_FOUND, f"no contact in {seen.travel_m:.2f} m")
            else:
                slow_m_s = self._blind_m_s()
                self.ahead.settings = replace(s, approach_m_s=slow_m_s)
                speed_m_s = self.ahead.speed_m_s(seen.travel_m) if seen.sight else slow_m_s
                # After the first frame with a contact move by a small step: the next frame confirms or rejects it.
                self._command = (
                    self._push(seen) if seen.contact and not self._contact else ExploreCommand(speed_m_s)
                )
        elif self.state is ExploreState.PUSH:
            reason = self._must_stop(seen)
            if reason is None and seen.travel_m > s.search_m + s.push_m:
                # Contact lost during the push: the object moved out of reach without resistance.
                reason = StopReason.PUSHED_FAR
            if reason is not None:
                self._stop(reason, seen)
            elif math.isfinite(seen.deflection_m):
                self._command = self._push(seen)
        elif self.state is ExploreState.HALT:
            if seen.base_t_s - self._halted_s >= s.halt_s:
                self.go(ExploreState.BACK_OFF, f"stood for {s.halt_s:g} s")
                self._back_travel_m = seen.travel_m
                self._command = ExploreCommand(-s.back_off_m_s)
        elif seen.travel_m < self._back_travel_m - s.back_off_m:
            self.end(True, ExploreOutcome.TAGGED, f"stopped by {self.stopped_by}")

    def _push(self, seen: ExploreObservation) -> ExploreCommand:
        """Drive slowly until the object moves, and more slowly as the foam fills, to stop before densification."""
        s = self.settings
        depth_m = 0.0 if math.isnan(seen.deflection_m) else seen.deflection_m
        left_m = max(self.limits.deflection_m / s.strain_fraction - depth_m, 0.0)
        speed_m_s = min(s.push_m_s, s.stopping_speed_m_s(left_m, self.reaction.reaction_s))
        if seen.contact and math.isnan(seen.motion_travel_m) and self._interval_s > 0.0:
            speed_m_s = min(speed_m_s, max(s.touch_m_s, s.rise * depth_m / self._interval_s))
        return ExploreCommand(speed_m_s)

    def _must_stop(self, seen: ExploreObservation) -> StopReason | None:
        """Stop condition that holds; none if the foam was not measured."""
        if seen.fell:
            return StopReason.FELL
        if math.isnan(seen.deflection_m):
            return None
        moves = not math.isnan(seen.motion_travel_m)
        pushed_m = seen.travel_m - seen.motion_travel_m if moves else 0.0
        return stop_reason(
            seen.deflection_m,
            seen.force_N,
            pushed_m,
            self.limits,
            force_sigma_N=seen.force_sigma_N,
            unread_frames=0,  # the force guard counts them
        )

    def _stop(self, reason: StopReason, seen: ExploreObservation) -> None:
        self.go(ExploreState.HALT, f"{reason} at {seen.force_N:.1f} N and {1e3 * seen.deflection_m:.1f} mm")
        self.stopped_by, self._halted_s, self._command = reason, seen.base_t_s, self.halt()


class LookAhead:
    """Speed limit of the platform from the free distance seen ahead of the foam.

    Parameters
    ----------
    sight_m
        Range of the scene tracker ahead of the foam [m].
    settings
        Speeds, braking and gaps.
    """

    def __init__(self, sight_m: float, settings: ExploreSettings) -> None:
        self.sight_m, self.settings = sight_m, settings
        self.seen_m = math.nan
        self.expected_m = math.nan if settings.expected_m is None else settings.expected_m
        self._valid = False

    def update(self, valid: bool, ahead_m: float, travel_m: float, *, at_border: bool = False) -> None:
        """Process the newest frame.

        Parameters
        ----------
        valid
            Whether its obstacle mask is valid.
        ahead_m
            Gap from the foam to the nearest obstacle [m]; infinite: no obstacle.
        travel_m
            Distance driven so far [m].
        at_border
            Whether the obstacle touches the border of the image.
        """
        self._valid = valid
        if not (valid and math.isfinite(ahead_m)) or at_border:
            return  # at the border it may be nearer than it appears: keep the previous estimate
        if math.isnan(self.seen_m):
            self.seen_m = ahead_m
        expected = travel_m + ahead_m
        # Obstacles do not disappear before contact: keep the nearest estimate.
        passed = travel_m > self.expected_m + 2.0 * self.settings.near_m
        self.expected_m = (
            expected if passed or math.isnan(self.expected_m) else min(self.expected_m, expected)
        )

    def speed_m_s(self, travel_m: float) -> float:
        """Maximum speed [m/s] from which the platform can brake to the slow speed before a possible obstacle.

        Parameters
        ----------
        travel_m
            Distance driven [m].
        """
        s = self.settings
        # What was in view at the start is not seen again; before the first parallax, nothing is seen at all.
        unseen = travel_m < self.sight_m and s.free_ahead_m < self.sight_m
        free = self.sight_m if self._valid and not unseen else s.free_ahead_m - travel_m
        # If there is no contact within a few centimetres, the estimate is discarded.
        if travel_m < self.expected_m + 2.0 * s.near_m:
            free = min(free, self.expected_m - travel_m)
        fastest = math.sqrt(s.approach_m_s**2 + 2.0 * s.brake_m_s2 * max(free - s.near_m, 0.0))
        return min(max(s.cruise_m_s, s.approach_m_s), fastest)
