"""Exploration by pushing: settings, observation, command, states and outcomes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ...core.ranges import POSITIVE, Ranged

if TYPE_CHECKING:
    from ...sensing.foam.material.foam_material import FoamMaterial

#: A depth, or an array of several.
DepthT = TypeVar("DepthT", float, np.ndarray)


class ExploreState(StrEnum):
    """What the platform is doing."""

    APPROACH = "approach"
    PUSH = "push"
    HALT = "halt"  #: standing still against the object: shape and deceleration are measured here
    BACK_OFF = "back_off"


class ExploreOutcome(StrEnum):
    """How an exploration ended."""

    TAGGED = "tagged"  #: touched, pushed and tagged
    NOTHING_FOUND = "nothing_found"  #: no contact on the way
    SENSOR_FAILED = "sensor_failed"  #: too many consecutive invalid frames
    TIMED_OUT = "timed_out"
    CLOCK_STOPPED = "clock_stopped"  #: the platform's clock has stopped
    DEVICE_FAILED = "device_failed"  #: a part of the robot, or the supervisor, raised an error
    SOURCE_ENDED = "source_ended"  #: the camera delivered no more frames


@dataclass(frozen=True, slots=True)
class ExploreSettings(Ranged):
    """Speeds, distances and limits of an exploration."""

    #: speed where contact is possible at any time; limited by the stopping distance of the foam, see ``stopping_speed_m_s``
    approach_m_s: float = field(default=0.05, metadata=POSITIVE)
    #: speed where the floor ahead is seen to be free, only with scene tracking; an obstacle that looks like the floor is
    #: not detected: at higher speeds the foam could not absorb such a contact
    cruise_m_s: float = field(default=0.06, metadata=POSITIVE)
    #: deceleration before a detected obstacle
    brake_m_s2: float = field(default=0.3, metadata=POSITIVE)
    #: time from contact to braking: the first frame that shows it, and the one in which it is processed, at 30 Hz; longer
    #: if readings arrive later than that, see :class:`.force_guard.ReactionTime`
    reaction_s: float = field(default=2 / 30, metadata=POSITIVE)
    near_m: float = 0.02  #: gap from foam to obstacle at which the speed is reduced to ``approach_m_s``
    free_ahead_m: float = 0.0  #: floor in front of the foam that is known to be free at the start
    expected_m: float | None = None  #: travel to a known obstacle ahead, from a laser or a map
    push_m_s: float = field(default=0.03, metadata=POSITIVE)
    #: relative growth of the deflection from frame to frame until the object moves, and the speed right after contact: the
    #: breakaway force is then resolved to a tenth, a standard deviation of 3 %, also for light or wide objects
    rise: float = field(default=0.1, metadata=POSITIVE)
    touch_m_s: float = field(default=0.005, metadata=POSITIVE)
    back_off_m_s: float = field(default=0.08, metadata=POSITIVE)
    search_m: float = field(default=0.5, metadata=POSITIVE)  #: maximum distance without contact
    #: an object that has moved by this much is movable; in the dissertation: the width of the sensor
    push_m: float = field(default=0.06, metadata=POSITIVE)
    max_force_N: float = field(default=20.0, metadata=POSITIVE)  #: maximum push force of the platform
    strain_fraction: float = 0.9  #: fraction of the densification strain at which to stop
    halt_s: float = 0.7  #: duration of the halt, in which shape and deceleration are measured
    back_off_m: float = 0.05
    max_invalid_frames: int = 15  #: number of consecutive frames without a valid contour that ends the push
    timeout_s: float = 60.0

    def max_deflection_m(self, material: FoamMaterial) -> float:
        """Deflection at which to stop: beyond it the foam is densified [m].

        Parameters
        ----------
        material
            Material of the foam.
        """
        return self.strain_fraction * material.densification_strain * material.width_m

    def stopping_speed_m_s(self, depth_m: DepthT, reaction_s: float) -> DepthT:
        """Maximum speed [m/s] from which the platform stops within a foam depth: v t + v^2 / (2 a) = depth.

        Parameters
        ----------
        depth_m
            Available foam depth, one or several [m].
        reaction_s
            Time from contact to braking [s].
        """
        t_s, a_m_s2 = reaction_s, self.brake_m_s2
        return a_m_s2 * ((t_s**2 + 2.0 * depth_m / a_m_s2) ** 0.5 - t_s)


@dataclass(frozen=True, slots=True)
class ExploreObservation:
    """Observation of one frame and the platform's odometry."""

    t_s: float  #: time of the frame
    base_t_s: float  #: time of the odometry on the platform's clock
    travel_m: float  #: along the initial heading
    speed_m_s: float  #: speed of the platform
    force_N: float  #: on the foam
    force_sigma_N: float  #: standard deviation of the force
    force_read: bool  #: whether contour and force are usable, also while unloading or saturated
    deflection_m: float  #: largest deflection of the foam; NaN if no point was measured
    contact: bool  #: whether this frame shows a contact
    in_contact: bool  #: whether the foam is in contact, from all frames so far
    motion_travel_m: float = math.nan  #: travel at which the object started to move; NaN: not yet
    fell: bool = False  #: whether the object has fallen
    sight: bool = False  #: whether the scene ahead of the foam was tracked
    sight_valid: bool = False  #: whether the obstacle mask of the frame is valid
    ahead_m: float = math.inf  #: gap from the foam to the nearest detected obstacle
    at_border: bool = False  #: whether that obstacle touches the border of the image: it may be nearer


@dataclass(frozen=True, slots=True)
class ExploreCommand:
    """Speed of the platform straight ahead [m/s]; 0: it stops."""

    speed_m_s: float
