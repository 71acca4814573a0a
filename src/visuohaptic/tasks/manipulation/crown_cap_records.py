"""Opening a crown cap: settings, observation, command and outcome."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ..framework.trace import Ending, Trace

__all__ = [
    "CapCommand",
    "CapObservation",
    "CapOpening",
    "CapOutcome",
    "CapSettings",
    "CapSighting",
    "CapState",
    "Vector",
]

Vector = tuple[float, float, float]


class CapState(StrEnum):
    """Rows of Table 3.1."""

    FIND = "find"  #: scanning motion until the cap is detected
    TRACK = "track"  #: watch it from above
    APPROACH = "approach"  #: tool near the cap
    PUSH_DOWN = "push_down"
    FEEL = "feel"  #: hold and read where the bridge bears
    LIFT = "lift"  #: before the next press at another place
    FORWARD = "forward"
    ROTATE = "rotate"
    LEAVE = "leave"  #: back off with or without the cap
    CHECK = "check"


class CapOutcome(StrEnum):
    """How it ended."""

    OPENED = "opened"
    NOT_FOUND = "not_found"  #: the cap was not detected on the scanning motion
    LOST = "lost"  #: seen before, but no longer from above
    OUT_OF_REACH = "out_of_reach"
    SENSOR_FAILED = "sensor_failed"  #: too many wrenches in a row could not be trusted
    NO_CONTACT = "no_contact"  #: nothing met where the cap was seen
    NOT_ALIGNED = "not_aligned"  #: the bridge could not be centred
    STILL_CLOSED = "still_closed"  #: turned as often as allowed, the cap is still seen
    NOT_VERIFIED = "not_verified"  #: the moment broke down, but the bottle could not be looked at
    TOO_TIGHT = "too_tight"  #: more moment than the sensor bears
    TIMED_OUT = "timed_out"
    DEVICE_FAILED = "device_failed"  #: a part of the robot, or its supervisor, refused to go on
    SOURCE_ENDED = "source_ended"


class CapSighting(Protocol):
    """What a detector or tracker says of the cap."""

    @property
    def valid(self) -> bool: ...
    @property
    def position_tip_m(self) -> Float[np.ndarray, "3"]:
        """Centre of the cap's top in the tip frame."""


@dataclass(frozen=True, slots=True)
class CapSettings:
    """How to open."""

    scan_m: tuple[Vector, ...] = ()  #: places of the tip in the base for the scanning motion
    look_above_m: float = 0.18  #: height from which the cap is tracked
    look_frames: int = 10  #: sightings that are averaged
    hover_m: float = 0.035  #: first height above where the cap was seen: more than sight errs
    depth_m: float = 0.02  #: how far below that place to look for it
    behind_m: float = 0.005  #: the bridge goes down this far before the cap's centre
    hook_behind_m: float = 0.015  #: of the opener: from the bridge back to the hook
    bridge_half_m: float = 0.015  #: of the opener: half width of the bridge
    touch_N: float = 1.5  #: F_z of a touch
    press_N: float = 6.0  #: F_z at which is read where the bridge bears
    hold_frames: int = 8  #: wrenches that are averaged
    centred_m: float = 0.007  #: the bridge is centred when it bears so near to its middle
    side_step_m: float = 0.004  #: first step aside; halved whenever the side changes
    lift_m: float = 0.004
    presses: int = 12  #: how often to press for one attempt
    press_down_N: float = 3.0  #: F_z that is kept on the way forward
    forward_N: float = 3.0  #: F_y of a hook at the neck
    forward_m: float = 0.022  #: farthest way forward
    turn_rad: float = 0.6  #: farthest turn for opening
    engaged_Nm: float = 0.5  #: M_x that a hook under the rim gives
    broken: float = 0.3  #: the cap is off when M_x falls to this fraction of its peak
    max_Nm: float = 6.0
    attempts: int = 5
    tilts_rad: tuple[float, ...] = (0.0, -0.05, 0.05, -0.1, 0.1)  #: raise of the hook in each attempt
    back_m: float = 0.006  #: step backward when the hook bears on the cap
    ahead_m: float = 0.007  #: step forward when the bridge misses it
    fast_m_s: float = 0.1
    slow_m_s: float = 0.01
    turn_m_s: float = 0.01  #: speed of the hook while it turns
    blind_frames: int = 15  #: consecutive wrenches that cannot be trusted and end the task
    state_timeout_s: float = 40.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if name not in ("scan_m", "tilts_rad") and not (math.isfinite(value) and value > 0):
                raise InputError("CapSettings", f"found {value}, expected more than 0", field=name)


@dataclass(frozen=True, slots=True)
class CapObservation:
    """One observation: arm, wrench and sighting of one frame."""

    t_s: float
    tip_m: Vector  #: in the base
    turn_rad: Vector  #: rotation vector of the tip in the base
    felt: bool  #: the wrench can be trusted
    force_N: Vector  #: on the tool, axes of the tool
    moment_Nm: Vector  #: about the tip
    seen: bool
    cap_m: Vector  #: centre of the cap's top in the base; NaN when not seen


@dataclass(frozen=True, slots=True)
class CapCommand:
    """One command to the arm."""

    move: bool  #: False: stop
    tip_m: Vector = (0.0, 0.0, 0.0)
    turn_rad: Vector = (0.0, 0.0, 0.0)
    speed_m_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class CapOpening:
    """Result of an opening."""

    ending: Ending
    trace: Trace
    attempts: int  #: how often the tool was turned

    @property
    def opened(self) -> bool:
        """Whether the cap came off and was seen to be gone."""
        return self.ending.success
