"""Events of a contact: contact, motion, release (Alt 2016, Sec. 3.6.2 and 4.1).

*Contact*: the deflection rises above its noise. *Motion*: the deflection
is constant or falls while the platform continues: the object moves. *Release*:
the contact is lost. *Fall* and *slip* are detected by the scene tracker and
passed through.

With the default settings a contact needs five sigma in two consecutive frames:
for 85 points of white noise that is one false alarm in about 10^11 frames, and
the event is raised one frame late. Errors of the points are also correlated: a contact
needs a force of five sigma including all common errors. Motion is raised when the platform
has moved 2 mm (at least four frames) without a corresponding rise of the deflection;
its time stamp is the start of the plateau.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from ...core import Event, EventKind, ForceProfile, InputError, Reason

#: Reasons for which the force is invalid but the contour is valid, and ``OK``.
_CONTOUR_SEEN = frozenset({Reason.OK, Reason.UNLOADING, Reason.SATURATED})
#: Frames of the last travel that are kept. At 30 Hz and the default travel of two windows of 2 mm each, a platform faster
#: than 0.25 mm/s needs fewer.
_MAX_WINDOW = 480
#: Time [s], deflection [m], its standard deviation [m] and travel [m] of a frame.
_Row = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class EventSettings:
    """Thresholds of the state machine."""

    contact_sigmas: float = 5.0  #: minimum deflection of a contact, in standard deviations
    contact_m: float = 1e-4  #: minimum deflection of a contact [m]; both have to be exceeded
    release_fraction: float = 0.5  #: hysteresis: released below this fraction of the contact threshold
    confirm_frames: int = 2  #: consecutive frames for contact and release
    #: the object moves if the ratio of deflection to travel falls below this fraction of its value during the rise
    motion_slope: float = 0.3
    motion_sigmas: float = 2.0  #: standard deviations by which the slope has to be below that value
    motion_travel_m: float = 0.002  #: travel over which the slope is measured [m]
    motion_frames: int = 4
    region_gap_m: float = 0.01  #: regions closer than this are merged [m]


class DeflectionEvents:
    """Event state machine of one contact, from its deflection [m] and the travel of the platform [m].

    Call :meth:`update` once per frame in order of time; omit frames without a
    measurement. Without travel the platform is assumed to move at the
    highest rate at which the deflection rose.

    Parameters
    ----------
    settings
        Thresholds of the events; defaults if omitted.
    s_m
        Position of the contact along the strip [m].
    """

    def __init__(self, settings: EventSettings | None = None, s_m: float = float("nan")) -> None:
        self.settings = settings or EventSettings()
        self.s_m = s_m
        self.in_contact = False
        self.moving = False
        self._above = 0
        self._below = 0
        self._last_t = -np.inf
        self._first = (0.0, 0.0)  # time and deflection of the first frame above the threshold
        self._rate = 0.0  # highest rate of the rise so far, used as the speed of the platform [m/s]
        #: Frames of the last travel, as many as :meth:`_motion_onset` needs, and frames with a larger deflection than all
        #: previous ones; bounded, because a contact may last for hours.
        self._window: list[_Row] = []
        self._deeper: list[_Row] = []

    def update(
        self, t_s: float, deflection_m: float, sigma_m: float, travel_m: float | None = None
    ) -> tuple[Event, ...]:
        """Process one frame.

        Parameters
        ----------
        t_s
            Time of the frame [s].
        deflection_m
            Largest deflection of the contact [m].
        sigma_m
            Its standard deviation [m].
        travel_m
            Distance driven by the platform [m]; None: unknown.

        Returns
        -------
        tuple of Event
            Events detected in this frame.
        """
        if not (t_s > self._last_t and np.isfinite(deflection_m)):
            return ()  # late, repeated or empty
        self._last_t = t_s
        c = self.settings
        threshold = max(c.contact_sigmas * sigma_m, c.contact_m)
        if not self.in_contact:
            if deflection_m <= threshold:
                self._above = 0
                return ()
            if self._above == 0:
                self._first = (t_s, deflection_m)
                self._window, self._deeper = [], []
            self._above += 1
            self._remember(t_s, deflection_m, sigma_m, travel_m)
            if self._above < c.confirm_frames:
                return ()
            self.in_contact, self.moving, self._below, self._above = True, False, 0, 0
            return (Event(EventKind.CONTACT, self._first[0], self.s_m),)
        if deflection_m < c.release_fraction * threshold:
            self._below += 1
            if self._below == 1:
                self._first = (t_s, deflection_m)
            if self._below >= c.confirm_frames:
                lost: tuple[Event, ...] = (Event(EventKind.RELEASE, self._first[0], self.s_m),)
                peak = self._deeper[-1]
                # The platform continued and yet the contact was lost: the object ran ahead of it.
                ran_ahead = not self.moving and travel_m is not None and travel_m > peak[3]
                if ran_ahead:
                    lost = (Event(EventKind.MOTION, peak[0], self.s_m), *lost)
                self.in_contact, self.moving, self._rate = False, False, 0.0
                return lost
            return ()
        self._below = 0
        self._remember(t_s, deflection_m, sigma_m, travel_m)
        onset = None if self.moving else self._motion_onset()
        if onset is None:
            return ()
        self.moving = True
        return (Event(EventKind.MOTION, onset, self.s_m),)

    def _remember(self, t_s: float, deflection_m: float, sigma_m: float, travel_m: float | None) -> None:
        before = self._window[-1] if self._window else None
        if travel_m is None:
            if before is not None:
                self._rate = max(self._rate, (deflection_m - before[1]) / (t_s - before[0]))
            travel_m = before[3] + self._rate * (t_s - before[0]) if before else 0.0
        row = (t_s, deflection_m, sigma_m, travel_m)
        if not self._deeper or deflection_m > self._deeper[-1][1]:
            self._deeper.append(row)
        if self.moving:
            self._window.clear()
        self._window.append(row)
        if len(self._window) > _MAX_WINDOW:  # the platform is at rest: every second frame suffices
            del self._window[1:-1:2]

    def _motion_onset(self) -> float | None:
        """Time at which the deflection stopped following the travel, if within the last window [s]."""
        c = self.settings
        t, deflection, sigma, travel = np.array(self._window).T
        inside = np.flatnonzero(travel < travel[-1] - c.motion_travel_m)
        if len(inside) == 0:
            return None
        begin = min(int(inside[-1]), len(t) - c.motion_frames)
        if begin < 0:
            return None
        # A second window is kept: noisy odometry may go back by a little.
        older = np.flatnonzero(travel < travel[-1] - 2.0 * c.motion_travel_m)
        del self._window[: min(begin, int(older[-1]) if len(older) else 0)]
        x, d, s = travel[begin:], deflection[begin:], float(np.mean(sigma[begin:]))
        centred = x - x.mean()
        power = float(centred @ centred)
        slope = float(centred @ d) / power
        # The plateau starts when the deflection first comes within its noise of the later level.
        level = min(float(np.median(d[-max(2, len(d) // 2) :])), float(d.max()))
        reached = next(row for row in self._deeper if row[1] >= level - 2.0 * s)
        # With a soft object the foam deflects by a fraction of the travel: compare with the slope of the rise so far.
        way = reached[3] - self._deeper[0][3]
        rise = min(1.0, level / way) if way > 0 else 1.0
        if slope + c.motion_sigmas * s / np.sqrt(power) >= c.motion_slope * rise:
            return None
        return reached[0]


@dataclass(slots=True)
class _Region:
    low_m: float
    high_m: float
    machine: DeflectionEvents
    seen: bool = field(default=False)


class ContactEvents:
    """One state machine per contact region of a foam strip.

    Frames without a contour (occluded, lost, stale, camera moved) are ignored;
    frames in which only the force is invalid (unloading, saturated) still
    give the position of the object.

    Parameters
    ----------
    settings
        Thresholds of the events; defaults if omitted.
    """

    def __init__(self, settings: EventSettings | None = None) -> None:
        self.settings = settings or EventSettings()
        self._regions: list[_Region] = []
        self._t_s = -np.inf
        self._travel_m = 0.0

    @property
    def in_contact(self) -> bool:
        """Whether any region is in contact."""
        return any(region.machine.in_contact for region in self._regions)

    @property
    def moving(self) -> bool:
        """Whether a touched object moves."""
        return any(region.machine.moving for region in self._regions)

    def update(
        self,
        profile: ForceProfile,
        *,
        travel_m: float | None = None,
        speed_m_s: float | None = None,
        external: Iterable[Event] = (),
    ) -> tuple[Event, ...]:
        """Process one frame.

        Parameters
        ----------
        profile
            The frame's measurement.
        travel_m
            Distance driven by the platform, from odometry [m].
        speed_m_s
            Speed of the platform [m/s], integrated over time if ``travel_m`` is None.
        external
            Falls and slips from the scene tracker, passed through.

        Returns
        -------
        Events detected in this frame, in order of time.
        """
        passed = tuple(external)
        for event in passed:
            if event.kind not in (EventKind.FALL, EventKind.SLIP):
                raise InputError("external", f"found event '{event.kind}', expected fall or slip")
        if not profile.t_s > self._t_s:
            return passed
        if travel_m is None and speed_m_s is not None:
            step = profile.t_s - self._t_s
            self._travel_m += speed_m_s * (step if np.isfinite(step) else 0.0)
            travel_m = self._travel_m
        self._t_s = profile.t_s
        if profile.reason not in _CONTOUR_SEEN:
            return passed
        events = [
            event for region in self._matched(profile) for event in self._step(region, profile, travel_m)
        ]
        self._regions = [r for r in self._regions if r.machine.in_contact or r.seen]
        return tuple(sorted((*events, *passed), key=lambda event: event.t_s))

    def _matched(self, profile: ForceProfile) -> list[_Region]:
        """Regions of this frame: known ones, moved to their present positions, and new ones."""
        gap = self.settings.region_gap_m
        for region in self._regions:
            region.seen = False
        # Deepest first: a region is continued by the main contact, not by a ripple next to it.
        for contact in sorted(profile.contacts, key=lambda one: -float(np.max(one.delta_m, initial=0.0))):
            low, high = contact.s_start_m, contact.s_end_m
            known = [r for r in self._regions if low <= r.high_m + gap and high >= r.low_m - gap]
            if not known:
                if contact.force_N <= self.settings.contact_sigmas * contact.force_sigma_N:
                    continue  # all its points may share an error of light or camera
                machine = DeflectionEvents(self.settings, contact.centre_m)
                self._regions.append(_Region(low, high, machine, True))
                continue
            # Merged contacts continue as the older region; split contacts continue as one region
            # until the strip between them is free again.
            region = known[0]
            region.low_m = min(low, region.low_m) if region.seen else low
            region.high_m = max(high, region.high_m) if region.seen else high
            region.seen = True
            region.machine.s_m = contact.centre_m
        return list(self._regions)

    def _step(self, region: _Region, profile: ForceProfile, travel_m: float | None) -> tuple[Event, ...]:
        inside = (profile.s_m >= region.low_m) & (profile.s_m <= region.high_m) & profile.point_valid
        if not inside.any():
            return ()
        delta, sigma = profile.delta_m[inside], profile.delta_sigma_m[inside]
        # Mean of the three deepest points: less noise than one point, still at the tip of a thin object.
        deepest = np.argsort(delta)[-3:]
        deflection = float(delta[deepest].mean())
        return region.machine.update(profile.t_s, deflection, float(sigma[deepest].mean()), travel_m)
