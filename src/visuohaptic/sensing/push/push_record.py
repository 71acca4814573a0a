"""Record of a push, its phases (Alt 2016, Sec. 4.1), and its stop conditions (3.6.2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Bool, Float

from ...core import Contact, Event, EventKind, ForceProfile, InputError, Reason
from .events import DeflectionEvents, EventSettings


class StopReason(StrEnum):
    """Why the platform has to stop (Alt 2016, Sec. 3.6.2)."""

    DENSIFIED = "densified"  #: (a) the strain exceeds the working range of the foam: fixed
    TOO_HEAVY = "too_heavy"  #: (b) the force reaches the maximum push force of the platform: fixed
    PUSHED_FAR = "pushed_far"  #: (c) pushed by more than the width of the sensor: movable
    FELL = "fell"  #: the object falls: nothing left to measure or push
    UNREAD = "unread"  #: no deflection or force for too many frames: no statement about the object


@dataclass(frozen=True, slots=True)
class StopLimits:
    """Limits of foam and platform."""

    deflection_m: float  #: densification limit of the strain times the thickness of the foam [m]
    force_N: float  #: maximum push force of the platform [N]
    distance_m: float  #: width of the sensor [m]
    max_unread_frames: int = 15  #: consecutive frames without a measurement: half a second at 30 Hz


def reaches_limit(force_N: float, sigma_N: float, max_force_N: float) -> bool:
    """Whether a force plus two sigma reaches the maximum push force of the platform.

    Parameters
    ----------
    force_N, sigma_N
        Force and its standard deviation [N]; NaN (not measured) reaches no limit.
    max_force_N
        Maximum push force of the platform [N].
    """
    return force_N + 2.0 * sigma_N >= max_force_N


def stop_reason(
    deflection_m: float,
    force_N: float,
    pushed_m: float,
    limits: StopLimits,
    *,
    force_sigma_N: float = 0.0,
    unread_frames: int | None = None,
) -> StopReason | None:
    """First stop condition that holds in a frame of a push (Alt 2016, Sec. 3.6.2).

    Parameters
    ----------
    deflection_m
        Largest deflection of the foam [m]; NaN if not measured.
    force_N, force_sigma_N
        Force and its standard deviation [N]; NaN if not measured.
    pushed_m
        Distance by which the object has been pushed since its motion started [m].
    limits
        Limits of foam and platform.
    unread_frames
        Number of consecutive frames without a measurement, including this one. If omitted, the first such frame
        stops the push.

    Returns
    -------
    StopReason or None
        ``None`` while the push may continue.
    """
    if deflection_m >= limits.deflection_m:
        return StopReason.DENSIFIED
    if reaches_limit(force_N, force_sigma_N, limits.force_N):
        return StopReason.TOO_HEAVY
    if pushed_m > limits.distance_m:
        return StopReason.PUSHED_FAR
    read = math.isfinite(deflection_m) and math.isfinite(force_N)
    if not read and (unread_frames is None or unread_frames >= limits.max_unread_frames):
        return StopReason.UNREAD
    return None


@dataclass(frozen=True, slots=True, eq=False)
class PushRecord:
    """One push, N frames in order of time. NaN: not measured."""

    t_s: Float[np.ndarray, "N"]
    force_valid: Bool[np.ndarray, "N"]  #: not unloading, occluded, saturated, ...
    force_N: Float[np.ndarray, "N"]
    force_sigma_N: Float[np.ndarray, "N"]  #: standard deviation of the independent error of each frame
    #: relative standard deviation of the common error of the forces (calibration, model): one value or one per frame
    force_scale_sigma: Float[np.ndarray, "N"] | float
    deflection_m: Float[np.ndarray, "N"]  #: deflection at the deepest part of the contact
    deflection_sigma_m: Float[np.ndarray, "N"]
    travel_m: Float[np.ndarray, "N"]  #: distance driven by the platform along the push
    lateral_m: Float[np.ndarray, "N"]  #: lateral displacement of the platform, left positive
    contact_m: Float[np.ndarray, "N"]  #: centre of pressure along the strip, left positive
    angle_rad: Float[np.ndarray, "N"]  #: orientation of the object in the world, counter-clockwise
    deepest_points_m: Float[np.ndarray, "k 2"] | None = None  #: contour at the largest force [m]

    def __post_init__(self) -> None:
        count = len(self.t_s)
        if count < 2 or not np.all(np.diff(self.t_s) > 0):
            raise InputError("PushRecord", f"found {count} times, expected at least 2 that increase")
        for name in (
            "force_valid", "force_N", "force_sigma_N", "deflection_m", "deflection_sigma_m",
            "travel_m", "lateral_m", "contact_m", "angle_rad",
        ):  # fmt: skip
            if len(getattr(self, name)) != count:
                found = len(getattr(self, name))
                raise InputError("PushRecord", f"found {found} values, expected {count}", field=name)

    def common_sigma(self, frames: np.ndarray) -> float:
        """Relative standard deviation of the common force error, median over some frames.

        Parameters
        ----------
        frames
            Indices or a mask of frames.
        """
        scale = np.broadcast_to(self.force_scale_sigma, self.t_s.shape)[frames]
        known = scale[np.isfinite(scale)]
        return float(np.median(known)) if len(known) else 0.0


def record_push(
    profiles: Sequence[ForceProfile],
    travel_m: Float[np.ndarray, "N"],
    *,
    lateral_m: Float[np.ndarray, "N"] | None = None,
    angle_rad: Float[np.ndarray, "N"] | None = None,
) -> PushRecord:
    """Create the record of a push from the measurements of the foam and the odometry of the platform.

    Parameters
    ----------
    profiles
        Measurements of the foam, in order of time.
    travel_m
        Distance driven by the platform along the push [m].
    lateral_m
        Lateral displacement of the platform, left positive [m]; 0 by default.
    angle_rad
        Orientation of the object in the world [rad], from its tracked features or from the fitted line plus the
        heading of the platform; unobserved by default.
    """
    count = len(profiles)
    if len(travel_m) != count:
        raise InputError("travel_m", f"found {len(travel_m)} values, expected one per profile ({count})")
    columns = np.full((7, count), np.nan)
    scale, deepest, largest = np.full(count, np.nan), None, -np.inf
    for i, profile in enumerate(profiles):
        seen = profile.reason in (Reason.OK, Reason.UNLOADING, Reason.SATURATED)
        delta = np.where(profile.point_valid, profile.delta_m, -np.inf)
        top = np.argsort(delta)[-3:]
        budget = profile.budget
        columns[:, i] = [
            profile.t_s,
            profile.force_N if profile.valid else np.nan,
            np.hypot(budget.image_N, budget.zero_N),
            float(np.mean(profile.delta_m[top])) if seen else np.nan,
            float(np.mean(profile.delta_sigma_m[top])) if seen else np.nan,
            np.nan,
            0.0,
        ]
        main = profile.max_contact
        if seen and main is not None:
            columns[5, i] = _load_centre_m(profile, main)
        if profile.valid and profile.force_N > 0:
            scale[i] = float(np.hypot(budget.calibration_N, budget.model_N) / profile.force_N)
        if profile.valid and profile.force_N > largest:
            largest = profile.force_N
            if main is not None:
                deepest = main.points_foam_m
    nothing = np.full(count, np.nan)
    return PushRecord(
        t_s=columns[0],
        force_valid=np.isfinite(columns[1]),
        force_N=columns[1],
        force_sigma_N=columns[2],
        force_scale_sigma=scale,
        deflection_m=columns[3],
        deflection_sigma_m=columns[4],
        travel_m=np.asarray(travel_m, dtype=float),
        lateral_m=np.zeros(count) if lateral_m is None else np.asarray(lateral_m, dtype=float),
        contact_m=columns[5],
        angle_rad=nothing if angle_rad is None else np.asarray(angle_rad, dtype=float),
        deepest_points_m=deepest,
    )


def _load_centre_m(profile: ForceProfile, contact: Contact) -> float:
    """Centre of pressure of a contact along the strip [m]; without pressures the centre of its deflection."""
    load = np.where(
        (profile.s_m >= contact.s_start_m) & (profile.s_m <= contact.s_end_m), profile.pressure_Pa, 0.0
    )
    total = float(load.sum())
    return float(load @ profile.s_m) / total if total > 0.0 else contact.centre_m


@dataclass(frozen=True, slots=True)
class Phases:
    """Times of the phase boundaries of a push [s]; NaN for events that did not occur."""

    contact_s: float
    motion_s: float
    stop_s: float
    release_s: float

    def rising(self, t_s: np.ndarray) -> np.ndarray:
        """Mask of phase (a): contact until motion, or until the stop without motion.

        Parameters
        ----------
        t_s
            Times [s], (N,).
        """
        end = self.motion_s if np.isfinite(self.motion_s) else self.stop_s
        end = end if np.isfinite(end) else np.inf
        return (t_s >= self.contact_s) & (t_s <= end)

    def pushing(self, t_s: np.ndarray) -> np.ndarray:
        """Mask of phase (b): motion until the platform stops or the contact is lost.

        Parameters
        ----------
        t_s
            Times [s], (N,).
        """
        ends = [e for e in (self.stop_s, self.release_s) if np.isfinite(e)]
        return (t_s > self.motion_s) & (t_s <= min(ends, default=np.inf))

    def stopped(self, t_s: np.ndarray) -> np.ndarray:
        """Mask of phase (c): after the platform has stopped.

        Parameters
        ----------
        t_s
            Times [s], (N,).
        """
        return t_s > self.stop_s


def find_phases(
    record: PushRecord, *, settings: EventSettings | None = None, events: Sequence[Event] | None = None
) -> Phases:
    """Divide a push into phases; given events take precedence over events detected in the deflection.

    The platform has stopped when its travel no longer increases.

    Parameters
    ----------
    record
        The push.
    settings
        Thresholds of the events.
    events
        Known events; if omitted, events are detected in the deflection.
    """
    machine, found = DeflectionEvents(settings), list(events or ())
    if events is None:
        for i in range(len(record.t_s)):
            found += machine.update(
                float(record.t_s[i]), float(record.deflection_m[i]), float(record.deflection_sigma_m[i]),
                float(record.travel_m[i]),
            )  # fmt: skip

    def first(kind: EventKind) -> float:
        return next((event.t_s for event in found if event.kind == kind), float("nan"))

    travelled = record.travel_m - record.travel_m[0]
    contact = first(EventKind.CONTACT)
    stop = float("nan")
    if travelled[-1] > 0:
        # A thousandth of the travel is odometry noise, not motion.
        arrived = np.flatnonzero(travelled >= travelled[-1] - 1e-3 * (travelled[-1] - travelled[0]))
        if arrived[0] < len(record.t_s) - 1:
            stop = float(record.t_s[int(arrived[0])])
    motion = first(EventKind.MOTION)
    if np.isfinite(stop) and motion > stop:
        motion = float("nan")
    return Phases(contact, motion, stop, first(EventKind.RELEASE))
