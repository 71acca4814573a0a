"""What a robot must offer, and nothing else.

The simulator and a real robot implement the same protocols, so that a task
never knows which of them it drives.
"""

from __future__ import annotations

import inspect
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Generic, Protocol, Self, runtime_checkable

import numpy as np
from jaxtyping import Float

from .camera.frame import Frame
from .camera.model import Camera
from .camera.pose import Pose
from .errors import InputError

__all__ = [
    "BaseState",
    "ClockWatch",
    "FrameSource",
    "Gripper",
    "GripperState",
    "MobileBase",
    "ProbeArm",
    "require_members",
]

#: A clock has stopped after this many control periods without advancing, five seconds of a loop at 50 Hz, or
#: after so long by the host's clock [s]: no robot's odometry or camera is that slow, no operator that patient.
MAX_STILL_PERIODS, MAX_STILL_S = 250, 5.0


@runtime_checkable
class FrameSource(Protocol):
    """Images with times, from a file, a live camera or the simulator.

    Examples
    --------
    Anything with these members is one; a list of frames as well needs a class around it:

    >>> class Still:
    ...     camera, frame_count = None, 1
    ...     def __iter__(self): return iter([Frame(np.zeros((4, 6), np.uint8), 0.0, 0)])
    ...     def close(self): pass
    ...     def __enter__(self): return self
    ...     def __exit__(self, *error): self.close()
    >>> isinstance(Still(), FrameSource), [frame.t_s for frame in Still()]
    (True, [0.0])
    """

    @property
    def camera(self) -> Camera | None:
        """The camera's model where the source knows it."""

    @property
    def frame_count(self) -> int | None:
        """How many frames there are; ``None`` for a live camera."""

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order of time, until the source ends."""

    def close(self) -> None:
        """Release the file or device; harmless when repeated."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


@dataclass(frozen=True, slots=True)
class BaseState:
    """Where a mobile base believes to be."""

    t_s: float
    x_m: float  #: in the odometry frame
    y_m: float
    heading_rad: float  #: counter-clockwise from x
    speed_m_s: float  #: forward
    turn_rate_rad_s: float


@runtime_checkable
class MobileBase(Protocol):
    """A platform that drives on the floor.

    Examples
    --------
    >>> class Standing:
    ...     def drive(self, speed_m_s, turn_rate_rad_s): pass
    ...     def stop(self): pass
    ...     def state(self): return BaseState(0.0, 1.0, 2.0, 0.0, 0.0, 0.0)
    >>> isinstance(Standing(), MobileBase), Standing().state().y_m
    (True, 2.0)
    """

    def drive(self, speed_m_s: float, turn_rate_rad_s: float) -> None:
        """Set the velocities; they hold until the next call or :meth:`stop`.

        Parameters
        ----------
        speed_m_s
            Forward speed [m/s]; negative drives backwards.
        turn_rate_rad_s
            Turn rate, counter-clockwise seen from above [rad/s].
        """

    def stop(self) -> None:
        """Stand still as soon as possible."""

    def state(self) -> BaseState:
        """Newest odometry."""


@dataclass(frozen=True, slots=True)
class GripperState:
    """Opening of a two-finger gripper."""

    t_s: float
    opening_m: float
    speed_m_s: float


@runtime_checkable
class Gripper(Protocol):
    """A two-finger gripper with a linear drive.

    Examples
    --------
    >>> class Instant:
    ...     def __init__(self): self.opening_m = 0.1
    ...     def move(self, opening_m, speed_m_s): self.opening_m = opening_m
    ...     def stop(self): pass
    ...     def state(self): return GripperState(0.0, self.opening_m, 0.0)
    >>> gripper = Instant()
    >>> gripper.move(0.04, 0.02)
    >>> isinstance(gripper, Gripper), gripper.state().opening_m
    (True, 0.04)
    """

    def move(self, opening_m: float, speed_m_s: float) -> None:
        """Start to move to an opening.

        Parameters
        ----------
        opening_m
            Distance of the fingers [m].
        speed_m_s
            Rate at which the opening changes [m/s].
        """

    def stop(self) -> None:
        """Hold the present opening."""

    def state(self) -> GripperState:
        """Newest reading."""


@runtime_checkable
class ProbeArm(Protocol):
    """An arm with a probe tip.

    Examples
    --------
    >>> class Instant:
    ...     def move_linear(self, T_base_tip, speed_m_s): self.T_base_tip = T_base_tip
    ...     def stop(self): pass
    ...     def pose(self): return 0.0, self.T_base_tip
    ...     def reach_m(self): return np.array([0.1, 0.8])
    >>> arm = Instant()
    >>> arm.move_linear(Pose(np.eye(3), np.array([0.3, 0.0, 0.2])), 0.05)
    >>> isinstance(arm, ProbeArm), float(arm.pose()[1].translation_m[0])
    (True, 0.3)
    """

    def move_linear(self, T_base_tip: Pose, speed_m_s: float) -> None:
        """Start to move the tip in a straight line.

        Parameters
        ----------
        T_base_tip
            Target of the tip in the frame of the arm's base [m].
        speed_m_s
            Speed of the tip [m/s].
        """

    def stop(self) -> None:
        """Hold the present pose."""

    def pose(self) -> tuple[float, Pose]:
        """Newest time [s] and pose of the tip in the base frame."""

    def reach_m(self) -> Float[np.ndarray, "2"]:
        """Smallest and largest distance of the tip from the base."""


