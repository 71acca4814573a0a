"""Wrappers of robot parts and sensors that pass through the safety supervisor."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np
from jaxtyping import Float

from ...core import DeviceError, Frame, Pose
from ...core.robots import (
    BaseState,
    FrameSource,
    Gripper,
    GripperState,
    MobileBase,
    ProbeArm,
    require_members,
)
from ._motion import STANDING_M, RepeatedState, SupervisedPart
from .path_clearance import KnownObstacles
from .supervisor import SupervisorCore
from .watched_sensors import WatchedFrames, WatchedSenses, WatchedSensor, force_of

ReadingT = TypeVar("ReadingT")
DeviceT = TypeVar("DeviceT", bound=MobileBase | ProbeArm | Gripper)
#: Minimum motion between two readings that changes any pose [m or rad]: the last digit is 1e-11 m within 10 km.
ROUNDING_M = 1e-9


class Supervisor(SupervisorCore):
    """Wraps the parts of a robot, so that every command is subject to the limits; see :mod:`.supervisor`.

    Examples
    --------
    >>> from visuohaptic.tasks.framework import SafetyLimits
    >>> class Base(MobileBase):
    ...     speed, t_s = 0.0, 0.0
    ...     def drive(self, speed_m_s, turn_rate_rad_s): self.speed = speed_m_s
    ...     def stop(self): self.speed = 0.0
    ...     def state(self): return BaseState(self.t_s, 0.0, 0.0, 0.0, self.speed, 0.0)
    >>> robot = Base()
    >>> with Supervisor(SafetyLimits(max_force_N=20.0), clock=lambda: robot.t_s) as guard:
    ...     base = guard.base(robot)
    ...     base.drive(2.0, 0.0)
    ...     faster_than_allowed = robot.speed
    ...     guard.note_force(0.0, 25.0)
    ...     at_the_limit = robot.speed
    >>> faster_than_allowed, at_the_limit, guard.holds[0].reason
    (0.5, 0.0, 'the force is 25.0 N, the limit 20 N')
    """

    def base(self, base: MobileBase) -> MobileBase:
        """Wrap a mobile base.

        Parameters
        ----------
        base
            Mobile base.
        """
        require_members(base, MobileBase, "Supervisor", "base")
        return _SupervisedBase(self, base)

    def arm(self, arm: ProbeArm, obstacles: KnownObstacles | None = None) -> ProbeArm:
        """Wrap an arm.

        Parameters
        ----------
        arm
            Arm with its tip.
        obstacles
            Fused and mapped obstacles: motions faster than ``max_contact_m_s`` are refused where their clearance is
            insufficient. Slower motions may make contact, under the force limit, and may be retraced fast: the path
            that the tip has just followed is free.
        """
        require_members(arm, ProbeArm, "Supervisor", "arm")
        return _SupervisedArm(self, arm, obstacles)

    def gripper(self, gripper: Gripper) -> Gripper:
        """Wrap a gripper.

        Parameters
        ----------
        gripper
            Gripper with two fingers.
        """
        require_members(gripper, Gripper, "Supervisor", "gripper")
        return _SupervisedGripper(self, gripper)

    def frames(self, source: FrameSource, name: str = "the camera") -> FrameSource:
        """Wrap a frame source; times and contents of its frames are monitored.

        Parameters
        ----------
        source
            Camera.
        name
            Name in messages.
        """
        return WatchedFrames(self, source, name)

    def force(
        self, read: Callable[[Frame], ReadingT], size: Callable[[ReadingT], float] | None = None
    ) -> Callable[[Frame], ReadingT]:
        """Wrap the reader of a force sensor; its readings are compared with the force limit.

        Parameters
        ----------
        read
            Reads a frame.
        size
            Force of a reading [N]; NaN if invalid. :func:`force_of` by default.
        """
        measure = size or force_of

        def watched(frame: Frame) -> ReadingT:
            reading = read(frame)
            self.note_force(frame.t_s, measure(reading))
            return reading

        return watched

    def sensor(self, sensor: Any) -> Any:
        """Wrap a sensor with a method ``read(frame)``; its other attributes are passed through.

        Parameters
        ----------
        sensor
            Force sensor.
        """
        return WatchedSensor(sensor, self.force(sensor.read))

    def senses(self, senses: Any) -> Any:
        """Wrap the senses of a navigation task; other attributes are passed through.

        Pose and force have no time stamps of their own: values that are exactly constant while the odometry
        changes count as frozen.

        Parameters
        ----------
        senses
            With ``pose()`` and ``touch()``, see :class:`~visuohaptic.tasks.mobile.travel.TravelSenses`.
        """
        return WatchedSenses(self, senses)

    def wait(self, wait: Callable[[float], None]) -> Callable[[float], None]:
        """Wrap a waiting function; the readings are checked after each call.

        Parameters
        ----------
        wait
            Waits for a duration [s].
        """

        def watched(duration_s: float) -> None:
            wait(duration_s)
            self.check()

        return watched


class _Supervised(SupervisedPart, Generic[DeviceT]):
    """What all wrapped parts have in common."""

    def __init__(self, guard: SupervisorCore, device: DeviceT) -> None:
        self._guard, self._device = guard, device
        self._repeated, self._requested_s = RepeatedState(), -math.inf
        guard.register(self)

    def stop(self) -> None:
        """Stop, and hold the present state."""
        self._guard.release(self)

    def halt(self) -> None:
        self._device.stop()

    def only_opens(self) -> bool:
        return False

    def _as_of_s(self, changed: bool, rate_m_s: float) -> float:
        """Time up to which a state is new on the supervisor's clock [s], infinite: now; see :class:`RepeatedState`."""
        missing_s = self._repeated.missing_s(changed, self._guard.executed_s(self), rate_m_s)
        return self._guard.now_s() - missing_s if missing_s > 0.0 else math.inf

    def _renew(self, before: object, arrives_s: float) -> None:
        """Allow a motion to a new target after a constant state: away from the last one, or after it stood there."""
        if before is not None and self.retreats(before):
            self._repeated.turn_back()
        now_s = self._guard.now_s()
        if now_s - self._requested_s > arrives_s + self._guard.limits.max_age_s:
            self._repeated.arrive()
        self._requested_s = now_s


