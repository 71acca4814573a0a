"""Exploration by pushing: settings, observation, command, states and outcomes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ...core.ranges import POSITIVE, check_ranges

if TYPE_CHECKING:
    from ...sensing.foam.material.foam_material import FoamMaterial

__all__ = ["ExploreCommand", "ExploreObservation", "ExploreOutcome", "ExploreSettings", "ExploreState"]

#: A depth, or an array of several.
DepthT = TypeVar("DepthT", float, np.ndarray)


class ExploreState(StrEnum):
    """What the platform is doing."""

    APPROACH = "approach"
    PUSH = "push"
    HALT = "halt"  #: standing still against the object: shape and deceleration are read here
    BACK_OFF = "back_off"


class ExploreOutcome(StrEnum):
    """How an exploration ended."""

    TAGGED = "tagged"  #: touched, pushed and tagged
    NOTHING_FOUND = "nothing_found"  #: no contact on the way
    SENSOR_FAILED = "sensor_failed"  #: too many frames in a row could not be trusted
    TIMED_OUT = "timed_out"
    CLOCK_STOPPED = "clock_stopped"  #: the platform's clock stands still
    DEVICE_FAILED = "device_failed"  #: a part of the robot, or its supervisor, refused to go on
    SOURCE_ENDED = "source_ended"  #: the camera delivered no more frames


@dataclass(frozen=True, slots=True)
class ExploreSettings:
    """Speeds, distances and limits of an exploration."""

    #: where something may be touched at any time; never faster than the foam takes up, see ``stopping_speed_m_s``
    approach_m_s: float = field(default=0.05, metadata=POSITIVE)
    #: where the floor ahead is seen to be free, only with scene tracking; what looks like the floor is not
    #: seen: faster than this the foam could not take up such a touch
    cruise_m_s: float = field(default=0.06, metadata=POSITIVE)
    #: how hard the platform may brake before what it sees
    brake_m_s2: float = field(default=0.3, metadata=POSITIVE)
    #: from a touch to the brake: the frame that first shows it, and the one in which it is read, at 30 Hz; longer
    #: where readings come later than that, see :class:`.force_guard.ReactionTime`
    reaction_s: float = field(default=2 / 30, metadata=POSITIVE)
    near_m: float = 0.02  #: gap from foam to obstacle at which it is down to ``approach_m_s``
    free_ahead_m: float = 0.0  #: floor before the foam that is known to be free at the start
    expected_m: float | None = None  #: travel to what is known to stand ahead, of a laser or a map
    push_m_s: float = field(default=0.03, metadata=POSITIVE)
    #: growth of the deflection from frame to frame until the object moves, and the speed right after the touch: the force
    #: at which it breaks away then lies within a tenth of itself, a standard deviation of 3 %, also of what is light or wide
    rise: float = field(default=0.1, metadata=POSITIVE)
    touch_m_s: float = field(default=0.005, metadata=POSITIVE)
    back_off_m_s: float = field(default=0.08, metadata=POSITIVE)
    search_m: float = field(default=0.5, metadata=POSITIVE)  #: how far to drive without a contact
    #: an object that has moved by this much is movable; text: the sensor's width
    push_m: float = field(default=0.06, metadata=POSITIVE)
    max_force_N: float = field(default=20.0, metadata=POSITIVE)  #: what the platform can push
    strain_fraction: float = 0.9  #: fraction of the densification strain at which to stop
    halt_s: float = 0.7  #: how long to stand still: shape and deceleration are read here
    back_off_m: float = 0.05
    blind_frames: int = 15  #: consecutive frames without a usable contour that end the push
    timeout_s: float = 60.0

    def __post_init__(self) -> None:
        check_ranges(self)

    def max_deflection_m(self, material: FoamMaterial) -> float:
        """Deflection at which to stop: beyond it the force is that of solid foam [m].

        Parameters
        ----------
        material
            Of the foam.
        """
        return self.strain_fraction * material.densification_strain * material.width_m

    def stopping_speed_m_s(self, depth_m: DepthT, reaction_s: float) -> DepthT:
        """Largest speed [m/s] from which the platform stands within a depth of foam: v t + v^2 / (2 a) = depth.

        Parameters
        ----------
        depth_m
            That the foam may take up, one or several [m].
        reaction_s
            From a touch to the brake [s].
        """
        t_s, a_m_s2 = reaction_s, self.brake_m_s2
        return a_m_s2 * ((t_s**2 + 2.0 * depth_m / a_m_s2) ** 0.5 - t_s)


@dataclass(frozen=True, slots=True)
class ExploreObservation:
    """What one frame and the platform's odometry say."""

    t_s: float  #: of the frame
    base_t_s: float  #: of the odometry, by the platform's clock
    travel_m: float  #: along the direction in which the exploration started
    speed_m_s: float  #: of the platform
    force_N: float  #: on the foam
    force_sigma_N: float  #: its standard deviation
    force_read: bool  #: whether contour and force can be used, also while unloading or saturated
    deflection_m: float  #: largest of the foam; NaN when no point was seen
    contact: bool  #: a contact in this frame
    in_contact: bool  #: the foam touches something, by all frames until now
    motion_travel_m: float = math.nan  #: travel at which the object began to move; NaN: not yet
    fell: bool = False  #: the object was seen to fall
    sight: bool = False  #: the scene ahead of the foam was looked at
    sight_valid: bool = False  #: and the obstacle mask of the frame can be trusted
    ahead_m: float = math.inf  #: gap from the foam to the nearest obstacle that is seen
    at_border: bool = False  #: that obstacle meets the border of the image: it may be nearer


@dataclass(frozen=True, slots=True)
class ExploreCommand:
    """Speed of the platform straight ahead [m/s]; 0: it stops."""

    speed_m_s: float
