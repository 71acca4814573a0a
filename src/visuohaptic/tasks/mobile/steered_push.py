"""Steering of one straight push so that the object reaches its goal pose (Alt 2016, Sec. 4.3.1).

Symbols: y lateral offset of the object's centre of friction from the line of the push (left positive), theta its rotation, e
offset of the contact from that centre, h distance of the centre ahead of the contact, c ratio of the maximum friction moment
to the maximum friction force, w slope of the force to the left of the object's axis, psi heading of the platform to the left
of the push, r its radius. Derivatives are per metre of the push, on an ellipsoidal limit surface (Lee and Cutkosky 1991).
Whether the contact sticks or slides,

    y' = theta + w,    theta' = -(e + h w) / c^2.

A sticking rim moves sideways by u = psi - theta + r psi' and rolls along the face as the platform turns, along an outline of
curvature k less far:

    w = (c^2 u - h e) / (c^2 + h^2),    e' = -r psi' / (1 + k r).

psi' is the control. It minimises the squares of y and theta at the end, relative to their tolerances, plus the squares of w, psi
and r psi' on the way, weighted so that each at its maximum over the length c costs as much (linear quadratic control with finite
horizon, Riccati recursion from the end). Suppressing only the rotation, w = -e / h, would make the object drift sideways by
e / h of its path.

A goal g of the rotation other than zero is the same problem in theta - g, psi - g, and y + g l, with the length l that is left:
all derivatives are unchanged.

Where a face is more oblique than friction permits, w is at the edge of the friction cone. Then theta' is the control, with the
same cost, and the platform steers so that the contact slides along the face until e = -c^2 theta' - h w.

An object with a concavity that the rim bridges turns with the platform, until that takes more moment than friction at the rim
has: theta' = psi', y' = psi + H psi', with H the distance of its centre ahead of the platform's.

The position of the centre of friction is estimated from the same equations: e + h w + c^2 theta' is zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from jaxtyping import Float

from ...core.geometry import rotation_2d, wrap_angle
from ...core.ranges import POSITIVE, Ranged
from ...navigation.problem.push_costs import TURN_LIMIT_RAD
from ...navigation.pushing.push_failure import CENTRE_FRACTION
from ...navigation.pushing.push_model import CONTACT_FRICTION
from .force_guard import ForceGuard, GuardState

Pose = Float[np.ndarray, "3"]
#: Minimum motion of an object for an estimate of its centre of friction [m], and position error of a sighting [m].
MIN_MOTION_M, SEEN_M = 0.005, 0.003
#: Steps of the recursion over the rest of a push: for a push of a metre each is shorter than the lever of a box of 25 cm.
STEPS = 10
#: Number of readings after contact that are the impact on the foam, not friction.
IMPACT_READINGS = 10


class PushEnd(StrEnum):
    """How a push ended."""

    DONE = "done"  #: the object is at its goal
    STALLED = "stalled"  #: the platform makes no progress
    TURNED = "turned"  #: the object rotates too far
    ASTRAY = "astray"  #: its lateral offset exceeds that declared by the plan
    LOST = "lost"  #: contact lost
    MISSED = "missed"  #: no contact
    TIMED_OUT = "timed out"
    TOO_HEAVY = "too heavy"  #: the force remains at the platform's limit
    UNREAD = "force unread"  #: no valid force for too long


@dataclass(frozen=True, slots=True)
class PushSettings(Ranged):
    """Speeds, gains and limits."""

    radius_m: float = field(default=0.17, metadata=POSITIVE)  #: radius of the platform
    speed_m_s: float = field(default=0.05, metadata=POSITIVE)
    approach_m_s: float = field(default=0.08, metadata=POSITIVE)
    search_m: float = field(default=0.12, metadata=POSITIVE)  #: maximum distance without contact
    touch_N: float = 1.0  #: minimum force of a contact
    max_force_N: float = field(default=20.0, metadata=POSITIVE)  #: maximum push force of the platform
    #: tolerances of the object at the end of a push, position [m] and rotation, as assumed by a plan
    end_m: float = field(default=0.01, metadata=POSITIVE)
    end_rad: float = field(default=0.026, metadata=POSITIVE)
    #: whether the platform steers by the object's pose; a flat front keeps to the line, and holds a face that it presses on
    steered: bool = True
    steer_max_rad: float = 0.35
    heading_gain_per_s: float = 3.0
    turn_limit_rad: float = TURN_LIMIT_RAD  #: maximum rotation of the object
    aside_m: float = math.inf  #: maximum lateral offset of the object from the line of the push
    #: curvature of the outline at the contact [1/m]: :func:`~visuohaptic.tasks.mobile.outline_curvature.contact_curvature`
    curvature_per_m: float = 0.0
    lost_m: float = 0.06  #: distance driven without contact after which it is lost
    #: time with less than a quarter of the commanded distance, longer than errors of the localisation
    stall_s: float = field(default=3.0, metadata=POSITIVE)
    timeout_s: float = 120.0


class SteeredPush:
    """Computes velocities from poses, one call per control period.

    Parameters
    ----------
    stand_m
        Position of the platform before the push (x, y) [m].
    direction_rad
        Direction of the push [rad].
    length_m
        Displacement of the object [m].
    turn_rad
        Rotation of the object at its goal [rad].
    object_m
        Pose of the object (x, y of its centroid, yaw); ``None`` if it cannot be located: then the push is straight.
    offset_m
        Centre of friction from the centroid, in the object's frame.
    lever_m
        c, ratio of the maximum friction moment to the maximum friction force [m].
    settings
        Speeds, gains and limits.
    """

    def __init__(
        self,
        stand_m: Float[np.ndarray, "2"],
        direction_rad: float,
        length_m: float,
        *,
        turn_rad: float = 0.0,
        object_m: Pose | None = None,
        offset_m: Float[np.ndarray, "2"] | None = None,
        lever_m: float = 0.1,
        settings: PushSettings | None = None,
    ) -> None:
        self.settings = settings if settings is not None else PushSettings()
        self._ahead = np.array([math.cos(direction_rad), math.sin(direction_rad)])
        self._left = np.array([-self._ahead[1], self._ahead[0]])
        self._stand, self._direction, self._length_m = np.asarray(stand_m), direction_rad, length_m
        self._turn_rad = turn_rad
        self._first = self._seen = object_m
        self._offset = np.zeros(2) if offset_m is None else np.asarray(offset_m)
        self._lever_m = max(lever_m, 0.02)
        bend = 1.0 / self.settings.radius_m + self.settings.curvature_per_m
        #: Distance that the contact moves along the outline per rotation of the platform; infinite in a concavity.
        self._roll_m = 1.0 / bend if bend > 1e-6 else math.inf
        self._guard = ForceGuard(self.settings.max_force_N)
        self._touch_place: Pose | None = None
        self._last_touch: Pose | None = None
        self._last: tuple[float, Pose] | None = None
        self._start_t = math.nan
        self._anchor: tuple[float, Pose] | None = None
        self._stalled = False
        self._forces: list[float] = []
        #: Integral of e + h w over the path of the object, and length of that path.
        self._arm_m2 = self._way_m = 0.0
        self._rim = self.settings.radius_m * self._ahead  #: contact point relative to the platform's centre
        self._explained: Pose | None = object_m  #: pose of the object up to which the integral goes
        self.end: PushEnd | None = None

    @property
    def touched(self) -> bool:
        """Whether the object was touched."""
        return self._touch_place is not None

    @property
    def force_N(self) -> tuple[float, float]:
        """Largest force that lasted a tenth of a second, and the median of the remaining forces; NaN without contact.

        The impact of the first contact is excluded. A force lasts if four of five readings are at least as large, so
        that the peaks of a rattling contact do not count.
        """
        if not self._forces:
            return math.nan, math.nan
        kept = np.array(self._forces[IMPACT_READINGS:] or self._forces)
        lasting = [float(np.sort(kept[i : i + 5])[:2][-1]) for i in range(max(1, len(kept) - 4))]
        return max(lasting), float(np.median(kept[len(kept) // 3 :]))

    @property
    def is_impact(self) -> bool:
        """Whether it has lasted no longer than the first contact."""
        return len(self._forces) <= IMPACT_READINGS

    @property
    def turned_rad(self) -> float:
        """Rotation of the object since the start of the push [rad]."""
        if self._first is None or self._seen is None:
            return 0.0
        return wrap_angle(float(self._seen[2] - self._first[2]))

    @property
    def moved_m(self) -> Float[np.ndarray, "2"]:
        """Displacement of the object (ahead, left) [m]; that of the platform where the object was not located."""
        if self._first is not None and self._seen is not None:
            shift = self._seen[:2] - self._first[:2]
        elif self._touch_place is not None and self._last is not None:
            shift = self._last[1][:2] - self._touch_place[:2]
        else:
            return np.zeros(2)
        return np.array([shift @ self._ahead, shift @ self._left])

    def centre_offset_m(self) -> float | None:
        """Offset of the centre of friction to the left of its prior estimate [m]; ``None`` after a short push."""
        return None if self._way_m < 0.08 else self._offset_m()

    def _offset_m(self) -> float:
        """Posterior mean of that offset [m]."""
        if self._way_m <= 0.0:
            return 0.0
        seen = (self._arm_m2 + self._lever_m**2 * self.turned_rad) / self._way_m
        noise = SEEN_M * self._lever_m / self._way_m
        prior = CENTRE_FRACTION * self._lever_m
        return seen * prior**2 / (prior**2 + noise**2)

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
            Time [s].
        pose_m
            Pose of the platform in the map frame.
        force_N, contact_m
            Force on the rim and contact point; 0 and ``None`` without contact, a NaN force if not measured.
        seen_m
            Present pose of the object; ``None`` if it is not located.
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
            target = max(-0.3, min(0.3, -4.0 * beside))
            speed = s.approach_m_s if s.speed_m_s < s.approach_m_s else s.speed_m_s
        else:
            speed = s.speed_m_s * self._guard.speed_fraction
            if self._seen is not None and s.steered:
                return speed, max(-0.6, min(0.6, speed * self._turn_per_m(pose_m, heading, contact_m)))
            beside = float((pose_m[:2] - self._stand) @ self._left)
            target = max(-0.3, min(0.3, -4.0 * beside))
        error = target - heading
        if abs(error) > 0.5:
            self._anchor = (t_s, pose_m)
            return 0.0, math.copysign(0.4, error)
        return speed * math.cos(error), max(-0.6, min(0.6, s.heading_gain_per_s * error))

    def _follow(self, t_s: float, pose_m: Pose, force_N: float) -> None:
        """Update contact, progress and stall detection."""
        assert self._last is not None
        assert self._anchor is not None
        s = self.settings
        step = float(np.hypot(*(pose_m[:2] - self._last[1][:2])))
        if step > 0.004:
            self._last = (t_s, pose_m)
        elapsed_s = t_s - self._anchor[0]
        if elapsed_s >= s.stall_s:
            driven = float((pose_m[:2] - self._anchor[1][:2]) @ self._ahead)
            self._stalled = driven < 0.25 * s.speed_m_s * elapsed_s
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
        if abs(self.moved_m[1]) > s.aside_m:
            return PushEnd.ASTRAY
        assert self._last_touch is not None
        if float(np.hypot(*(pose_m[:2] - self._last_touch[:2]))) > s.lost_m:
            return PushEnd.LOST
        return PushEnd.STALLED if self._stalled else None

    def _turn_per_m(self, pose_m: Pose, heading: float, contact_m: tuple[float, float] | None) -> float:
        """Rotation of the platform per metre of the push [rad/m]."""
        assert self._seen is not None
        assert self._first is not None
        s, square = self.settings, self._lever_m**2
        centre, turned = self._centre_m(self._seen), self.turned_rad
        if contact_m is not None:
            self._rim = np.array(contact_m) - pose_m[:2]
        axis = rotation_2d(turned) @ self._ahead
        left = max(self._length_m - float(self.moved_m[0]), MIN_MOTION_M)
        aside = float((centre - self._centre_m(self._first)) @ self._left) + self._turn_rad * left
        short = turned - self._turn_rad
        if math.isinf(self._roll_m):
            return self._turning(
                np.array([short, aside, heading - self._turn_rad]), centre - pose_m[:2], left
            )
        off = centre - pose_m[:2] - self._rim
        high = max(float(off @ axis), 0.05)
        beside = float(axis[1] * off[0] - axis[0] * off[1])
        self._explain(high, beside)
        beside -= self._offset_m()
        # Slope of the normal of the round rim at the contact, less the part that friction holds.
        slope = float(
            (axis[0] * self._rim[1] - axis[1] * self._rim[0]) / max(self._rim @ axis, 0.5 * s.radius_m)
        )
        slope -= max(-CONTACT_FRICTION, min(CONTACT_FRICTION, slope))
        if not slope:
            return self._sticking(np.array([short, aside, beside, heading - self._turn_rad]), high, left)
        rates = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
        cost = np.diag([0.0, 0.0, (self._lever_m / CONTACT_FRICTION) ** 2])
        rate = self._controlled(np.array([short, aside + slope * left]), rates, cost, left)
        slide = -(square * rate + high * slope + beside) / (0.5 * self._lever_m)
        target = turned + slope * (1.0 + high**2 / square) + high * beside / square + slide
        target = max(-s.steer_max_rad, min(s.steer_max_rad, target))
        return (target - heading) / s.radius_m

    def _turning(self, state: Float[np.ndarray, "3"], centre: Float[np.ndarray, "2"], left_m: float) -> float:
        """psi' for an object that turns with the platform, from the state theta, y, psi and its centre from the platform's."""
        s = self.settings
        rates = np.zeros((3, 4))
        rates[:, 3] = 1.0, float(np.hypot(*centre)), 1.0
        rates[1, 2] = 1.0
        moment = self._lever_m**2 / (CONTACT_FRICTION * s.radius_m)
        return self._controlled(state, rates, np.diag([0.0, 0.0, s.steer_max_rad**-2, moment**2]), left_m)

    def _sticking(self, state: Float[np.ndarray, "4"], high: float, left_m: float) -> float:
        """psi' for a sticking contact, from the state theta, y, e, psi."""
        s, square = self.settings, self._lever_m**2
        aside = np.array([-1.0, 0.0, 0.0, 1.0, s.radius_m])  # u
        beside = np.array([0.0, 0.0, 1.0, 0.0, 0.0])
        slope = (square * aside - high * beside) / (square + high**2)  # w
        rates = np.zeros((4, 5))
        rates[0] = -(beside + high * aside) / (square + high**2)
        rates[1] = slope
        rates[1, 0] += 1.0
        rates[2:, 4] = -self._roll_m, 1.0
        cost = np.outer(slope, slope) / CONTACT_FRICTION**2
        cost[3, 3] += 1.0 / s.steer_max_rad**2
        cost[4, 4] += (s.radius_m / CONTACT_FRICTION) ** 2
        return self._controlled(state, rates, cost, left_m)

    def _controlled(
        self,
        state: Float[np.ndarray, "n"],
        rates: Float[np.ndarray, "n m"],
        cost: Float[np.ndarray, "m m"],
        left_m: float,
    ) -> float:
        """Linear quadratic control of a state (theta and y first); the last column of rates and cost is the control."""
        count, step = len(state), left_m / STEPS
        move = np.eye(count, count + 1) + step * rates
        cost = cost * (step / self._lever_m)
        value = np.zeros((count, count))
        value[0, 0], value[1, 1] = self.settings.end_rad**-2, self.settings.end_m**-2
        for _ in range(STEPS):
            both = cost + move.T @ value @ move
            gain = both[count, :count] / both[count, count]
            value = both[:count, :count] - np.outer(both[:count, count], gain)
        return -float(gain @ state)

    def _centre_m(self, object_m: Pose) -> Float[np.ndarray, "2"]:
        """Estimated centre of friction for a pose of the object [m]."""
        return np.asarray(object_m[:2] + rotation_2d(float(object_m[2])) @ self._offset)

    def _explain(self, high_m: float, beside_m: float) -> None:
        """Update the estimate of the centre of friction with the last motion of the object."""
        assert self._seen is not None
        assert self._explained is not None
        step = self._centre_m(self._seen) - self._centre_m(self._explained)
        way = float(step @ self._ahead)
        if way < MIN_MOTION_M:
            return
        slope_m = float(step @ self._left) - self.turned_rad * way
        self._arm_m2 += beside_m * way + high_m * slope_m
        self._way_m += way
        self._explained = self._seen