def require_members(
    obj: object, protocol: type, where: str, role: str = "robot", *, members: Sequence[str] | None = None
) -> None:
    """Refuse an object that lacks what its protocol asks for, before anything moves.

    Parameters
    ----------
    obj
        What was given.
    protocol
        One of the protocols of this module, or another :class:`typing.Protocol`.
    where
        The task, for the message.
    role
        What the object is there for, for the message.
    members
        Names that are used; all of the protocol without.

    Raises
    ------
    InputError
        A member is missing, is not callable, or does not take the protocol's arguments. The one line names the
        member with its arguments and what it must return.
    """
    for name in members or _members(protocol):
        declared = inspect.getattr_static(protocol, name)
        if isinstance(declared, property):
            expected, returned = f"property {name}", _returned(declared.fget)
            fault = "" if _has(obj, name) else "without"
        else:
            parameters = list(inspect.signature(declared).parameters.values())[1:]
            arguments = ", ".join(parameter.name for parameter in parameters)
            expected, returned = f"method {name}({arguments})", _returned(declared)
            fault = _method_fault(obj, name, parameters)
        if fault:
            raise InputError(
                where,
                f"found {role} of type {type(obj).__name__} {fault} {expected}, which must return {returned}",
                remedy=f"see {protocol.__module__}.{protocol.__name__}",
            )


def _members(protocol: type) -> list[str]:
    """Public members of a protocol, and iteration; what it inherits first."""
    names: dict[str, None] = {}
    for cls in reversed(protocol.__mro__):
        if cls not in (object, Generic) and cls is not Protocol:
            names.update(dict.fromkeys(n for n in vars(cls) if not n.startswith("_") or n == "__iter__"))
    return list(names)


def _returned(function: object) -> str:
    found = inspect.signature(function).return_annotation if callable(function) else inspect.Signature.empty
    return "what its protocol says" if found is inspect.Signature.empty else str(found)


def _has(obj: object, name: str) -> bool:
    """Whether there is an attribute; a property is not evaluated, since it may ask a device."""
    try:
        inspect.getattr_static(obj, name)
    except AttributeError:
        return hasattr(obj, name)  # answered by ``__getattr__``
    return True


def _method_fault(obj: object, name: str, parameters: list[inspect.Parameter]) -> str:
    if not _has(obj, name):
        return "without"
    method = getattr(obj, name)
    if not callable(method):
        return f"whose {name} is {type(method).__name__}, expected the"
    try:
        inspect.signature(method).bind(*parameters)
    except TypeError:
        return f"whose {name} takes other arguments than the"
    except ValueError:  # compiled: its arguments are not known
        return ""
    return ""


class ClockWatch:
    """Notices a robot's clock that stands still, by counted control periods and by the host's clock.

    A time-out by the robot's clock alone never comes when that clock stands. Each control period
    calls :meth:`update`; the clock has stopped when it did not advance for ``max_periods`` of them,
    or for ``max_host_s`` of the host's monotonic clock.

    Parameters
    ----------
    max_periods
        Control periods; ``None`` for a caller whose periods have no length, as one that polls.
    max_host_s
        Time of the host [s].
    host_clock
        Returns the host's monotonic time [s].
    """

    def __init__(
        self,
        *,
        max_periods: int | None = MAX_STILL_PERIODS,
        max_host_s: float = MAX_STILL_S,
        host_clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._max_periods, self._max_host_s, self._host_clock = max_periods, max_host_s, host_clock
        self._newest_s, self._since_s, self.periods = -math.inf, math.nan, 0

    def update(self, t_s: float) -> str:
        """Take the robot's time, and judge whether its clock runs.

        Parameters
        ----------
        t_s
            Time by the robot's clock [s].

        Returns
        -------
        str
            Why the clock counts as stopped; empty while it runs.
        """
        if t_s > self._newest_s or math.isnan(self._since_s):
            self._newest_s = t_s if math.isfinite(t_s) else self._newest_s
            self._since_s, self.periods = self._host_clock(), 0
            return ""
        self.periods += 1
        host_s = self._host_clock() - self._since_s
        if host_s > self._max_host_s or (self._max_periods is not None and self.periods >= self._max_periods):
            return f"the robot's clock stands at {t_s:g} s for {self.periods} control periods"
        return ""
