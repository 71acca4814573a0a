"""Robots of LeRobot as the protocols of a task: mobile base, gripper and camera.

Written against LeRobot's interfaces ``Robot`` (``get_observation``, ``send_action``, ``action_features``) and ``Camera``
(``connect``, ``async_read``, ``disconnect``), by their names and units; the package itself is not imported. Its arms speak of
joints, so a :class:`~visuohaptic.core.robots.ProbeArm` needs the kinematics of the arm besides.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
from jaxtyping import UInt8

from ...core import POSITIVE, DeviceError, InputError, check_numbers, within
from ...core.robots import BaseState, Gripper, GripperState
from ...io.frames.camera_backend import CameraBackend, time_s
from .repeater import Repeated, RepeatedBase, Repeater

#: Number of readings for a speed estimate: enough to average over the steps of an encoder.
READINGS = 5
_CAMERA = "LeRobot camera"


class _LeRobotDevice(Protocol):
    """What is used of ``lerobot.robots.Robot``."""

    @property
    def action_features(self) -> Mapping[str, Any]: ...

    def get_observation(self) -> Mapping[str, Any]: ...

    def send_action(self, action: dict[str, Any]) -> Any: ...


class _LeRobotCameraDevice(Protocol):
    """What is used of ``lerobot.cameras.Camera``."""

    def connect(self) -> None: ...

    def async_read(self, timeout_ms: float) -> np.ndarray: ...

    def disconnect(self) -> None: ...


class LeRobotLink:
    """A connected robot of LeRobot, shared by its parts.

    An action contains all motors, so the goals of each part are stored for the next action; motors without a command
    stay at their first observed position.

    Parameters
    ----------
    robot
        A ``lerobot.robots.Robot`` on which ``connect()`` was called.
    clock
        Monotonic time [s].
    """

    def __init__(self, robot: _LeRobotDevice, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._robot, self._clock, self._turn = robot, clock, threading.RLock()
        self._goals: dict[str, float] = {}

    def observe(self, *names: str) -> tuple[float, list[float]]:
        """Time [s] and newest values of some features.

        Parameters
        ----------
        *names
            Of the observation, as ``gripper.pos``.

        Raises
        ------
        DeviceError
            The robot does not answer, or has no such feature.
        """
        with self._turn:
            found = _guarded(self._robot.get_observation)
            if missing := [name for name in names if name not in found]:
                raise DeviceError(
                    f"LeRobot: has no observation {missing[0]!r}, only {', '.join(map(str, found))}"
                )
            if not self._goals:
                self._goals = {
                    name: float(found[name]) if name.endswith(".pos") else 0.0
                    for name in self._robot.action_features
                }
            return self._clock(), [float(found[name]) for name in names]

    def command(self, goals: Mapping[str, float]) -> None:
        """Send the goals of some motors, with the last ones of all others.

        Parameters
        ----------
        goals
            By the names of the action, as ``gripper.pos``.

        Raises
        ------
        DeviceError
            The robot does not answer, or has no such motor.
        """
        with self._turn:
            if not self._goals:
                self.observe()
            if unknown := [name for name in goals if name not in self._goals]:
                raise DeviceError(f"LeRobot: has no action {unknown[0]!r}, but {', '.join(self._goals)}")
            self._goals |= {name: float(goal) for name, goal in goals.items()}
            _guarded(lambda: self._robot.send_action(dict(self._goals)))


class LeRobotBase(RepeatedBase):
    """A base with the actions ``x.vel`` [m/s], ``y.vel`` [m/s] and ``theta.vel`` [deg/s], as LeKiwi's.

    It observes velocities only: the pose is integrated from them, and drifts as any wheel odometry.

    Parameters
    ----------
    link
        To the robot.
    max_speed_m_s, max_turn_rad_s
        Limits; larger commands are rejected.
    rate_Hz
        Readings and commands per second; LeKiwi stops after half a second without one. ``None`` leaves
        it to the caller to call :meth:`step`.
    """

    def __init__(
        self,
        link: LeRobotLink,
        *,
        max_speed_m_s: float = 0.3,
        max_turn_rad_s: float = 1.5,
        rate_Hz: float | None = 20.0,
    ) -> None:
        super().__init__(max_speed_m_s, max_turn_rad_s)
        self._link = link
        self._state = BaseState(math.nan, 0.0, 0.0, 0.0, 0.0, 0.0)
        self.step()
        self._repeater = None if rate_Hz is None else Repeater(self.step, rate_Hz, "LeRobotBase")

    def step(self) -> None:
        """Read the velocities, add them to the pose, and repeat the command."""
        with self._lock:
            t_s, (forward, left, turn) = self._link.observe("x.vel", "y.vel", "theta.vel")
            before, rate = self._state, math.radians(turn)
            dt_s = t_s - before.t_s if math.isfinite(before.t_s) else 0.0
            heading = before.heading_rad + 0.5 * dt_s * rate
            c, s = math.cos(heading), math.sin(heading)
            x_m = before.x_m + dt_s * (c * forward - s * left)
            y_m = before.y_m + dt_s * (s * forward + c * left)
            self._state = BaseState(t_s, x_m, y_m, before.heading_rad + dt_s * rate, forward, rate)
            if self._command is not None:  # before the first command another program may drive
                speed, turn_rate = self._command
                turn_deg_s = math.degrees(turn_rate)
                self._link.command({"x.vel": speed, "y.vel": 0.0, "theta.vel": turn_deg_s})

    def _send(self) -> None:
        self.step()

    def state(self) -> BaseState:
        """Pose by integrated velocities, since this object was made."""
        self._check()
        with self._lock:
            return self._state


class LeRobotGripper(Repeated, Gripper):
    """A motor that opens and closes two fingers, by its position.

    Parameters
    ----------
    link
        To the robot.
    openings_m
        Position of the motor -> opening [m], two at least; between them linear. A jaw that turns needs some more than
        two: measure them with a calliper.
    motor
        Name of the motor; LeKiwi's is ``arm_gripper``.
    rate_Hz
        Readings and commands per second; ``None`` leaves it to the caller to call :meth:`step`.
    """

    def __init__(
        self,
        link: LeRobotLink,
        openings_m: Mapping[float, float],
        *,
        motor: str = "gripper",
        rate_Hz: float | None = 30.0,
    ) -> None:
        table = np.array(sorted(openings_m.items()), dtype=float).reshape(-1, 2)
        rises = np.diff(table[:, 1])
        if len(table) < 2 or not np.isfinite(table).all() or not ((rises > 0).all() or (rises < 0).all()):
            raise InputError(
                "LeRobotGripper", f"found {dict(openings_m)}, expected two openings at least, ascending or "
                "descending with the position", field="openings_m",
            )  # fmt: skip
        self._link, self._motor, self._table = link, motor, table
        self._by_opening = table[np.argsort(table[:, 1])]
        self._lock = threading.Lock()
        self._ramp: tuple[float, float, float, float] | None = None
        self._readings: deque[tuple[float, float]] = deque(maxlen=READINGS)
        self.step()
        self._repeater = None if rate_Hz is None else Repeater(self.step, rate_Hz, "LeRobotGripper")

    def step(self) -> None:
        """Read the opening, and command the next point of the motion."""
        with self._lock:
            t_s, _ = self._read()
            if self._ramp is None:
                return
            begin_s, start_m, target_m, speed_m_s = self._ramp
            gone_m = min(speed_m_s * (t_s - begin_s), abs(target_m - start_m))
            self._send(start_m + math.copysign(gone_m, target_m - start_m))
            if gone_m >= abs(target_m - start_m):
                self._ramp = None

    def move(self, opening_m: float, speed_m_s: float) -> None:
        """Start to move to an opening.

        Raises
        ------
        InputError
            The opening is beyond the table, or the speed not positive.
        DeviceError
            The robot does not answer.
        """
        low_m, high_m = max(0.0, self._by_opening[0, 1]), self._by_opening[-1, 1]
        check_numbers("LeRobotGripper.move", within(low_m, high_m), opening_m=opening_m)
        check_numbers("LeRobotGripper.move", POSITIVE, speed_m_s=speed_m_s)
        self._check()
        with self._lock:
            t_s, now_m = self._read()
            self._ramp = (t_s, now_m, float(opening_m), float(speed_m_s))

    def stop(self) -> None:
        """Hold the present opening."""
        with self._lock:
            self._ramp = None
            self._send(self._read()[1])

    def state(self) -> GripperState:
        """Newest reading; its speed is that over the last :data:`READINGS`."""
        self._check()
        with self._lock:
            (before_s, before_m), (t_s, opening_m) = self._readings[0], self._readings[-1]
        speed = (opening_m - before_m) / (t_s - before_s) if t_s > before_s else 0.0
        return GripperState(t_s, opening_m, speed)

    def _read(self) -> tuple[float, float]:
        t_s, (position,) = self._link.observe(f"{self._motor}.pos")
        reading = t_s, float(np.interp(position, self._table[:, 0], self._table[:, 1]))
        self._readings.append(reading)
        return reading

    def _send(self, opening_m: float) -> None:
        position = float(np.interp(opening_m, self._by_opening[:, 1], self._by_opening[:, 0]))
        self._link.command({f"{self._motor}.pos": position})

    def close(self) -> None:
        """Stop sending commands, and release the gripper; may be called repeatedly."""
        with self._lock:
            self._ramp = None
        super().close()


class LeRobotCamera(CameraBackend):
    """A driver for :class:`~visuohaptic.io.frames.live.LiveSource`, of a ``lerobot.cameras.Camera``.

    Parameters
    ----------
    camera
        The camera, connected or not; LeRobot's depth images are not read.
    rgb
        Its ``color_mode`` is RGB, which is LeRobot's default; ours is blue, green, red.
    timeout_ms
        Longest wait for an image [ms].
    """

    def __init__(self, camera: _LeRobotCameraDevice, *, rgb: bool = True, timeout_ms: float = 1000.0) -> None:
        self._camera, self._rgb, self._timeout_ms = camera, rgb, timeout_ms

    def open(self) -> None:
        """Connect, unless it is connected."""
        if not getattr(self._camera, "is_connected", False):
            _guarded(self._camera.connect, _CAMERA)

    def read(self) -> tuple[UInt8[np.ndarray, "rows columns *colour"], float]:
        """The next image that was not read yet, with the time at which it came [s]."""
        image = _guarded(lambda: self._camera.async_read(timeout_ms=self._timeout_ms), _CAMERA)
        return (np.ascontiguousarray(image[..., ::-1]) if self._rgb and image.ndim == 3 else image), time_s()

    def close(self) -> None:
        """Disconnect; may be called repeatedly."""
        if getattr(self._camera, "is_connected", True):
            with contextlib.suppress(DeviceError):
                _guarded(self._camera.disconnect, _CAMERA)


def _guarded(work: Callable[[], Any], what: str = "LeRobot") -> Any:
    try:
        return work()
    except Exception as error:
        raise DeviceError(f"{what}: {type(error).__name__}: {error}; is it connected?") from error
