"""Interface of a travel: what is perceived and commanded, states, outcomes, records, settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Protocol, runtime_checkable

from ....core.ranges import FINITE, check_ranges

__all__ = [
    "PERIOD_S",
    "ObjectSighting",
    "PassageSenses",
    "TravelCommand",
    "TravelObservation",
    "TravelOutcome",
    "TravelRecord",
    "TravelSenses",
    "TravelSettings",
    "TravelState",
]

#: Control period [s].
PERIOD_S = 0.02


@runtime_checkable
class TravelSenses(Protocol):
    """What the robot perceives."""

    def pose(self) -> tuple[float, float, float]:
        """Where the robot is in the map: x, y [m], heading [rad]."""

    def touch(self) -> tuple[float, tuple[float, float] | None]:
        """Force on the rim [N], and where it acts in the map [m].

        0 and ``None`` without touch; a NaN force when it was not read.
        """

    def look(self, id: str) -> tuple[float, float, float] | None:
        """Where an object is: x, y of its outline's centroid [m], turn since the travel began [rad].

        Parameters
        ----------
        id
            Of the object in the planning problem.

        Returns
        -------
        tuple or None
            ``None`` when it cannot be seen now.
        """


@runtime_checkable
class PassageSenses(Protocol):
    """Doors and elevators: how they are asked to open, and whether they are."""

    def request(self, id: str) -> None:
        """Ask a passage to open: step into its motion detector, call it; asked once per wait.

        Parameters
        ----------
        id
            Of the passage in the planning problem.
        """

    def is_open(self, id: str) -> bool:
        """Whether the robot can drive through.

        Parameters
        ----------
        id
            Of the passage in the planning problem.
        """


class TravelState(StrEnum):
    """What the robot is doing."""

    PLAN = "plan"
    DRIVE = "drive"
    PUSH = "push"
    SIDEWARD = "sideward"  #: past an object, which is brushed aside
    EXPLORE = "explore"
    TURN = "turn"
    WAIT = "wait"  #: before a passage
    DOOR = "door"  #: pushing a wing open, and through
    BACK_OFF = "back off"


class TravelOutcome(StrEnum):
    """How the travel ended."""

    ARRIVED = "arrived"
    NO_PLAN = "no plan"
    TIMED_OUT = "timed out"
    GAVE_UP = "gave up"  #: after too many plans
    CLOCK_STOPPED = "clock stopped"  #: the robot's clock stands still
    DEVICE_FAILED = "device_failed"  #: a part of the robot, or its supervisor, refused to go on
    SENSOR_FAILED = "sensor failed"  #: the force was not read for too long


@dataclass(frozen=True, slots=True)
class ObjectSighting:
    """Where one object was seen."""

    id: str
    place_m: tuple[float, float, float] | None  #: x, y of its centroid [m], turn [rad]; ``None``: not seen


@dataclass(frozen=True, slots=True)
class TravelObservation:
    """What the robot perceives in one control period."""

    t_s: float  #: by the periods that were waited
    base_t_s: float  #: by the clock of the base
    pose_m: tuple[float, float, float]  #: in the map: x, y [m], heading [rad]
    speed_m_s: float
    turn_rate_rad_s: float
    force_N: float  #: on the rim; NaN when it was not read
    point_m: tuple[float, float] | None  #: where it acts in the map; ``None`` without touch
    sightings: tuple[ObjectSighting, ...] = ()  #: of the objects that the last command asked for
    open: tuple[str, ...] = ()  #: passages that the last command asked for, and that are open


@dataclass(frozen=True, slots=True)
class TravelCommand:
    """Velocity for the next control period, and the objects to look at after it."""

    speed_m_s: float = 0.0
    turn_rate_rad_s: float = 0.0
    look: tuple[str, ...] = ()
    passage: str = ""  #: that is waited for


@dataclass(frozen=True, slots=True)
class TravelRecord:
    """One event of a travel; :mod:`visuohaptic.core.codec` writes it as JSON and reads it."""

    t_s: float = field(metadata=FINITE)  #: by the base's clock
    state: str  #: of the machine, when it happened
    event: str  #: "planned", "pushed", "looked", ...
    #: estimated, of the robot in the map: x, y [m], heading [rad]
    pose_m: tuple[float, float, float] = field(metadata=FINITE)
    object: str = ""  #: that it concerns
    values: Mapping[str, Any] = field(default_factory=dict)  #: numbers and texts that belong to it

    check_read = check_ranges  # a stored record has numbers; a robot that is lost may not know its pose


@dataclass(frozen=True, slots=True)
class TravelSettings:
    """Margins, limits and tolerances of a travel."""

    #: Room that plans keep beside the robot and beside what it pushes, tried in order [m]: cells, tracking
    #: and drift take some of it
    margins_m: tuple[tuple[float, float], ...] = (
        (0.045, 0.03),
        (0.045, 0.0),
        (0.025, 0.0),
        (0.01, 0.0),
        (0.0, 0.0),
    )
    bumps: int = 2  #: into walls that are known, at one margin, before only larger ones are trusted
    timeout_s: float = 1800.0  #: of the whole travel, by the base's clock and by the periods waited
    plans: int = 40  #: at most
    drive_stall_s: float = 5.0  #: without getting on
    bump_N: float = 3.0  #: force that ends a drive, when it lasts
    bump_s: float = 0.4
    back_off_m: float = 0.10
    leave_m: float = 0.03  #: away from a wall that was touched
    turns: int = 6  #: pushes beside the centre of an object, where no straight one helps
    turn_margins_m: tuple[float, ...] = (0.025, 0.0)  #: room that they keep, tried in order [m]
    explore_m: float = 0.06  #: length of the push that explores
    moved_m: float = 0.015  #: an object that went less has not moved
    failures: int = 4  #: pushes of one object that may fail before it counts as fixed
    look_s: float = 0.1  #: between looks during a push
    near_m: float = 0.03  #: an object within this of its goal, and turned by less, needs no new plan
    near_rad: float = 0.12
    patience_sigma: float = 3.0  #: a passage is given up after the expected wait and so many deviations
