"""What mapping by touch is set by, sees, tells and ends in."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from ....core.errors import InputError

__all__ = ["MapCommand", "MapObservation", "MapOutcome", "MapSettings", "MapState"]


class MapState(StrEnum):
    """What the platform is doing."""

    EXPLORE = "explore"  #: straight on, touch, push, back off: one exploration is one observation
    TURN_AWAY = "turn_away"  #: counter-clockwise, until it is parallel to what was touched
    ALONG = "along"
    TURN_BACK = "turn_back"  #: clockwise, to meet the obstacle again
    COME_FREE = "come_free"  #: something holds it: back, forward, or turning back


class MapOutcome(StrEnum):
    """How it ended."""

    MAPPED = "mapped"  #: as many contacts as were asked for
    SENSOR_FAILED = "sensor_failed"
    NOTHING_FOUND = "nothing_found"  #: several drives in a row met nothing
    STUCK = "stuck"  #: commanded to move, but stands
    TIMED_OUT = "timed_out"
    DEVICE_FAILED = "device_failed"  #: a part of the robot, or its supervisor, refused to go on
    SOURCE_ENDED = "source_ended"


@dataclass(frozen=True, slots=True)
class MapSettings:
    """How to map."""

    contacts: int = 22
    along_m: float = 0.4  #: distance along an obstacle before it is met again
    along_m_s: float = 0.15
    turn_rad_s: float = 0.6
    turn_tolerance_rad: float = 0.03
    front_m: float = 0.17  #: from the platform's centre to the origin of frame F
    min_score: float = 0.25  #: score of a primitive below which its contact points alone are trusted
    empty_drives: int = 6  #: consecutive drives without a contact that end it
    stuck_s: float = 1.5  #: commanded to move but not moving for this time
    frees: int = 12  #: how often to come free in a row without a contact
    free_m: float = 0.12  #: distance to come free
    free_rad: float = 0.6  #: or turn
    #: walls are straight and square to each other within; tiny: odometry alone
    square_rad: float = math.radians(4.0)
    scale_sigma: float = 0.02  #: of the distances that odometry tells, relative; tiny: they are right
    end_m: float = 0.03  #: narrower than this at the foam's end: it is met once more with the middle
    min_N: float = 0.3  #: force of a contact for the map: less is a graze
    timeout_s: float = 1800.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(
                    "MapSettings", f"found {getattr(self, name)}, expected more than 0", field=name
                )


@dataclass(frozen=True, slots=True)
class MapObservation:
    """One observation: a frame of a drive, or a whole exploration."""

    t_s: float
    x_m: float
    y_m: float
    heading_rad: float
    touched: bool  #: the foam bears on something now
    explored: str  #: outcome of the exploration that has just ended; empty during a drive
    contact: bool  #: it gave a contact for the map
    face_rad: float  #: direction of the touched face in the map, to be driven along; NaN unknown
    #: turn to the left that brings what the end of the foam has met before its middle; NaN where it was met well
    aside_rad: float = math.nan
    overload: bool = False  #: the force is at the platform's limit


@dataclass(frozen=True, slots=True)
class MapCommand:
    """One command to the platform."""

    explore: bool = False
    speed_m_s: float = 0.0
    turn_rate_rad_s: float = 0.0
