"""One straight push, steered so that the object does not turn away (Alt 2016, Sec. 4.3.1).

A round platform holds nothing sideways: pushed beside its centre of friction
an object turns, which brings the contact still farther beside it. Per metre of
the push the object turns by

    d theta / ds = -(e + h delta) / c^2

with e the contact's distance beside the centre (to the left), h the centre's
distance ahead of it, delta the angle of the drive to the left of the push and
c the largest friction moment by force. The platform steers by
delta = (c^2 K (theta + I) - e) / h, I the integral of theta, so that theta falls as
exp(-K s) whether the contact sticks to the rim or slides along it. Where the
centre of friction is follows from the same equation once the push is done.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from jaxtyping import Float

from ...core.geometry import wrap_angle
from ...core.ranges import POSITIVE, check_ranges
from .force_guard import ForceGuard, GuardState

__all__ = ["PushEnd", "PushSettings", "SteeredPush"]

Pose = Float[np.ndarray, "3"]
#: Readings after the first touch that are the foam's blow, not friction.
FIRST_BLOW = 10


class PushEnd(StrEnum):
    """How a push ended."""

    DONE = "done"  #: the object is where it was to go
    STALLED = "stalled"  #: the platform does not get on
    TURNED = "turned"  #: the object turns away
    LOST = "lost"  #: it is not touched any more
    MISSED = "missed"  #: it was never touched
    TIMED_OUT = "timed out"
    TOO_HEAVY = "too heavy"  #: the force stays at the platform's limit
    UNREAD = "force unread"  #: the force was not read for too long


@dataclass(frozen=True, slots=True)
class PushSettings:
    """Speeds, gains and limits."""

    radius_m: float = field(default=0.17, metadata=POSITIVE)  #: of the platform
    speed_m_s: float = field(default=0.05, metadata=POSITIVE)
    approach_m_s: float = field(default=0.08, metadata=POSITIVE)
    search_m: float = field(default=0.12, metadata=POSITIVE)  #: of the drive without a touch
    touch_N: float = 1.0  #: force that counts as touch
    max_force_N: float = field(default=20.0, metadata=POSITIVE)  #: what the platform can push
    turn_gain_per_m: float = 6.0  #: K
    integral_per_m: float = 2.0  #: I grows by theta per metre times this
    steer_max_rad: float = 0.35
    heading_gain_per_s: float = 3.0
    turn_limit_rad: float = 0.5  #: the object has turned away
    lost_m: float = 0.06  #: driven without touch
    #: time with less than a quarter of the commanded distance: localisation wanders by some
    stall_s: float = field(default=3.0, metadata=POSITIVE)
    timeout_s: float = 120.0

    def __post_init__(self) -> None:
        check_ranges(self)


class SteeredPush:
    """Velocities from poses, one call per period.

    Parameters
    ----------
    stand_m
        Where the platform stands before the push.
    direction_rad
        Of the push.
    length_m
        Displacement of the object [m].
    object_m
        Where it is (x, y of its centroid, yaw); ``None`` when it cannot be seen: then the push goes straight.
    offset_m
        Centre of friction from the centroid, in the object's frame.
    lever_m
        c, largest friction moment by force.
    settings
        Speeds, gains and limits.
    """

    def __init__(
        self,
        stand_m: Float[np.ndarray, "2"],
        direction_rad: float,
        length_m: float,
        *,
        object_m: Pose | None = None,
        offset_m: Float[np.ndarray, "2"] | None = None,
        lever_m: float = 0.1,
        settings: PushSettings | None = None,
    ) -> None:
        self.settings = settings if settings is not None else PushSettings()
        self._ahead = np.array([math.cos(direction_rad), math.sin(direction_rad)])
        self._left = np.array([-self._ahead[1], self._ahead[0]])
        self._stand, self._direction, self._length_m = np.asarray(stand_m), direction_rad, length_m
        self._first = self._seen = object_m
        self._offset = np.zeros(2) if offset_m is None else np.asarray(offset_m)
        self._lever_m = max(lever_m, 0.02)
        self._guard = ForceGuard(self.settings.max_force_N)
        self._integral = 0.0
        self._touch_place: Pose | None = None
        self._last_touch: Pose | None = None
        self._last: tuple[float, Pose] | None = None
        self._start_t = math.nan
        self._anchor: tuple[float, Pose] | None = None
        self._stalled = False
        self._forces: list[float] = []
        self._arms: list[float] = []
        self.end: PushEnd | None = None

    @property
    def touched(self) -> bool:
        """Whether the object was touched."""
        return self._touch_place is not None

    @property
    def force_N(self) -> tuple[float, float]:
        """Largest force that lasted a tenth of a second, and the median of the rest; NaN without touch.

        The blow of the first touch is left out. What lasted is what four of five readings have at least:
        a contact that rattles is not stronger for its peaks.
        """
        if not self._forces:
            return math.nan, math.nan
        kept = np.array(self._forces[FIRST_BLOW:] or self._forces)
        lasting = [float(np.sort(kept[i : i + 5])[:2][-1]) for i in range(max(1, len(kept) - 4))]
        return max(lasting), float(np.median(kept[len(kept) // 3 :]))

    @property
    def turned_rad(self) -> float:
        """Turn of the object since the push started."""
        if self._first is None or self._seen is None:
            return 0.0
        return wrap_angle(float(self._seen[2] - self._first[2]))

    @property
    def moved_m(self) -> Float[np.ndarray, "2"]:
        """Displacement of the object as it was seen: ahead, left [m]; that of the platform where it was not."""
        if self._first is not None and self._seen is not None:
            shift = self._seen[:2] - self._first[:2]
        elif self._touch_place is not None and self._last is not None:
            shift = self._last[1][:2] - self._touch_place[:2]
        else:
            return np.zeros(2)
        return np.array([shift @ self._ahead, shift @ self._left])

    def centre_beside_m(self) -> float | None:
        """Centre of friction to the left of where it was estimated, by the turn of the push [m]; ``None`` from a short one."""
        ahead = float(self.moved_m[0])
        if len(self._arms) < 50 or ahead < 0.08:
            return None
        return float(np.mean(self._arms)) + self._lever_m**2 * self.turned_rad / ahead

    def command(
        self,
        t_s: float,
        pose_m: Pose,
        force_N: float,
        contact_m: tuple[float, float] | None,
        seen_m: Pose | None,
    ) -> tuple[float, float]:
        """Speed [m/s] and turn rate [rad/s] for the next period; (0, 0) when the push has ended.

        Parameters
        ----------
        t_s
            Time.
        pose_m
            Of the platform, map frame.
        force_N, contact_m
            What its rim feels, and where; 0 and ``None`` without touch, a NaN force when it was not read.
        seen_m
            Where the object is now; ``None`` when it is not seen now.
        """
        s = self.settings
        if math.isnan(self._start_t):
            self._start_t = t_s
            self._last = self._anchor = (t_s, pose_m)
        if seen_m is not None and self._first is not None:
            self._seen = seen_m
        self._follow(t_s, pose_m, force_N)
        allowed = self._guard.update(force_N)
        self.end = self._ended(t_s, pose_m)
        if self.end is None and allowed in (GuardState.TOO_HEAVY, GuardState.UNREAD):
            self.end = PushEnd(allowed.value)
        if self.end is not None or allowed is GuardState.HOLD:
            return 0.0, 0.0
        heading = wrap_angle(float(pose_m[2]) - self._direction)
        if self._touch_place is None:
            beside = float((pose_m[:2] - self._stand) @ self._left)
            wanted = max(-0.3, min(0.3, -4.0 * beside))
            speed = s.approach_m_s if s.speed_m_s < s.approach_m_s else s.speed_m_s
        else:
            wanted = self._steer(pose_m, heading, contact_m)
            speed = s.speed_m_s
        error = wanted - heading
        if abs(error) > 0.5:
            self._anchor = (t_s, pose_m)
            return 0.0, math.copysign(0.4, error)
        return speed * math.cos(error), max(-0.6, min(0.6, s.heading_gain_per_s * error))

    def _follow(self, t_s: float, pose_m: Pose, force_N: float) -> None:
        """Touch, progress and stall."""
        assert self._last is not None
        assert self._anchor is not None
        s = self.settings
        step = float(np.hypot(*(pose_m[:2] - self._last[1][:2])))
        if step > 0.004:
            self._last = (t_s, pose_m)
            if self._touch_place is not None:
                self._integral += s.integral_per_m * self.turned_rad * step
        passed_s = t_s - self._anchor[0]
        if passed_s >= s.stall_s:
            driven = float((pose_m[:2] - self._anchor[1][:2]) @ self._ahead)
            self._stalled = driven < 0.25 * s.speed_m_s * passed_s
            self._anchor = (t_s, pose_m)
        if force_N >= s.touch_N:
            if self._touch_place is None:
                self._touch_place = pose_m
                self._anchor = (t_s, pose_m)
            self._last_touch = pose_m
            self._forces.append(force_N)

    def _ended(self, t_s: float, pose_m: Pose) -> PushEnd | None:
        s = self.settings
        if t_s - self._start_t > s.timeout_s:
            return PushEnd.TIMED_OUT
        if self._touch_place is None:
            if float((pose_m[:2] - self._stand) @ self._ahead) > s.search_m:
                return PushEnd.MISSED
            return PushEnd.STALLED if self._stalled else None
        driven = float((pose_m[:2] - self._touch_place[:2]) @ self._ahead)
        if self.moved_m[0] >= self._length_m or driven > self._length_m + s.lost_m:
            return PushEnd.DONE
        if abs(self.turned_rad) > s.turn_limit_rad:
            return PushEnd.TURNED
        assert self._last_touch is not None
        if float(np.hypot(*(pose_m[:2] - self._last_touch[:2]))) > s.lost_m:
            return PushEnd.LOST
        return PushEnd.STALLED if self._stalled else None

    def _steer(self, pose_m: Pose, heading: float, contact_m: tuple[float, float] | None) -> float:
        """Angle of the drive to the left of the push."""
        s = self.settings
        if self._seen is None:
            beside = float((pose_m[:2] - self._stand) @ self._left)
            return max(-0.3, min(0.3, -4.0 * beside))
        cos, sin = math.cos(self._seen[2]), math.sin(self._seen[2])
        aside = np.array(
            [
                cos * self._offset[0] - sin * self._offset[1],
                sin * self._offset[0] + cos * self._offset[1],
            ]
        )
        rim = pose_m[:2] + s.radius_m * self._ahead if contact_m is None else np.array(contact_m)
        off = self._seen[:2] + aside - rim
        high = max(float(off @ self._ahead), 0.05)
        beside = -float(off @ self._left)
        # Counted from the estimated centre: what the angle of the drive adds to the arm.
        self._arms.append(beside + high * heading)
        wanted = (self._lever_m**2 * s.turn_gain_per_m * (self.turned_rad + self._integral) - beside) / high
        return max(-s.steer_max_rad, min(s.steer_max_rad, wanted))
