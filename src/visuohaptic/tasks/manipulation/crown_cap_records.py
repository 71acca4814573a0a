"""Opening a crown cap: settings, observation, command and outcome."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

import numpy as np
from jaxtyping import Float

from ...core.ranges import FINITE, POSITIVE, check_ranges
from ..framework.trace import Ending, Trace

Vector = tuple[float, float, float]


class CapState(StrEnum):
    """Rows of Table 3.1."""

    FIND = "find"  #: scanning motion until the cap is detected
    TRACK = "track"  #: average sightings from above
    APPROACH = "approach"  #: move the tool near the cap
    PUSH_DOWN = "push_down"
    FEEL = "feel"  #: hold, and measure where the bridge is loaded
    LIFT = "lift"  #: before pressing at another position
    FORWARD = "forward"
    ROTATE = "rotate"
    LEAVE = "leave"  #: retreat with or without the cap
    CHECK = "check"


class CapOutcome(StrEnum):
    """How it ended."""

    OPENED = "opened"
    NOT_FOUND = "not_found"  #: the cap was not detected on the scanning motion
    LOST = "lost"  #: detected before, but not from above
    OUT_OF_REACH = "out_of_reach"
    SENSOR_FAILED = "sensor_failed"  #: too many consecutive invalid wrenches
    NO_CONTACT = "no_contact"  #: no contact at the detected position
    NOT_ALIGNED = "not_aligned"  #: the bridge could not be centred
    STILL_CLOSED = "still_closed"  #: the cap is still detected after the maximum number of attempts
    NOT_VERIFIED = "not_verified"  #: the moment collapsed, but the bottle is not visible
    TOO_TIGHT = "too_tight"  #: the moment exceeds the limit of the sensor
    TIMED_OUT = "timed_out"
    DEVICE_FAILED = "device_failed"  #: a part of the robot, or the supervisor, raised an error
    SOURCE_ENDED = "source_ended"


class CapSighting(Protocol):
    """Detection of the cap."""

    @property
    def valid(self) -> bool: ...
    @property
    def position_tip_m(self) -> Float[np.ndarray, "3"]:
        """Centre of the top of the cap in the tip frame [m]."""


@dataclass(frozen=True, slots=True)
class CapSettings:
    """Settings of the opening."""

    #: positions of the tip in the base frame for the scanning motion
    scan_m: tuple[Vector, ...] = field(default=(), metadata=FINITE)
    look_above_m: float = 0.18  #: height from which the cap is tracked
    look_frames: int = 10  #: number of sightings that are averaged
    hover_m: float = 0.035  #: first height above the detected position: larger than the error of detection
    depth_m: float = 0.02  #: how far below that position contact is searched
    behind_m: float = 0.005  #: the bridge presses this far behind the centre of the cap
    hook_behind_m: float = 0.015  #: opener: distance from the bridge back to the hook
    bridge_half_m: float = 0.015  #: opener: half width of the bridge
    touch_N: float = 1.5  #: F_z of a contact
    press_N: float = 6.0  #: F_z at which the position of the load on the bridge is measured
    hold_frames: int = 8  #: number of wrenches that are averaged
    centred_m: float = 0.007  #: maximum distance of the load from the middle of a centred bridge
    side_step_m: float = 0.004  #: first sideward step; halved whenever the side changes
    lift_m: float = 0.004
    presses: int = 12  #: maximum number of presses per attempt
    press_down_N: float = 3.0  #: F_z during the forward motion
    forward_N: float = 3.0  #: F_y of a hook at the neck
    forward_m: float = 0.022  #: maximum forward motion
    turn_rad: float = 0.6  #: maximum rotation for opening
    engaged_Nm: float = 0.5  #: minimum M_x of a hook under the rim
    broken: float = 0.3  #: the cap is off when M_x falls below this fraction of its peak
    max_Nm: float = 6.0
    attempts: int = 5
    #: raise of the hook in each attempt
    tilts_rad: tuple[float, ...] = field(default=(0.0, -0.05, 0.05, -0.1, 0.1), metadata=FINITE)
    back_m: float = 0.006  #: backward step if the hook is on the cap
    ahead_m: float = 0.007  #: forward step if the bridge misses the cap
    fast_m_s: float = 0.1
    slow_m_s: float = 0.01
    turn_m_s: float = 0.01  #: speed of the hook during rotation
    max_invalid_frames: int = 15  #: number of consecutive invalid wrenches that ends the task
    state_timeout_s: float = 40.0

    def __post_init__(self) -> None:
        check_ranges(self, POSITIVE)


@dataclass(frozen=True, slots=True)
class CapObservation:
    """One observation: arm, wrench and sighting of one frame."""

    t_s: float
    tip_m: Vector  #: in the base frame
    turn_rad: Vector  #: rotation vector of the tip in the base frame
    felt: bool  #: whether the wrench is valid
    force_N: Vector  #: on the tool, in the axes of the tool
    moment_Nm: Vector  #: about the tip, in the axes of the tool
    seen: bool
    cap_m: Vector  #: centre of the top of the cap in the base frame; NaN if not detected


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
    attempts: int  #: number of rotations of the tool

    @property
    def opened(self) -> bool:
        """Whether the cap came off, verified by the camera."""
        return self.ending.success
