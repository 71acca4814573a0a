"""Protocols of robots.

Simulated and real robots implement the same protocols; tasks
do not depend on which of them they control.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Generic, Protocol, Self, runtime_checkable

import numpy as np
from jaxtyping import Float

from .camera.frame import Frame
from .camera.model import Camera
from .camera.pose import Pose
from .errors import InputError

#: Version of the protocols. The major number changes if conforming robots may no longer conform.
ROBOT_CONTRACT = "1.1"


@runtime_checkable
class FrameSource(Protocol):
    """Timestamped images from a file, a live camera or the simulator.

    Examples
    --------
    Any object with these members conforms; even a list of frames needs a wrapper class:

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
        """Camera model, if the source knows it."""

    @property
    def frame_count(self) -> int | None:
        """Number of frames; ``None`` for a live camera."""

    def __iter__(self) -> Iterator[Frame]:
        """Frames in temporal order, until the source ends."""

    def close(self) -> None:
        """Release the file or device; may be called repeatedly."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


@dataclass(frozen=True, slots=True)
class BaseState:
    """Odometry of a mobile base."""

    t_s: float
    x_m: float  #: in the odometry frame
    y_m: float
    heading_rad: float  #: counter-clockwise from x
    speed_m_s: float  #: forward
    turn_rate_rad_s: float


@runtime_checkable
class MobileBase(Protocol):
    """A mobile platform on the floor.

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
        """Set the velocities; they remain active until the next call or :meth:`stop`.

        Parameters
        ----------
        speed_m_s
            Forward speed [m/s]; negative for reverse.
        turn_rate_rad_s
            Turn rate, counter-clockwise seen from above [rad/s].
        """

    def stop(self) -> None:
        """Stop as soon as possible."""

    def state(self) -> BaseState:
        """Latest odometry."""


@dataclass(frozen=True, slots=True)
class GripperState:
    """State of a two-finger gripper."""

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
        """Start to move to an opening width.

        Parameters
        ----------
        opening_m
            Distance between the fingers [m].
        speed_m_s
            Rate of change of the opening [m/s].
        """

    def stop(self) -> None:
        """Stop and hold the current opening."""

    def state(self) -> GripperState:
        """Latest reading."""


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
        """Start to move the tip along a straight line.

        Parameters
        ----------
        T_base_tip
            Target pose of the tip in the frame of the arm's base [m].
        speed_m_s
            Speed of the tip [m/s].
        """

    def stop(self) -> None:
        """Stop and hold the current pose."""

    def pose(self) -> tuple[float, Pose]:
        """Latest time [s] and pose of the tip in the base frame."""

    def reach_m(self) -> Float[np.ndarray, "2"]:
        """Minimum and maximum distance of the tip from the base."""


@dataclass(frozen=True, slots=True)
class MapPose:
    """Pose of a robot in a map."""

    t_s: float  #: of the measurement
    x_m: float
    y_m: float
    heading_rad: float  #: counter-clockwise from x


@runtime_checkable
class Localizer(Protocol):
    """Localises the robot in the map.

    Examples
    --------
    >>> class Known:
    ...     def locate(self): return MapPose(0.0, 1.0, 2.0, 0.0)
    >>> isinstance(Known(), Localizer)
    True
    """

    def locate(self) -> MapPose:
        """Latest pose in the map, with the time of the underlying measurement."""


class FingerTouch(Protocol):
    """Measurement of a finger's sensor in one frame."""

    @property
    def valid(self) -> bool:
        """Whether the measurement is valid."""

    @property
    def force_N(self) -> float:
        """Force of the finger on the touched object [N]; infinite and not valid: beyond the sensor's range."""

    @property
    def surface_m(self) -> float:
        """Position of the touched surface, relative to the centre between the fingers [m]; NaN without contact."""


class DepthImage(Protocol):
    """One image of a depth camera."""

    @property
    def t_s(self) -> float:
        """Acquisition time [s]."""

    @property
    def depth_m(self) -> Float[np.ndarray, "rows columns"]:
        """Depth along the optical axis [m]; NaN: not measured."""


@runtime_checkable
class DepthSource(Protocol):
    """A depth camera.

    Examples
    --------
    >>> class Blind:
    ...     camera = None
    ...     def read(self): raise NotImplementedError
    >>> isinstance(Blind(), DepthSource)
    True
    """

    @property
    def camera(self) -> Camera:
        """Camera model, for the size of the depth images."""

    def read(self) -> DepthImage:
        """Wait for the next image."""


def require_members(
    obj: object, protocol: type, where: str, role: str = "robot", *, members: Sequence[str] | None = None
) -> None:
    """Reject an object that lacks members of its protocol, before anything moves.

    Parameters
    ----------
    obj
        Object to check.
    protocol
        One of the protocols of this module, or another :class:`typing.Protocol`.
    where
        Name of the task, for the message.
    role
        Role of the object in the task, for the message.
    members
        Names of the members used; all of the protocol if omitted.

    Raises
    ------
    InputError
        A member is missing, is not callable, or does not accept the protocol's arguments. The one-line message names the
        member with its arguments and return type.
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
    """Public members of a protocol, and iteration; inherited ones first."""
    names: dict[str, None] = {}
    for cls in reversed(protocol.__mro__):
        if cls not in (object, Generic) and cls is not Protocol:
            names.update(dict.fromkeys(n for n in vars(cls) if not n.startswith("_") or n == "__iter__"))
    return list(names)


def _returned(function: object) -> str:
    found = inspect.signature(function).return_annotation if callable(function) else inspect.Signature.empty
    return "what its protocol states" if found is inspect.Signature.empty else str(found)


def _has(obj: object, name: str) -> bool:
    """Whether an attribute exists; properties are not evaluated, since they may access a device."""
    try:
        inspect.getattr_static(obj, name)
    except AttributeError:
        return hasattr(obj, name)  # provided by ``__getattr__``
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
    except ValueError:  # compiled function: unknown signature
        return ""
    return ""