class _SupervisedBase(_Supervised[MobileBase], MobileBase):
    name = "the base"

    def __init__(self, guard: SupervisorCore, device: MobileBase) -> None:
        self._velocities = (0.0, 0.0)
        self._last: BaseState | None = None
        super().__init__(guard, device)

    def drive(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """Set the velocities, within the limits."""
        if speed_m_s == 0.0 and turn_rate_rad_s == 0.0:
            self._guard.release(self)
            return
        if not math.isfinite(speed_m_s + turn_rate_rad_s):
            self._device.drive(speed_m_s, turn_rate_rad_s)  # the device raises an error that states the cause
            return
        limits = self._guard.limits
        part = max(
            1.0, abs(speed_m_s) / limits.max_speed_m_s, abs(turn_rate_rad_s) / limits.max_turn_rate_rad_s
        )
        before, self._velocities = self._velocities, (speed_m_s / part, turn_rate_rad_s / part)
        if before != (0.0, 0.0) and self.retreats(before):
            self._repeated.turn_back()
        self._guard.request(self)

    def state(self) -> BaseState:
        """Newest odometry."""
        state, last = self._device.state(), self._last
        self._last = state
        same = last is not None and _pose(state) == _pose(last)
        self._guard.odometry += not same
        jumped = ""
        if last is not None:
            step_m = math.hypot(state.x_m - last.x_m, state.y_m - last.y_m)
            max_m_s = self._guard.limits.max_speed_m_s
            jumped = self._guard.leap(self.name, step_m, state.t_s - last.t_s, max_m_s)
        blocked = self._guard.blocked_by_contact(self)
        as_of_s = self._as_of_s(not same or blocked, max(map(abs, self._velocities)))
        # A base that reports a velocity has a new pose each time; a base at rest reports zero velocity.
        rate = max(abs(state.speed_m_s), abs(state.turn_rate_rad_s))
        if same and last is not None and rate * (state.t_s - last.t_s) > ROUNDING_M:
            as_of_s = -math.inf
        self._guard.note(self.name, state.t_s, as_of_s=as_of_s, jumped=jumped)
        return state

    def execute(self) -> None:
        self._device.drive(*self._velocities)

    def pressing(self) -> tuple[float, float]:
        return self._velocities

    def retreats(self, pressing: object) -> bool:
        if not isinstance(pressing, tuple):
            return True
        (speed, turn), (pressed, turned) = self._velocities, pressing
        # Turning on the spot, a disc is freed by turning back, and by driving backwards.
        return speed * pressed < 0.0 if pressed else speed < 0.0 or turn * turned < 0.0


def _pose(state: BaseState) -> tuple[float, float, float]:
    return state.x_m, state.y_m, state.heading_rad


def _apart_m(first: Pose, second: Pose) -> float:
    """Distance between two positions of the tip [m]."""
    return float(np.linalg.norm(first.translation_m - second.translation_m))


def _same(first: Pose, second: Pose) -> bool:
    return np.array_equal(first.translation_m, second.translation_m) and np.array_equal(
        first.rotation, second.rotation
    )


def _check_numbers(call: str, **values: float) -> None:
    """Refuse nan at once: held back, it would reach the device with a later reading."""
    for what, value in values.items():
        if math.isnan(value):
            raise DeviceError(f"{call}: found {what} nan, expected a number; the previous command holds")


class _SupervisedArm(_Supervised[ProbeArm], ProbeArm):
    name = "the arm"

    def __init__(self, guard: SupervisorCore, device: ProbeArm, obstacles: KnownObstacles | None) -> None:
        self._obstacles = obstacles
        self._target, self._speed_m_s = Pose.identity(), 0.0
        self._felt_from: Pose | None = None  #: start of the last motion, if it was slow enough for contact
        self._newest: tuple[float, Pose] | None = None  #: time and pose of the last reading
        super().__init__(guard, device)

    def move_linear(self, T_base_tip: Pose, speed_m_s: float) -> None:
        """Move the tip in a straight line, within the limits."""
        _check_numbers("move_linear", speed_m_s=speed_m_s)
        limits, tip = self._guard.limits, T_base_tip.translation_m
        near, far = (float(value) for value in self._device.reach_m())
        inside = np.all(tip >= limits.min_tip_m) and np.all(tip <= limits.max_tip_m)
        if not (inside and near <= float(np.linalg.norm(tip)) <= far):
            raise DeviceError(
                f"move_linear: found a target at {np.round(tip, 3).tolist()} m, expected {near:g} to {far:g} m from "
                f"the base and within {limits.min_tip_m} to {limits.max_tip_m} m; move the object or the base"
            )
        if self._obstacles is not None:
            self._keep_clear(self._obstacles, T_base_tip, speed_m_s)
        before, left_m = self.pressing(), self._left_m()
        if not _same(T_base_tip, self._target):
            self._target, last_m_s = T_base_tip, self._speed_m_s
            self._renew(before, left_m / last_m_s if last_m_s > 0.0 else 0.0)
        self._speed_m_s = min(speed_m_s, limits.max_tip_speed_m_s)
        self._guard.request(self)

    def _keep_clear(self, obstacles: KnownObstacles, T_base_tip: Pose, speed_m_s: float) -> None:
        """Refuse a fast motion too near to known obstacles, except back along the straight path just followed."""
        here, felt_from = self._device.pose()[1], self._felt_from
        if speed_m_s <= self._guard.limits.max_contact_m_s:
            if felt_from is None or not np.array_equal(T_base_tip.translation_m, self._target.translation_m):
                self._felt_from = here
            return
        if felt_from is not None and _apart_m(T_base_tip, felt_from) < obstacles.resolution_m:
            return
        self._felt_from = None
        path = obstacles.along(here, T_base_tip)
        if not path.free:
            raise DeviceError(
                f"move_linear: the tool comes within {path}; approach from elsewhere, or slower"
            )

    def pose(self) -> tuple[float, Pose]:
        """Newest time [s] and pose of the tip in the base frame."""
        t_s, pose = self._device.pose()
        (last_s, last), self._newest = self._newest or (t_s, pose), (t_s, pose)
        max_m_s = self._guard.limits.max_tip_speed_m_s
        jumped = self._guard.leap(self.name, _apart_m(pose, last), t_s - last_s, max_m_s)
        due = max(self._left_m(), pose.angle_to(self._target)) > STANDING_M
        as_of_s = self._as_of_s(not _same(pose, last), math.inf if due else 0.0)
        self._guard.note(self.name, t_s, as_of_s=as_of_s, jumped=jumped)
        return t_s, pose

    def reach_m(self) -> Float[np.ndarray, "2"]:
        """Minimum and maximum distance of the tip from the base [m]."""
        return self._device.reach_m()

    def execute(self) -> None:
        self._device.move_linear(self._target, self._speed_m_s)

    def _way_m(self) -> Float[np.ndarray, "3"]:
        """From the newest tip to the target [m]; NaN before the first reading."""
        return self._target.translation_m - (self._newest[1].translation_m if self._newest else math.nan)

    def _left_m(self) -> float:
        return float(np.linalg.norm(self._way_m()))

    def pressing(self) -> Float[np.ndarray, "3"] | None:
        return None if self._left_m() <= STANDING_M else self._way_m()

    def retreats(self, pressing: object) -> bool:
        return pressing is None or float(self._way_m() @ np.asarray(pressing)) < 0.0


class _SupervisedGripper(_Supervised[Gripper], Gripper):
    name = "the gripper"

    def __init__(self, guard: SupervisorCore, device: Gripper) -> None:
        self._target_m = self._speed_m_s = 0.0
        self._opening_m = math.nan
        self._widest_m = math.nan  #: widest opening that it may have reached since the last fresh reading
        super().__init__(guard, device)

    def move(self, opening_m: float, speed_m_s: float) -> None:
        """Move to an opening, within the limits."""
        _check_numbers("move", opening_m=opening_m, speed_m_s=speed_m_s)
        before, left_m, last_m_s = self.pressing(), abs(self.pressing()), self._speed_m_s
        if opening_m != self._target_m:
            self._target_m = opening_m
            self._renew(before, left_m / last_m_s if last_m_s > 0.0 else 0.0)
        self._speed_m_s = min(speed_m_s, self._guard.limits.max_finger_speed_m_s)
        self._guard.request(self)

    def state(self) -> GripperState:
        """Newest reading."""
        state = self._device.state()
        changed, due = state.opening_m != self._opening_m, abs(self._target_m - state.opening_m) > STANDING_M
        as_of_s = self._as_of_s(changed, math.inf if due else 0.0)
        if changed or not (as_of_s < math.inf or (due and self._guard.is_executing(self))):
            self._widest_m = state.opening_m
        self._opening_m = state.opening_m
        self._guard.note(self.name, state.t_s, as_of_s=as_of_s)
        return state

    def execute(self) -> None:
        if self._target_m > self._widest_m:
            self._widest_m = self._target_m
        self._device.move(self._target_m, self._speed_m_s)

    def pressing(self) -> float:
        return self._target_m - self._opening_m

    def retreats(self, pressing: object) -> bool:
        # Closing presses also if the fingers stood when the force reached the limit.
        return self.only_opens()

    def only_opens(self) -> bool:
        return self._target_m >= self._widest_m
