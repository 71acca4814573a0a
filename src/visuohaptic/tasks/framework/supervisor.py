"""An independent layer that every command to a robot passes: limits, force stop, stale and wrong clocks.

The supervisor knows nothing of the tasks. It wraps the parts of a robot and what its sensors are read with
(:meth:`Supervisor.base`, :meth:`~Supervisor.arm`, :meth:`~Supervisor.gripper`, :meth:`~Supervisor.frames`,
:meth:`~Supervisor.force`); tasks are given the wrapped parts and notice nothing as long as all is well.

- Speeds are reduced to the limits, both velocities of a base alike; targets out of reach are refused.
- A force that is at the limit, or will be before the robot stands, stops what moves within the same reading.
  Then only a retreat passes, until the force is below the limit again.
- A reading is *fresh* when its own time is newer than before, and what it holds is not a frozen copy. While a part
  moves, its own state and every sensor in use must be fresh; otherwise the part is held, and goes on when they are.
- A clock that jumps, and a hold that lasts, are for good: every later reading or command raises
  :class:`~visuohaptic.core.errors.DeviceError`, which ends a task with its text as the reason.

Time is the supervisor's own: the monotonic clock of the host, or of the host of a simulated robot.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol, TypeVar, runtime_checkable

from ...core.errors import DeviceError
from ...core.ranges import POSITIVE, check_ranges
from ...core.resources import Closing

__all__ = ["SafetyHold", "SafetyLimits", "SupervisedPart", "SupervisorCore"]

RequestT = TypeVar("RequestT")
Point = tuple[float, float, float]
#: Checks per second of the supervisor's own thread [Hz].
CHECK_RATE_HZ = 50.0


@dataclass(frozen=True, slots=True)
class SafetyLimits:
    """What no command may exceed."""

    max_force_N: float = field(default=20.0, metadata=POSITIVE)
    max_speed_m_s: float = field(default=0.5, metadata=POSITIVE)  #: of the base
    max_turn_rate_rad_s: float = field(default=1.5, metadata=POSITIVE)
    max_tip_speed_m_s: float = field(default=0.25, metadata=POSITIVE)
    max_contact_m_s: float = field(
        default=0.05, metadata=POSITIVE
    )  #: of a tip that may touch known obstacles
    max_finger_speed_m_s: float = field(default=0.15, metadata=POSITIVE)  #: rate of the gripper's opening
    min_tip_m: Point = (
        -math.inf,
        -math.inf,
        -math.inf,
    )  #: corners of the box that the tip may enter, in the base
    max_tip_m: Point = (math.inf, math.inf, math.inf)
    #: Age of a reading at which motion is held [s]; a check later it is stopped, in less than 0.2 s altogether.
    max_age_s: float = field(default=0.15, metadata=POSITIVE)
    max_jump_s: float = field(default=0.5, metadata=POSITIVE)  #: of a clock against the supervisor's own
    max_leap_m: float = field(
        default=0.05, metadata=POSITIVE
    )  #: of a state beyond what its speed limit allows
    max_hold_s: float = field(default=5.0, metadata=POSITIVE)  #: a hold that lasts longer is for good
    brake_s: float = 0.1  #: from full speed to a stand; the force on the way is foreseen from its rate

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True, slots=True)
class SafetyHold:
    """One stop by the supervisor."""

    t_s: float  #: by the supervisor's clock
    part: str  #: that was moving
    reason: str


@runtime_checkable
class SupervisedPart(Protocol):
    """What the supervisor knows of a part of the robot."""

    name: str

    def carry_out(self) -> None:
        """Give the requested command to the device."""

    def halt(self) -> None:
        """Stop the device."""

    def pressing(self) -> object:
        """What is remembered of the requested motion when the force reaches the limit."""

    def retreats(self, pressing: object) -> bool:
        """Whether the requested motion leaves what it pressed against.

        Parameters
        ----------
        pressing
            As :meth:`pressing` has returned it.
        """


class _Stream:
    """Freshness of one sensor or state by the supervisor's clock.

    Parameters
    ----------
    name
        For messages.
    max_jump_s
        Of its clock against the supervisor's own [s].
    """

    def __init__(self, name: str, max_jump_s: float) -> None:
        self.name, self._max_jump_s = name, max_jump_s
        self.read_s = self.fresh_s = -math.inf  #: when the newest reading came, and the newest fresh one
        self._t_s, self._ahead_s = -math.inf, -math.inf

    def note(self, now_s: float, t_s: float, frozen: bool) -> str:
        """Take a reading; returns what is wrong with its clock."""
        self.read_s = now_s
        if not math.isfinite(t_s):
            return ""
        ahead_s = t_s - now_s
        if math.isfinite(self._t_s):
            back_s, jump_s = self._t_s - t_s, ahead_s - self._ahead_s
            if back_s > self._max_jump_s or jump_s > self._max_jump_s:
                return f"the clock of {self.name} jumped by {jump_s:+.3g} s"
        self._ahead_s = max(self._ahead_s, ahead_s)
        if t_s > self._t_s and not frozen:
            self.fresh_s = now_s
        self._t_s = max(t_s, self._t_s)
        return ""


@dataclass(slots=True)
class _Motion:
    """What a part is doing."""

    part: SupervisedPart
    moving: bool = False  #: a motion is requested
    held: str = ""  #: why it is not carried out
    since_s: float = -math.inf  #: when the motion was requested
    held_since_s: float = math.nan
    pressing: object = None  #: the motion at which the force reached the limit


class SupervisorCore(Closing):
    """Decides which motion is carried out; :class:`~.supervised_parts.Supervisor` wraps the parts around it.

    Parameters
    ----------
    limits
        What no command may exceed.
    clock
        Monotonic time [s] that does not depend on the robot. With another clock than the host's, as that of a
        simulated world, no thread checks: :meth:`check` is called as that time passes.
    """

    def __init__(
        self, limits: SafetyLimits | None = None, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.limits = limits or SafetyLimits()
        self.holds: list[SafetyHold] = []  #: every stop, in order
        self.odometry = 0  #: how often the base's pose was another one than before
        self.fault = ""  #: why the robot is stopped for good
        self._clock, self._lock = clock, threading.RLock()
        self._streams: dict[str, _Stream] = {}
        self._motions: dict[str, _Motion] = {}
        self._force = (-math.inf, -math.inf)  #: time of the newest reading, and the force [N]
        self._rate_N_s, self._felt_s = 0.0, math.nan
        self._overload = ""
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None
        if clock is time.monotonic:
            self._thread = threading.Thread(target=self._watch, name="supervisor", daemon=True)
            self._thread.start()

    def now_s(self) -> float:
        """Time of the supervisor [s]."""
        return self._clock()

    def check(self) -> None:
        """Hold every part whose readings are too old; called at least every 50 ms."""
        with self._lock:
            now_s = self._clock()
            if self._rate_N_s and not self._overload:
                self._judge_force(now_s - self._felt_s)  # it rises although nobody has read it
            for motion in self._motions.values():
                if not motion.moving:
                    continue
                if not motion.held and (stale := self._stale(motion, now_s)):
                    self._hold(motion, now_s, stale)
                elif motion.held and now_s - motion.held_since_s > self.limits.max_hold_s:
                    self._fail(f"{motion.held}, for {now_s - motion.held_since_s:.1f} s")

    def close(self) -> None:
        """Stop every part and the supervisor's thread; harmless when repeated."""
        self._ended.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()
        with self._lock:
            for motion in self._motions.values():
                if motion.moving:
                    self.release(motion.part)

    def carries_out(self, part: SupervisedPart) -> bool:
        """Whether a requested motion of a part is under way.

        Parameters
        ----------
        part
            Of the robot.
        """
        motion = self._motions[part.name]
        return motion.moving and not motion.held

    def register(self, part: SupervisedPart) -> None:
        """Take a part.

        Parameters
        ----------
        part
            Of the robot; its name, which is that of its own state's readings, is numbered where it is taken.
        """
        number = sum(name.partition(" #")[0] == part.name for name in self._motions)
        part.name += f" #{number + 1}" if number else ""
        self._motions[part.name] = _Motion(part)

    def release(self, part: SupervisedPart) -> None:
        """The part is to stand; always carried out.

        Parameters
        ----------
        part
            Of the robot.
        """
        with self._lock:
            motion = self._motions[part.name]
            motion.moving, motion.held, motion.held_since_s = False, "", math.nan
            part.halt()

    def request(self, part: SupervisedPart) -> None:
        """The part is to move as its request says: carried out, or held.

        Parameters
        ----------
        part
            Of the robot.

        Raises
        ------
        DeviceError
            The robot is stopped for good.
        """
        with self._lock:
            now_s, motion = self._clock(), self._motions[part.name]
            self._raise()
            if not motion.moving:
                motion.moving, motion.since_s = True, now_s
            reason = self._stale(motion, now_s) or self._pressed(motion)
            if reason:
                self._hold(motion, now_s, reason)
            else:
                motion.held, motion.held_since_s = "", math.nan
                part.carry_out()

    def note(self, name: str, t_s: float, *, frozen: bool = False, jumped: str = "") -> None:
        """Take a reading of a sensor or of a part's state.

        Parameters
        ----------
        name
            Of what was read.
        t_s
            Its own time [s]; NaN: it was not read.
        frozen
            It is a copy of the last one although it may not be.
        jumped
            What makes the reading impossible; empty when it is not.

        Raises
        ------
        DeviceError
            The robot is stopped for good.
        """
        with self._lock:
            now_s = self._clock()
            stream = self._streams.setdefault(name, _Stream(name, self.limits.max_jump_s))
            if wrong := stream.note(now_s, t_s, frozen) or jumped:
                self._fail(wrong)
            self._resume(now_s)
            self.check()
            self._raise()

    def note_force(self, t_s: float, force_N: float, *, frozen: bool = False) -> None:
        """Take a force; what moves is stopped before this returns when the limit is reached.

        Parameters
        ----------
        t_s
            Of the reading [s].
        force_N
            Its size [N]; NaN: it was not read; infinite: foam is full.
        frozen
            It is a copy of the last one although it may not be.
        """
        with self._lock:
            last_s, last_N = self._force
            if not math.isnan(force_N) and t_s > last_s:
                rose_N = force_N - last_N if math.isfinite(last_s + last_N) else 0.0
                self._rate_N_s = max(rose_N / (t_s - last_s), 0.0)
                self._force, self._felt_s = (t_s, force_N), self._clock()
                # Until the next reading, which takes as long as this one has.
                self._judge_force(t_s - last_s if self._rate_N_s else 0.0)
        self.note("the force", math.nan if math.isnan(force_N) else t_s, frozen=frozen)

    def _judge_force(self, passed_s: float) -> None:
        """Stop what presses at the limit, now or in ``passed_s`` and half the time in which it brakes evenly."""
        limit_N, was = self.limits.max_force_N, self._overload
        force_N = self._force[1]
        soon_N = force_N + self._rate_N_s * (passed_s + 0.5 * self.limits.brake_s)
        self._overload = ""
        if max(force_N, soon_N) >= limit_N:
            more = "" if force_N >= limit_N else f", and {soon_N:.1f} N before it stands"
            self._overload = f"the force is {force_N:.1f} N{more}, the limit {limit_N:g} N"
        for motion in self._motions.values():
            if self._overload and not was:
                motion.pressing = motion.part.pressing() if motion.moving and not motion.held else None
            if motion.moving and not motion.held and (reason := self._pressed(motion)):
                self._hold(motion, self._clock(), reason)

    def _pressed(self, motion: _Motion) -> str:
        """Why a motion is held by the force; empty where it may go on."""
        if not self._overload or motion.pressing is None or motion.part.retreats(motion.pressing):
            return ""
        return self._overload

    def _stale(self, motion: _Motion, now_s: float) -> str:
        """Which reading of those that a motion depends on is too old; empty when none is."""
        max_age_s = self.limits.max_age_s
        for stream in self._streams.values():
            own, in_use = stream.name == motion.part.name, stream.read_s >= motion.since_s - max_age_s
            if not own and (not in_use or stream.name in self._motions):
                continue
            # What nobody has read may be read soon; what was read and is not fresh says that it fails.
            from_s = (
                max(stream.fresh_s, motion.since_s) if stream.read_s == stream.fresh_s else stream.fresh_s
            )
            if now_s - from_s >= max_age_s:
                return f"{stream.name} has not been read anew for {now_s - from_s:.2f} s"
        if motion.part.name not in self._streams and now_s - motion.since_s >= max_age_s:
            return f"{motion.part.name} has never been read"
        return ""

    def _hold(self, motion: _Motion, now_s: float, reason: str) -> None:
        if not motion.held:
            motion.held_since_s = now_s
            self.holds.append(SafetyHold(now_s, motion.part.name, reason))
        motion.held = reason
        motion.part.halt()

    def _resume(self, now_s: float) -> None:
        """Carry out what was held, where nothing is in its way any more."""
        for motion in self._motions.values():
            if (
                motion.held
                and not self.fault
                and not self._stale(motion, now_s)
                and not self._pressed(motion)
            ):
                motion.held, motion.held_since_s = "", math.nan
                motion.part.carry_out()

    def _fail(self, reason: str) -> None:
        self.fault = self.fault or reason
        for motion in self._motions.values():
            if motion.moving:
                self._hold(motion, self._clock(), reason)

    def _raise(self) -> None:
        if self.fault:
            raise DeviceError(f"the supervisor has stopped the robot: {self.fault}")

    def _watch(self) -> None:
        while not self._ended.wait(1.0 / CHECK_RATE_HZ):
            self.check()
