"""Types of a navigation task: observations and commands, states, outcomes, records, settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Protocol, runtime_checkable

from ....core.ranges import FINITE, check_ranges

#: Control period [s].
PERIOD_S = 0.02


@runtime_checkable
class TravelSenses(Protocol):
    """Perception of the robot."""

    def pose(self) -> tuple[float, float, float]:
        """Pose of the robot in the map: x, y [m], heading [rad]."""

    def touch(self) -> tuple[float, tuple[float, float] | None]:
        """Force on the rim [N], and its point of application in the map [m].

        0 and ``None`` without contact; a NaN force if not measured.
        """

    def look(self, id: str) -> tuple[float, float, float] | None:
        """Locate an object: x, y of its outline's centroid [m], rotation since the start of the task [rad].

        Parameters
        ----------
        id
            Identifier of the object in the planning problem.

        Returns
        -------
        tuple or None
            ``None`` if it cannot be located now.
        """


@runtime_checkable
class PassageSenses(Protocol):
    """Requests and sensors for doors and elevators."""

    def request(self, id: str) -> None:
        """Ask a passage to open, for example by its motion detector or a call; called once per wait.

        Parameters
        ----------
        id
            Identifier of the passage in the planning problem.
        """

    def is_open(self, id: str) -> bool:
        """Whether the robot can drive through.

        Parameters
        ----------
        id
            Identifier of the passage in the planning problem.
        """


class TravelState(StrEnum):
    """What the robot is doing."""

    PLAN = "plan"
    DRIVE = "drive"
    PUSH = "push"
    SIDEWARD = "sideward"  #: drive past an object and push it aside
    EXPLORE = "explore"
    TURN = "turn"
    WAIT = "wait"  #: in front of a passage
    DOOR = "door"  #: push a door leaf open, and drive through
    BACK_OFF = "back off"


class TravelOutcome(StrEnum):
    """How the task ended."""

    ARRIVED = "arrived"
    EXPLORED = "floor explored"  #: nothing is left that is worth exploring in the remaining time
    NO_PLAN = "no plan"
    TIMED_OUT = "timed out"
    GAVE_UP = "gave up"  #: maximum number of plans reached
    CLOCK_STOPPED = "clock stopped"  #: the robot's clock has stopped
    DEVICE_FAILED = "device_failed"  #: a part of the robot, or the supervisor, raised an error
    SENSOR_FAILED = "sensor failed"  #: no valid force for too long


@dataclass(frozen=True, slots=True)
class ObjectSighting:
    """Located pose of an object."""

    id: str
    #: x, y of its centroid [m], rotation [rad]; ``None``: not located
    place_m: tuple[float, float, float] | None


@dataclass(frozen=True, slots=True)
class TravelObservation:
    """Observation of one control period."""

    t_s: float  #: time by the number of periods
    base_t_s: float  #: time on the clock of the base
    pose_m: tuple[float, float, float]  #: of the robot in the map: x, y [m], heading [rad]
    speed_m_s: float
    turn_rate_rad_s: float
    force_N: float  #: on the rim; NaN if not measured
    point_m: tuple[float, float] | None  #: its point of application in the map; ``None`` without contact
    sightings: tuple[ObjectSighting, ...] = ()  #: objects requested by the last command
    open: tuple[str, ...] = ()  #: open passages among those requested by the last command


@dataclass(frozen=True, slots=True)
class TravelCommand:
    """Velocity for the next control period, and the objects to locate after it."""

    speed_m_s: float = 0.0
    turn_rate_rad_s: float = 0.0
    look: tuple[str, ...] = ()
    passage: str = ""  #: passage whose opening is awaited


@dataclass(frozen=True, slots=True)
class TravelRecord:
    """One event of the task; :mod:`visuohaptic.core.codec` reads and writes it as JSON."""

    t_s: float = field(metadata=FINITE)  #: time on the base's clock
    state: str  #: state of the machine at the event
    event: str  #: "planned", "pushed", "looked", ...
    #: estimated pose of the robot in the map: x, y [m], heading [rad]
    pose_m: tuple[float, float, float] = field(metadata=FINITE)
    object: str = ""  #: identifier of the object concerned
    values: Mapping[str, Any] = field(default_factory=dict)  #: numbers and texts of the event

    check_read = check_ranges  # a stored record has numbers; a robot that is lost may not know its pose


@dataclass(frozen=True, slots=True)
class TravelSettings:
    """Margins, limits and tolerances of the task."""

    #: margins of plans beside the robot and beside a pushed object, tried in order [m]; discretisation, tracking
    #: and drift use up some of them
    margins_m: tuple[tuple[float, float], ...] = (
        (0.045, 0.03),
        (0.045, 0.0),
        (0.025, 0.0),
        (0.01, 0.0),
        (0.0, 0.0),
    )
    max_bumps: int = 2  #: contacts with known walls at one margin after which only larger margins are used
    timeout_s: float = 1800.0  #: maximum duration, by the base's clock and by the number of periods
    plans: int = 40  #: maximum number of plans
    drive_stall_s: float = 5.0  #: time without progress
    bump_N: float = 3.0  #: sustained force that ends a drive
    bump_s: float = 0.4
    back_off_m: float = 0.10
    leave_m: float = 0.03  #: retreat from a wall after contact
    turns: int = 6  #: maximum number of off-centre pushes
    turn_margins_m: tuple[float, ...] = (0.025, 0.0)  #: margins of off-centre pushes, tried in order [m]
    explore_m: float = 0.06  #: length of an exploratory push
    moved_m: float = 0.015  #: minimum displacement of an object that has moved
    failures: int = 4  #: failed pushes of an object after which it counts as fixed
    look_s: float = 0.1  #: time between sightings during a push
    near_m: float = 0.03  #: maximum offset of an object from its goal that needs no new plan
    near_rad: float = 0.12  #: maximum rotation likewise
    patience_sigma: float = 3.0  #: standard deviations beyond the expected wait until a passage is given up
