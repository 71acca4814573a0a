"""Events of the pushed object: its settings and motion, and detection of falls and slips (Alt 2016, Sec. 3.5).

A fall is a tilt above a limit. Tracking may fail before that: when the tracks are lost, the last tilt is
extrapolated with its rate, and a sudden loss together with a loss of the contact force counts as a fall immediately.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from ...core import POSITIVE, Event, EventKind, Pose, Ranged, Reason, at_least, within


@dataclass(frozen=True, slots=True)
class ObjectMotionSettings(Ranged):
    """Settings of the motion estimation, and thresholds of events."""

    min_sigma_px: float = 0.15  #: of a track: interpolation, and a surface that is not exactly plane
    gate_sigmas: float = 4.0  #: inlier threshold in standard deviations
    min_points: int = field(default=8, metadata=at_least(4))
    min_fraction: float = field(
        default=0.4, metadata=within(0.0, 1.0)
    )  #: minimum fraction of the points that must be inliers
    fall_tilt_rad: float = field(default=0.5, metadata=POSITIVE)  #: an object with this tilt does not return
    tilt_seen_rad: float = 0.08  #: an extrapolated tilt after the loss of tracks
    coast_s: float = 0.6  #: maximum duration of that extrapolation
    sudden_fraction: float = 0.4  #: remaining fraction of tracks, below which the loss is sudden
    slip_m: float = 0.006  #: displacement of the contact along the foam that counts as slip
    shape_turn_rad: float = 0.03  #: rotation from which on the motion also determines the surface


@dataclass(frozen=True, slots=True, eq=False)
class ObjectMotion:
    """Motion of the touched object since the start of its tracking, in frame F of the sensor."""

    t_s: float
    valid: bool
    reason: Reason
    shift_m: Float[np.ndarray, "3"]  #: of the point of contact
    turn_rad: float  #: about the vertical, counter-clockwise
    tilt_rad: float  #: between its axis and the vertical, >= 0
    covariance: Float[np.ndarray, "6 6"]  #: of (rotation vector [rad], shift [m]) in F
    points: int  #: number of inliers

    @property
    def turn_sigma_rad(self) -> float:
        """Standard deviation of ``turn_rad``."""
        return float(np.sqrt(self.covariance[2, 2]))


class ObjectEvents:
    """Detects falls and slips of one object; each is reported once.

    Parameters
    ----------
    settings
        Limits of tilt and slip.
    """

    def __init__(self, settings: ObjectMotionSettings) -> None:
        self.settings = settings
        self._tilts: list[tuple[float, float]] = []
        self._happened: set[EventKind] = set()

    @property
    def tilted(self) -> bool:
        """Whether a tilt has been measured."""
        return bool(self._tilts)

    @property
    def stands(self) -> bool:
        """Whether no tilt is detected: then its face may be measured again."""
        return not self._tilts or self._tilts[-1][1] < 0.5 * self.settings.tilt_seen_rad

    def start(self, *, another: bool, keeps_tilt: bool) -> None:
        """Start tracking an object.

        Parameters
        ----------
        another
            Whether it is a new object, without previous events.
        keeps_tilt
            Whether it keeps its previous tilt.
        """
        if another:
            self._happened = set()
        if not keeps_tilt:
            self._tilts = []

    def tilt(self, t_s: float, tilt_rad: float) -> None:
        """Process one measured tilt.

        Parameters
        ----------
        t_s
            Time [s].
        tilt_rad
            Angle between the object's axis and the vertical [rad].
        """
        self._tilts = [*self._tilts[-5:], (t_s, tilt_rad)]

    def update(
        self,
        motion: ObjectMotion,
        face: Pose | None,
        *,
        in_contact: bool,
        force_fraction: float,
        sudden_loss: bool,
    ) -> tuple[Event, ...]:
        """Events of one frame.

        Parameters
        ----------
        motion
            Motion since the contact began.
        face
            The touched surface: x along the contact.
        in_contact
            Whether the foam is in contact with the object; slip is tested only then.
        force_fraction
            Force on the foam as a fraction of its recent maximum.
        sudden_loss
            Whether most of the tracks were lost from one frame to the next.
        """
        found: list[Event] = []
        if EventKind.FALL not in self._happened and self._falls(motion, force_fraction, sudden_loss):
            found.append(Event(EventKind.FALL, motion.t_s))
        if EventKind.SLIP not in self._happened and motion.valid and in_contact and face is not None:
            along = face.rotation[:, 0]
            slip = float(motion.shift_m @ along)
            sigma = math.sqrt(max(float(along @ motion.covariance[3:, 3:] @ along), 0.0))
            if abs(slip) > self.settings.slip_m + 3.0 * sigma and motion.tilt_rad < 0.2:
                found.append(Event(EventKind.SLIP, motion.t_s, float(face.translation_m[1])))
        self._happened |= {event.kind for event in found}
        return tuple(found)

    def _falls(self, motion: ObjectMotion, force_fraction: float, sudden_loss: bool) -> bool:
        s = self.settings
        if motion.valid:
            return motion.tilt_rad > s.fall_tilt_rad
        if not self._tilts:
            return False
        last_t, last = self._tilts[-1]
        if last > s.tilt_seen_rad and motion.t_s - last_t < s.coast_s and len(self._tilts) >= 3:
            return self._carried_on(motion.t_s) > s.fall_tilt_rad
        return sudden_loss and force_fraction < 0.5

    def _carried_on(self, t_s: float) -> float:
        """Extrapolated tilt, growing at least as fast as the last ones."""
        times, tilts = np.array(self._tilts[-4:]).T
        rate = float(np.polyfit(times - times[-1], tilts, 1)[0])
        gain = np.diff(tilts) / np.diff(times)
        speeding = max(0.0, float(gain[-1] - gain[0]) / max(float(times[-1] - times[1]), 1e-3))
        ahead = t_s - float(times[-1])
        return float(tilts[-1]) + max(rate, float(gain[-1])) * ahead + 0.5 * speeding * ahead**2
