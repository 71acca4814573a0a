"""Safety supervisor: an independent layer between tasks and robot that enforces limits, force stop and fresh readings.

The supervisor is independent of the tasks. It wraps the parts of a robot and its sensor readers
(:meth:`Supervisor.base`, :meth:`~Supervisor.arm`, :meth:`~Supervisor.gripper`, :meth:`~Supervisor.frames`,
:meth:`~Supervisor.force`); tasks use the wrapped parts, which behave like the originals unless a limit is reached.

- Speeds are reduced to the limits, both velocities of a base by the same factor; targets out of reach are refused.
- A force at the limit, or predicted to reach it before the robot has stopped, stops moving parts within the same reading.
  Then only a retreat is permitted, until the force is below the limit again; it needs no fresh sensors. A retreat is
  opposed to the motion at the limit; of a part that stood there, to the motion by which most of the force rose. A motion
  that raises the force further, because it came from elsewhere, is no retreat.
- A reading is *fresh* if its own time is newer than before and its content is not a frozen copy: the state of a part that has
  to move must change, whatever speed it reports, unless a contact may block a base. While a part moves, its own state and
  every sensor in use must be fresh; otherwise the part is held, and resumes when they are. A force
  that cannot be read since a contact is waited for as long after the retreat from it begins: foam may be pressed until then.
- Fingers may always open and every part may always stop, whatever is read, so that nothing stays clamped.
- A clock that jumps, or a hold that lasts too long, is permanent: every later reading or command raises
  :class:`~visuohaptic.core.errors.DeviceError`, which ends a task with its text as the reason.

The supervisor has its own time: the monotonic clock of the host, or of the host of a simulated robot.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from ...core.errors import DeviceError
from ...core.ranges import POSITIVE, Ranged
from ...core.resources import WAIT_S, Closing, end_thread
from ._motion import PartMotion, Stream, SupervisedPart

Point = tuple[float, float, float]
#: Rate of the checks by the supervisor's own thread [Hz].
CHECK_RATE_HZ = 50.0
#: Fraction of the force limit by which a permitted motion may raise a force beyond it, so that noise does not refuse a retreat;
#: a smaller force may be noise, and is no contact to retreat from without a reading.
EXCESS = 0.1
#: Name of the stream of forces in messages.
FORCE = "the force"


@dataclass(frozen=True, slots=True)
class SafetyLimits(Ranged):
    """Safety limits of all commands."""

    max_force_N: float = field(default=20.0, metadata=POSITIVE)
    max_speed_m_s: float = field(default=0.5, metadata=POSITIVE)  #: maximum speed of the base [m/s]
    max_turn_rate_rad_s: float = field(default=1.5, metadata=POSITIVE)
    max_tip_speed_m_s: float = field(default=0.25, metadata=POSITIVE)
    #: maximum speed of a tip that may touch known obstacles [m/s]
    max_contact_m_s: float = field(default=0.05, metadata=POSITIVE)
    #: maximum opening rate of the gripper [m/s]
    max_finger_speed_m_s: float = field(default=0.15, metadata=POSITIVE)
    #: corners of the permitted box of the tip in the base frame [m]
    min_tip_m: Point = (-math.inf, -math.inf, -math.inf)
    max_tip_m: Point = (math.inf, math.inf, math.inf)
    #: Age of a reading at which motion is held [s]; a part stops one check later, in less than 0.2 s altogether.
    max_age_s: float = field(default=0.15, metadata=POSITIVE)
    #: maximum jump of a clock against the supervisor's [s]
    max_jump_s: float = field(default=0.5, metadata=POSITIVE)
    #: maximum change of a state beyond its speed limit [m or rad]
    max_leap_m: float = field(default=0.05, metadata=POSITIVE)
    max_hold_s: float = field(default=5.0, metadata=POSITIVE)  #: a longer hold is permanent [s]
    brake_s: float = 0.1  #: braking time from full speed [s]; the force meanwhile is predicted from its rate


@dataclass(frozen=True, slots=True)
class SafetyHold:
    """One stop by the supervisor."""

    t_s: float  #: time on the supervisor's clock [s]
    part: str  #: name of the part that was moving
    reason: str


class SupervisorCore(Closing):
    """Decides which motions are executed; :class:`~.supervised_parts.Supervisor` wraps the parts around it.

    Parameters
    ----------
    limits
        Safety limits of all commands.
    clock
        Monotonic time [s], independent of the robot. With a clock other than the host's, as that of a simulated
        world, no thread is started: call :meth:`check` as that time passes.
    """

    def __init__(
        self, limits: SafetyLimits | None = None, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.limits = limits or SafetyLimits()
        self.holds: list[SafetyHold] = []  #: all stops, in order
        self.odometry = 0  #: number of changes of the base's pose
        self.fault = ""  #: cause of a permanent stop; empty without one
        self._clock, self._lock = clock, threading.RLock()
        self._streams: dict[str, Stream] = {}
        self._motions: dict[str, PartMotion] = {}
        self._force = (-math.inf, -math.inf)  #: time of the newest reading [s], and its force [N]
        self._rate_N_s, self._felt_s, self._unread = 0.0, math.nan, False
        self._overload, self._over_N = (
            "",
            math.inf,
        )  #: why motion is restricted, and the force when that began [N]
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None
        if clock is time.monotonic:
            self._thread = threading.Thread(target=self._watch, name="supervisor", daemon=True)
            self._thread.start()

    def now_s(self) -> float:
        """Time on the supervisor's clock [s]."""
        return self._clock()

    def check(self) -> None:
        """Hold every part whose readings are too old; call at least every 50 ms."""
        with self._lock:
            now_s = self._clock()
            if self._rate_N_s and not self._overload:
                self._check_force(now_s - self._felt_s)  # the force may rise between readings
            for motion in self._motions.values():
                if not motion.moving:
                    continue
                if not motion.held and (stale := self._stale(motion, now_s)):
                    self._hold(motion, now_s, stale)
                elif motion.held and now_s - motion.held_since_s > self.limits.max_hold_s:
                    self._fail(f"{motion.held}, for {now_s - motion.held_since_s:.1f} s")

    def close(self) -> None:
        """Stop every part and the supervisor's thread; may be called repeatedly."""
        self._ended.set()
        if self._thread is not None:
            end_thread(self._thread)
        # A driver that does not return from its stop keeps the lock; a part that is held was told to stop.
        locked = self._lock.acquire(timeout=WAIT_S)
        try:
            for motion in self._motions.values():
                if motion.moving and locked:
                    self.release(motion.part)
                elif motion.moving and not motion.held:
                    motion.part.halt()
        finally:
            if locked:
                self._lock.release()

    def is_executing(self, part: SupervisedPart) -> bool:
        """Whether a requested motion of a part is being executed.

        Parameters
        ----------
        part
            Part of the robot.
        """
        motion = self._motions[part.name]
        return motion.moving and not motion.held

    def blocked_by_contact(self, part: SupervisedPart) -> bool:
        """Whether the newest force shows that a part is pressed against something, and does not retreat from it.

        Parameters
        ----------
        part
            Part of the robot.
        """
        with self._lock:
            presses = self._presses(self._motions[part.name])
            retreats = presses is not None and part.retreats(presses)
            return not retreats and self._force[1] >= EXCESS * self.limits.max_force_N

    def register(self, part: SupervisedPart) -> None:
        """Register a part.

        Parameters
        ----------
        part
            Part of the robot; its name, also that of its state readings, is numbered if already in use.
        """
        number = sum(name.partition(" #")[0] == part.name for name in self._motions)
        part.name += f" #{number + 1}" if number else ""
        self._motions[part.name] = PartMotion(part)

    def release(self, part: SupervisedPart) -> None:
        """Stop a part; always executed.

        Parameters
        ----------
        part
            Part of the robot.
        """
        with self._lock:
            motion = self._motions[part.name]
            motion.pause(self._clock())
            motion.moving, motion.held, motion.held_since_s = False, "", math.nan
            part.halt()

    def request(self, part: SupervisedPart) -> None:
        """Execute the requested motion of a part, or hold it.

        Parameters
        ----------
        part
            Part of the robot.

        Raises
        ------
        DeviceError
            The robot is stopped permanently.
        """
        with self._lock:
            now_s, motion = self._clock(), self._motions[part.name]
            if not part.only_opens():
                self._raise()
            if not motion.moving:
                motion.moving, motion.since_s = True, now_s
            reason = self._stale(motion, now_s) or self._pressed(motion)
            if reason:
                self._hold(motion, now_s, reason)
            else:
                motion.execute(now_s)

    def executed_s(self, part: SupervisedPart) -> float:
        """Duration of all motions of a part so far [s], without holds.

        Parameters
        ----------
        part
            Part of the robot.
        """
        with self._lock:
            return self._motions[part.name].executed_s(self._clock())

    def note(self, name: str, t_s: float, *, as_of_s: float = math.inf, jumped: str = "") -> None:
        """Record a reading of a sensor or of the state of a part.

        Parameters
        ----------
        name
            Name of the sensor or part.
        t_s
            Time stamp of the reading [s]; NaN: no reading.
        as_of_s
            Time on the supervisor's clock up to which the value is new [s]: earlier than now if it is a copy of the last
            one although it should have changed; minus infinity: as long as before.
        jumped
            Why the reading is implausible; empty if it is not.

        Raises
        ------
        DeviceError
            The robot is stopped permanently.
        """
        with self._lock:
            now_s = self._clock()
            stream = self._streams.setdefault(name, Stream(name, self.limits.max_jump_s))
            if wrong := stream.note(now_s, t_s, as_of_s) or jumped:
                self._fail(wrong)
            self._resume(now_s)
            self.check()
            self._raise()

    def leap(self, name: str, step_m: float, passed_s: float, max_speed_m_s: float) -> str:
        """Describe a change of state that no motion within the limits can make; empty if plausible.

        Parameters
        ----------
        name
            Name of the part.
        step_m, passed_s
            Change [m], and the time for it [s]. Jumps of the clock are reported separately.
        max_speed_m_s
            Maximum speed of the part [m/s].
        """
        plausible = step_m <= max_speed_m_s * max(passed_s, 0.0) + self.limits.max_leap_m
        if plausible or abs(passed_s) > self.limits.max_jump_s:
            return ""
        return f"{name} reports a motion of {step_m:.2f} m in {passed_s:.2f} s"

    def note_force(self, t_s: float, force_N: float, *, as_of_s: float = math.inf) -> None:
        """Record a force; moving parts are stopped before the method returns if the limit is reached.

        Parameters
        ----------
        t_s
            Time stamp of the reading [s].
        force_N
            Magnitude of the force [N]; NaN: no reading; infinite: the foam is saturated.
        as_of_s
            As of :meth:`note`.
        """
        with self._lock:
            (last_s, last_N), self._unread = self._force, math.isnan(force_N)
            if not math.isnan(force_N) and t_s > last_s:
                rose_N = force_N - last_N if math.isfinite(last_s + last_N) else 0.0
                self._rate_N_s = max(rose_N / (t_s - last_s), 0.0)
                self._force, self._felt_s = (t_s, force_N), self._clock()
                for motion in self._motions.values():
                    brakes = self._felt_s - motion.halted_s <= self.limits.brake_s
                    motion.feel(max(last_N, 0.0), force_N, brakes)
                # Predict until the next reading, expected after the same interval as this one.
                self._check_force(t_s - last_s if self._rate_N_s else 0.0)
        self.note(FORCE, math.nan if math.isnan(force_N) else t_s, as_of_s=as_of_s)

    def _check_force(self, passed_s: float) -> None:
        """Stop parts that press if the force is at the limit, or predicted after ``passed_s`` plus half the braking time."""
        limit_N, was = self.limits.max_force_N, self._overload
        force_N = self._force[1]
        soon_N = force_N + self._rate_N_s * (passed_s + 0.5 * self.limits.brake_s)
        self._overload = ""
        if max(force_N, soon_N) >= limit_N:
            more = "" if force_N >= limit_N else f", and {soon_N:.1f} N before it stands"
            self._overload = f"the force is {force_N:.1f} N{more}, the limit {limit_N:g} N"
        if self._overload and not was:
            self._over_N = force_N
        for motion in self._motions.values():
            if self._overload and not was:
                motion.pressing = motion.part.pressing() if motion.moving and not motion.held else None
            if motion.moving and not motion.held and (reason := self._pressed(motion)):
                self._hold(motion, self._clock(), reason)

    def _presses(self, motion: PartMotion) -> object:
        return motion.towards(self._force[1], self._over_N, EXCESS * self.limits.max_force_N)

    def _pressed(self, motion: PartMotion) -> str:
        """Why the force holds a motion; empty if it may continue."""
        return "" if motion.part.retreats(self._presses(motion)) else self._overload

    def _stale(self, motion: PartMotion, now_s: float) -> str:
        """Name of a stale reading on which a motion depends; empty if there is none."""
        if motion.part.only_opens():
            return ""
        max_age_s = self.limits.max_age_s
        presses = self._presses(motion)
        retreats = presses is not None and motion.part.retreats(presses)
        frees = self._overload and retreats
        # Foam that is pressed until its image cannot be read is read again once the retreat has begun.
        blind = retreats and self._unread and self._force[1] >= EXCESS * self.limits.max_force_N
        for stream in self._streams.values():
            own, in_use = stream.name == motion.part.name, stream.read_s >= motion.since_s - max_age_s
            if not own and (frees or not in_use or stream.name in self._motions):
                continue
            # A stream that was not read yet may be read soon; one that was read and is not fresh has failed.
            soon = stream.read_s == stream.fresh_s or (blind and stream.name == FORCE)
            from_s = max(stream.fresh_s, motion.since_s) if soon else stream.fresh_s
            if now_s - from_s >= max_age_s:
                why = " although it has to move" if own and stream.repeats else ""
                return f"{stream.name} has not been updated for {now_s - from_s:.2f} s{why}"
        if motion.part.name not in self._streams and now_s - motion.since_s >= max_age_s:
            return f"{motion.part.name} has never been read"
        return ""

    def _hold(self, motion: PartMotion, now_s: float, reason: str) -> None:
        if not motion.held:
            motion.held_since_s = now_s
            motion.pause(now_s)
            self.holds.append(SafetyHold(now_s, motion.part.name, reason))
        motion.held = reason
        motion.part.halt()

    def _resume(self, now_s: float) -> None:
        """Execute held motions that are permitted again."""
        for motion in self._motions.values():
            if (
                motion.held
                and not self.fault
                and not self._stale(motion, now_s)
                and not self._pressed(motion)
            ):
                motion.execute(now_s)

    def _fail(self, reason: str) -> None:
        self.fault = self.fault or reason
        for motion in self._motions.values():
            if motion.moving and not motion.part.only_opens():
                self._hold(motion, self._clock(), reason)

    def _raise(self) -> None:
        if self.fault:
            raise DeviceError(f"the supervisor has stopped the robot: {self.fault}")

    def _watch(self) -> None:
        while not self._ended.wait(1.0 / CHECK_RATE_HZ):
            self.check()
