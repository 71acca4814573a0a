"""Parts and sensors of a robot as they are seen through a supervisor."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from ...core.camera.frame import Frame
from ...core.camera.model import Camera
from ...core.camera.pose import Pose
from ...core.errors import DeviceError
from ...core.resources import Closing
from ...core.robots import (
    BaseState,
    FrameSource,
    Gripper,
    GripperState,
    MobileBase,
    ProbeArm,
    require_members,
)
from .supervisor import SupervisorCore

__all__ = ["Supervisor", "force_of"]

ReadingT = TypeVar("ReadingT")


class Supervisor(SupervisorCore):
    """Wraps the parts of a robot, so that every command passes the limits; see :mod:`.supervisor`.

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
        """A base under the supervisor.

        Parameters
        ----------
        base
            The platform.
        """
        require_members(base, MobileBase, "Supervisor", "base")
        return _SupervisedBase(self, base)

    def arm(self, arm: ProbeArm) -> ProbeArm:
        """An arm under the supervisor.

        Parameters
        ----------
        arm
            With its tip.
        """
        require_members(arm, ProbeArm, "Supervisor", "arm")
        return _SupervisedArm(self, arm)

    def gripper(self, gripper: Gripper) -> Gripper:
        """A gripper under the supervisor.

        Parameters
        ----------
        gripper
            With two fingers.
        """
        require_members(gripper, Gripper, "Supervisor", "gripper")
        return _SupervisedGripper(self, gripper)

    def frames(self, source: FrameSource, name: str = "the camera") -> FrameSource:
        """Frames whose times and contents are watched.

        Parameters
        ----------
        source
            A camera.
        name
            For messages.
        """
        return _WatchedFrames(self, source, name)

    def force(
        self, read: Callable[[Frame], ReadingT], size: Callable[[ReadingT], float] | None = None
    ) -> Callable[[Frame], ReadingT]:
        """A reader of a force sensor whose readings are held against the limit.

        Parameters
        ----------
        read
            Reading of a frame.
        size
            Force of a reading [N]; NaN when it cannot be trusted. :func:`force_of` by default.
        """
        measure = size or force_of

        def watched(frame: Frame) -> ReadingT:
            reading = read(frame)
            self.note_force(frame.t_s, measure(reading))
            return reading

        return watched

    def sensor(self, sensor: Any) -> Any:
        """A sensor with a method ``read(frame)``, as the foam's; the rest of it is passed through.

        Parameters
        ----------
        sensor
            Of forces.
        """
        return _WatchedSensor(self, sensor)

    def senses(self, senses: Any) -> Any:
        """What a travel perceives; the rest of it is passed through.

        Its pose and force have no times of their own: what stays the same to the last digit while the odometry
        goes on counts as frozen.

        Parameters
        ----------
        senses
            With ``pose()`` and ``touch()``, see :class:`~visuohaptic.tasks.mobile.travel.TravelSenses`.
        """
        return _WatchedSenses(self, senses)

    def wait(self, wait: Callable[[float], None]) -> Callable[[float], None]:
        """A function that lets time pass, with a check behind it.

        Parameters
        ----------
        wait
            Called with a time [s].
        """

        def watched(duration_s: float) -> None:
            wait(duration_s)
            self.check()

        return watched


def force_of(reading: Any) -> float:
    """Size of the force in a reading [N]; NaN where it is not valid.

    Parameters
    ----------
    reading
        With ``force_N``, a number or a vector; what is not ``valid`` counts where it is only saturated: that is a
        force of at least as much.
    """
    force = float(np.linalg.norm(np.atleast_1d(np.asarray(reading.force_N, dtype=float))))
    usable = getattr(reading, "valid", True) or str(getattr(reading, "reason", "")) in (
        "saturated",
        "unloading",
    )
    return force if usable else math.nan


