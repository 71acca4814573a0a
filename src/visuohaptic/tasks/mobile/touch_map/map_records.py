"""Mapping by touch: settings, observation, command, states and outcomes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from ....core.ranges import POSITIVE, check_ranges


class MapState(StrEnum):
    """What the platform is doing."""

    EXPLORE = "explore"  #: straight on, touch, push, back off: one exploration is one observation
    TURN_AWAY = "turn_away"  #: counter-clockwise, until it is parallel to what was touched
    ALONG = "along"
    TURN_BACK = "turn_back"  #: clockwise, to meet the obstacle again
    COME_FREE = "come_free"  #: free the platform: backward, forward, or turning back


class MapOutcome(StrEnum):
    """How it ended."""

    MAPPED = "mapped"  #: requested number of contacts reached
    SENSOR_FAILED = "sensor_failed"
    NOTHING_FOUND = "nothing_found"  #: several consecutive drives without contact
    STUCK = "stuck"  #: commanded to move, but at rest
    TIMED_OUT = "timed_out"
    DEVICE_FAILED = "device_failed"  #: a part of the robot, or the supervisor, raised an error
    SOURCE_ENDED = "source_ended"


@dataclass(frozen=True, slots=True)
class MapSettings:
    """Settings of the mapping."""

    contacts: int = 22
    along_m: float = 0.4  #: distance driven along an obstacle before the next contact
    along_m_s: float = 0.15
    turn_rad_s: float = 0.6
    turn_tolerance_rad: float = 0.03
    front_m: float = 0.17  #: distance from the platform's centre to the origin of frame F
    min_score: float = 0.25  #: minimum score of a primitive; below it only its contact points are used
    empty_drives: int = 6  #: number of consecutive drives without contact that ends the task
    stuck_s: float = 1.5  #: time at rest despite a motion command after which the platform is stuck
    frees: int = 12  #: maximum number of consecutive attempts to come free without a contact
    free_m: float = 0.12  #: distance of such an attempt
    free_rad: float = 0.6  #: rotation of such an attempt
    #: tolerance of straight and perpendicular walls; tiny: odometry alone
    square_rad: float = math.radians(4.0)
    scale_sigma: float = 0.02  #: relative standard deviation of the odometry scale; tiny: odometry is exact
    end_m: float = 0.03  #: a narrower contact at the end of the foam is repeated with its middle
    min_N: float = 0.3  #: minimum force of a contact for the map
    timeout_s: float = 1800.0

    def __post_init__(self) -> None:
        check_ranges(self, POSITIVE)


@dataclass(frozen=True, slots=True)
class MapObservation:
    """One observation: a frame of a drive, or a whole exploration."""

    t_s: float
    x_m: float
    y_m: float
    heading_rad: float
    touched: bool  #: whether the foam is in contact
    explored: str  #: outcome of the exploration that has just ended; empty during a drive
    contact: bool  #: whether it yielded a contact for the map
    face_rad: float  #: direction of the touched face in the map, to be followed; NaN: unknown
    #: left turn that brings an object touched by the end of the foam in front of its middle; NaN if not needed
    centring_turn_rad: float = math.nan
    overload: bool = False  #: whether the force is at the platform's limit


@dataclass(frozen=True, slots=True)
class MapCommand:
    """One command to the platform."""

    explore: bool = False
    speed_m_s: float = 0.0
    turn_rate_rad_s: float = 0.0