class _SupervisedBase(MobileBase):
    name = "the base"

    def __init__(self, guard: SupervisorCore, device: MobileBase) -> None:
        self._guard, self._device = guard, device
        self._wanted = (0.0, 0.0)
        self._last: BaseState | None = None
        guard.register(self)

    def drive(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """Set the velocities, within the limits."""
        if speed_m_s == 0.0 and turn_rate_rad_s == 0.0:
            self._guard.release(self)
            return
        limits = self._guard.limits
        part = max(
            1.0, abs(speed_m_s) / limits.max_speed_m_s, abs(turn_rate_rad_s) / limits.max_turn_rate_rad_s
        )
        if not math.isfinite(part):
            self._device.drive(speed_m_s, turn_rate_rad_s)  # whose error says what is wrong with it
            return
        self._wanted = (speed_m_s / part, turn_rate_rad_s / part)
        self._guard.request(self)

    def stop(self) -> None:
        """Stand still."""
        self._guard.release(self)

    def state(self) -> BaseState:
        """Newest odometry."""
        state, last = self._device.state(), self._last
        self._last = state
        if last is None or (state.x_m, state.y_m, state.heading_rad) != (
            last.x_m,
            last.y_m,
            last.heading_rad,
        ):
            self._guard.odometry += 1
        # What says that it moves has another pose each time.
        frozen = (
            last is not None
            and (state.speed_m_s != 0.0 or state.turn_rate_rad_s != 0.0)
            and (state.x_m, state.y_m, state.heading_rad) == (last.x_m, last.y_m, last.heading_rad)
        )
        self._guard.note(self.name, state.t_s, frozen=frozen)
        return state

    def carry_out(self) -> None:
        self._device.drive(*self._wanted)

    def halt(self) -> None:
        self._device.stop()

    def pressing(self) -> tuple[float, float]:
        return self._wanted

    def retreats(self, pressing: object) -> bool:
        assert isinstance(pressing, tuple)
        (speed, turn), (pressed, turned) = self._wanted, pressing
        # On the spot a disc is freed by turning back, and by driving backwards.
        return speed * pressed < 0.0 if pressed else speed < 0.0 or turn * turned < 0.0


class _SupervisedArm(ProbeArm):
    name = "the arm"

    def __init__(self, guard: SupervisorCore, device: ProbeArm) -> None:
        self._guard, self._device = guard, device
        self._target, self._speed_m_s = Pose.identity(), 0.0
        self._tip_m = np.full(3, math.nan)
        guard.register(self)

    def move_linear(self, T_base_tip: Pose, speed_m_s: float) -> None:
        """Move the tip in a straight line, within the limits."""
        limits, tip = self._guard.limits, T_base_tip.translation_m
        near, far = (float(value) for value in self._device.reach_m())
        inside = np.all(tip >= limits.min_tip_m) and np.all(tip <= limits.max_tip_m)
        if not (inside and near <= float(np.linalg.norm(tip)) <= far):
            raise DeviceError(
                f"move_linear: found a target at {np.round(tip, 3).tolist()} m, expected {near:g} to {far:g} m from "
                f"the base and within {limits.min_tip_m} to {limits.max_tip_m} m; move the object or the base"
            )
        self._target, self._speed_m_s = T_base_tip, min(speed_m_s, limits.max_tip_speed_m_s)
        self._guard.request(self)

    def stop(self) -> None:
        """Hold the present pose."""
        self._guard.release(self)

    def pose(self) -> tuple[float, Pose]:
        """Newest time [s] and pose of the tip in the base frame."""
        t_s, pose = self._device.pose()
        self._tip_m = pose.translation_m
        self._guard.note(self.name, t_s)
        return t_s, pose

    def reach_m(self) -> Float[np.ndarray, "2"]:
        """Smallest and largest distance of the tip from the base."""
        return self._device.reach_m()

    def carry_out(self) -> None:
        self._device.move_linear(self._target, self._speed_m_s)

    def halt(self) -> None:
        self._device.stop()

    def pressing(self) -> Float[np.ndarray, "3"]:
        return self._target.translation_m - self._tip_m

    def retreats(self, pressing: object) -> bool:
        return float((self._target.translation_m - self._tip_m) @ np.asarray(pressing)) < 0.0


class _SupervisedGripper(Gripper):
    name = "the gripper"

    def __init__(self, guard: SupervisorCore, device: Gripper) -> None:
        self._guard, self._device = guard, device
        self._target_m = self._speed_m_s = 0.0
        self._opening_m = math.nan
        guard.register(self)

    def move(self, opening_m: float, speed_m_s: float) -> None:
        """Move to an opening, within the limits."""
        self._target_m = opening_m
        self._speed_m_s = min(speed_m_s, self._guard.limits.max_finger_speed_m_s)
        self._guard.request(self)

    def stop(self) -> None:
        """Hold the present opening."""
        self._guard.release(self)

    def state(self) -> GripperState:
        """Newest reading."""
        state = self._device.state()
        self._opening_m = state.opening_m
        self._guard.note(self.name, state.t_s)
        return state

    def carry_out(self) -> None:
        self._device.move(self._target_m, self._speed_m_s)

    def halt(self) -> None:
        self._device.stop()

    def pressing(self) -> float:
        return self._target_m - self._opening_m

    def retreats(self, pressing: object) -> bool:
        assert isinstance(pressing, float)
        return (self._target_m - self._opening_m) * pressing < 0.0


class _WatchedFrames(Closing):
    def __init__(self, guard: SupervisorCore, source: FrameSource, name: str) -> None:
        self._guard, self._source, self._name = guard, source, name

    @property
    def camera(self) -> Camera | None:
        """Of the source."""
        return self._source.camera

    @property
    def frame_count(self) -> int | None:
        """Of the source."""
        return self._source.frame_count

    def __iter__(self) -> Iterator[Frame]:
        last: Frame | None = None
        for frame in self._source:
            # A sensor's noise makes every image another one; one that is drawn without any is no image.
            image = frame.image
            frozen = (
                last is not None and np.array_equal(image, last.image) and bool(image.min() != image.max())
            )
            last = frame
            self._guard.note(self._name, frame.t_s, frozen=frozen)
            yield frame

    def close(self) -> None:
        """Release the source."""
        self._source.close()


class _WatchedSensor:
    def __init__(self, guard: Supervisor, sensor: Any) -> None:
        self._sensor = sensor
        self.read = guard.force(sensor.read)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sensor, name)


class _WatchedSenses:
    def __init__(self, guard: Supervisor, senses: Any) -> None:
        self._guard, self._senses = guard, senses
        self._pose: tuple[object, int] = (None, 0)
        self._touch: tuple[object, int] = (None, 0)

    def pose(self) -> tuple[float, float, float]:
        """Where the robot is in the map: x, y [m], heading [rad]."""
        pose: tuple[float, float, float] = self._senses.pose()
        self._pose = self._since(pose, self._pose)
        now_s = self._guard.now_s() if all(map(math.isfinite, pose)) else math.nan
        self._guard.note("the localizer", now_s, frozen=self._pose[1] != self._guard.odometry)
        return pose

    def touch(self) -> tuple[float, tuple[float, float] | None]:
        """Force on the rim [N], and where it acts in the map [m]."""
        force_N, point_m = self._senses.touch()
        self._touch = self._since(force_N, self._touch)
        frozen = force_N != 0.0 and self._touch[1] != self._guard.odometry
        self._guard.note_force(self._guard.now_s(), force_N, frozen=frozen)
        return force_N, point_m

    def _since(self, value: object, before: tuple[object, int]) -> tuple[object, int]:
        """A value, and the count of the odometry when it was another one."""
        return before if value == before[0] else (value, self._guard.odometry)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._senses, name)
