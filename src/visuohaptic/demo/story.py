"""Chapters of the mission: requirements, results, reasons of failure, and comparison with ground truth.

A chapter is a function of the :class:`Mission` that writes its results into
``mission.known`` and returns a :class:`ChapterResult`. Its
``outcome`` and ``reason`` depend on the robot's data alone, ``right`` on
a comparison with the simulated world, which the robot cannot access.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from copy import copy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError, VisuohapticError
from ..io.maps.occupancy_map import OccupancyMap
from ..simulation.faults import FaultKind
from ..simulation.houses.house import House, office_house
from ..simulation.houses.random_house import random_house
from ..tasks.fetch import ContainerBelief
from .judge import Claim, RunOutcome
from .results import ChapterOutcome, ChapterResult

if TYPE_CHECKING:
    from ..core.objects import HapticTag
    from ..deformation.shapes.container import ContainerDescription
    from ..navigation.mapping.mapper import OccupancyMapper
    from ..navigation.problem.planning_problem import MovableObject
    from ..recognition.data.readings import TouchReading
    from ..reconstruction.pipeline import Reconstruction
    from ..rigs.virtual_gripper import VirtualHand
    from ..sensing.beam.tracked import TrackedBeam
    from ..sensing.foam.sensor import FoamSensor
    from ..simulation.houses.guided_platform import GuidedPlatform
    from ..simulation.mobile.obstacles import SimulatedObstacle
    from ..tasks.manipulation.squeeze_task import SqueezeCurve
    from ..tasks.memory import PlaceMemory, RememberedContainer
    from ..tasks.mobile.floor_outline import FloorOutline
    from ..viewer.page import LivePage
    from .bottle import TableBottle


_log = logging.getLogger(__name__)

#: Parts of the run at one place of the table are fewer.
PLACE_PARTS = 100


@dataclass(slots=True)
class Known:
    """The robot's knowledge; every field is written by one chapter, and is not set before."""

    map: OccupancyMap = field(init=False)  #: of the tour
    map_now: OccupancyMap = field(init=False)  #: including the objects in the door
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: estimated: x, y [m], heading [rad]
    goal_m: tuple[float, float] = (0.0, 0.0)  #: position from which the table is reached
    obstacles: tuple[
        tuple[FloorOutline, FloorOutline], ...
    ] = ()  #: of each object in the door the more probable outline first
    objects: tuple[MovableObject, ...] = ()  #: with footprints and measured tags
    arrived: bool = False  #: at the table
    belief: ContainerBelief = field(default_factory=ContainerBelief)  #: about the container on the table
    #: slices of the container that the camera sees, radius and height, and height of its top [m]
    seen: tuple[Float[np.ndarray, "k 2"], float] = field(init=False)
    touched_m: Float[np.ndarray, "n 2"] = field(init=False)  #: radius and height of the probe's contacts
    probe_sigma_N: float = field(init=False)  #: of the beam sensor's force
    probe: TrackedBeam = field(init=False)  #: the beam sensor, zeroed
    squash: float = 1.0  #: ratio of the widths of its cross-section, as seen; 1: round
    wide_rad: float = 0.0  #: direction of the larger one, if it is not round
    bottle_at_m: Float[np.ndarray, "2"] = field(init=False)  #: foot of its axis on the table
    #: radius and height of the completed bottle; half of the larger width if it is not round
    outline_m: Float[np.ndarray, "k 2"] = field(init=False)
    outline_sigma_m: float = math.nan  #: expected error of its radius
    #: covariance of the errors of its log radii; None if they are not evidence of the class
    outline_errors: Float[np.ndarray, "k k"] | None = None
    finger: FoamSensor | None = None  #: of the gripper, zeroed
    wrist: TrackedBeam | None = None  #: load sensor of the hand: zeroed, and calibrated with weights
    wrist_sigma_N: float = 0.0  #: of its zero
    curves: tuple[SqueezeCurve, ...] = ()  #: with low force
    firm_curves: tuple[SqueezeCurve, ...] = ()  #: with high force, for the contents
    wall_m: float = math.nan  #: thickness that the gentle squeezes agree with
    readings: list[TouchReading] = field(default_factory=list)  #: of these squeezes
    class_name: str = ""
    class_model: ContainerDescription = field(init=False)  #: of the recognised class, as large as the outline
    closed: bool = False  #: the contents cannot escape
    fill: float = 0.0  #: filled fraction of its volume
    mass_kg: float = 0.0  #: measured on lifting
    mass_sigma_kg: float = 0.0  #: its standard deviation


#: What it knows before the first container.
ON_THE_WAY = ("map", "map_now", "pose", "goal_m", "obstacles", "objects", "arrived", "probe_sigma_N", "probe")


@dataclass(slots=True)
class Mission:
    """Settings, the simulated world, and the knowledge so far."""

    seed: int
    folder: Path
    log: Callable[[str], None] = _log.info  #: called with each line of the log
    page: LivePage | None = None
    fault: FaultKind | None = None
    obstacles: int = 3  #: to touch; one if the chapter runs alone
    quick: bool = False  #: fewer views and frames: for tests
    known: Known = field(default_factory=Known)
    #: seed of the house and of the object on its table; 0: the fixed office, the rest from ``seed``
    world: int = 0
    visit: int = 0  #: day in this world
    place: int = 0  #: of several containers on the table, see :meth:`at`
    house: House = field(init=False)  #: the true floor
    placed: dict[str, tuple[float, float, float]] = field(init=False)  #: current true poses of its objects
    yaw_rad: dict[str, float] = field(default_factory=dict)  #: poses of its objects at the start of the drive
    platform: GuidedPlatform = field(init=False)  #: the true platform, until it drives autonomously
    mapper: OccupancyMapper = field(init=False)  #: matches scans to the map
    bottle: TableBottle | None = None  #: the one on the table
    apart: bool = False  #: the worlds at the table run in processes of their own
    kitchen: VirtualHand | None = None  #: the world of the hand, with the bottle between its fingers
    hand: Any = None  #: parts of the robot in it
    opened: ExitStack = field(default_factory=ExitStack)  #: robots to close at the end
    scan: Reconstruction = field(init=False)  #: camera views of the table
    tags: dict[str, HapticTag] = field(default_factory=dict)
    memory: PlaceMemory | None = None  #: of earlier visits
    remembered: dict[str, str] = field(default_factory=dict)  #: name in the memory, by true name
    known_bottle: RememberedContainer | None = None  #: class assigned to the object on the table
    known_bottle_probability: float = 0.0
    touches: int = 0  #: number of pushes, contacts and squeezes so far
    robot_s: float = 0.0  #: time used by the robot so far, simulated
    attempt: int = 0  #: attempt of the current chapter: 1 for the alternative

    def record_cost(self, seconds: float, touches: int = 0) -> None:
        """Record time and touches.

        Parameters
        ----------
        seconds
            Simulated time [s].
        touches
            Pushes, contacts and squeezes.
        """
        self.robot_s += seconds
        self.touches += touches

    def __post_init__(self) -> None:
        drawn = random_house(self.world, self.visit) if self.world else office_house(self.rng(1))
        self.house = drawn
        self.placed = {one.name: (one.x_m, one.y_m, one.yaw_rad) for one in drawn.obstacles}

    def rng(self, part: int) -> np.random.Generator:
        """Generator of one part of the run: omitting a chapter does not change another's random numbers.

        Parameters
        ----------
        part
            Number of the part, added to the seed.
        """
        more = [self.visit, self.attempt] if self.attempt else [self.visit] if self.visit else []
        return np.random.default_rng([self.seed, part + PLACE_PARTS * self.place, *more])

    def world_rng(self, part: int) -> np.random.Generator:
        """Generator of one part of the world, the same on every day.

        Parameters
        ----------
        part
            Number of the part, added to the seed of the world.
        """
        return np.random.default_rng([self.world or self.seed, part + PLACE_PARTS * self.place])

    def day_rng(self, part: int) -> np.random.Generator:
        """Generator of one part of the world on one day, the same for every robot and attempt.

        Parameters
        ----------
        part
            Number of the part, added to the seed of the world.
        """
        day = [self.visit] if self.visit else []
        return np.random.default_rng([self.world or self.seed, part + PLACE_PARTS * self.place, *day])

    def nearest_obstacle(self, point_m: Float[np.ndarray, "2"]) -> SimulatedObstacle:
        """The true obstacle at a point of the map, from the simulated world.

        Parameters
        ----------
        point_m
            Observed point [m].
        """
        return min(self.house.obstacles, key=lambda one: math.dist(self.placed[one.name][:2], tuple(point_m)))

    def at(self, place: int) -> Mission:
        """The same robot before another place of the table, of whose container it knows nothing.

        Parameters
        ----------
        place
            Number of the place; 0: the one of a run with one container.
        """
        one = copy(self)
        one.place, one.known = place, Known()
        for name in ON_THE_WAY:
            if hasattr(self.known, name):
                setattr(one.known, name, getattr(self.known, name))
        one.bottle = one.kitchen = one.hand = one.known_bottle = None
        one.known_bottle_probability, one.touches, one.robot_s = 0.0, 0, 0.0
        return one


#: Function of a chapter.
Work = Callable[[Mission], ChapterResult]


@dataclass(frozen=True, slots=True)
class Chapter:
    """One chapter: name, headline, requirements, and function."""

    name: str
    title: str
    needs: tuple[str, ...]
    work: Work
    typical_s: float = 1.0  #: on two cores with compiled kernels; for the estimate of the remaining time
    without: Callable[[Mission], None] | None = None  #: fills in its results when it is omitted
    otherwise: str = ""  #: description of the second attempt after a failure; empty: there is none
    #: expected duration for the robot, of those that are repeated for every container [s]
    robot_s: float = 0.0
    tells: tuple[str, ...] = ()  #: properties of a container of a :class:`.FetchRequest` that it measures


@dataclass(frozen=True, slots=True, eq=False)
class Story:
    """The whole run."""

    chapters: tuple[ChapterResult, ...]
    mission: Mission
    duration_s: float

    @property
    def complete(self) -> bool:
        """Every chapter done."""
        return all(one.done for one in self.chapters)

    @property
    def wrong_claims(self) -> tuple[str, ...]:
        """Completed chapters with wrong claims."""
        return tuple(one.name for one in self.chapters if one.correct is False)

    @property
    def claims(self) -> tuple[Claim, ...]:
        """Claims of all completed chapters."""
        return tuple(claim for one in self.chapters if one.done for claim in one.claims)

    @property
    def outcome(self) -> RunOutcome:
        """Complete, a reported failure, or wrong."""
        return RunOutcome.of(self.claims, self.complete)

    def summary(self) -> str:
        """Summary in one line."""
        if self.complete:
            return f"all {len(self.chapters)} chapters done" if len(self.chapters) > 1 else "done"
        failed = next(one for one in self.chapters if not one.done)
        return f"ended in chapter {failed.name}: {failed.reason}"


def run_chapters(
    mission: Mission,
    chapters: Sequence[Chapter],
    given: Sequence[Chapter] = (),
    later: Sequence[Chapter] = (),
) -> Story:
    """Run chapters in order; one whose requirements are not met is skipped with the reason.

    Parameters
    ----------
    mission
        Settings and simulated world; receives the results.
    chapters
        Chapters in their order.
    given
        Omitted chapters: their results are filled in from the simulated world.
    later
        Chapters that will follow, for the estimate of the remaining time.

    Raises
    ------
    InputError
        A chapter cannot be omitted.
    """
    start_s = time.monotonic()
    mission.folder.mkdir(parents=True, exist_ok=True)
    ended: dict[str, ChapterResult] = {}
    for one in given:
        if one.without is None:
            raise InputError("mission", f"chapter {one.name} cannot be skipped")
        one.without(mission)
        mission.log(f"given, not measured: {one.title.lower()}")
    # Chapters whose results are there.
    found = {one.name for one in given}
    for number, chapter in enumerate(chapters, 1):
        mission.log("")
        left_s = _left_s((*chapters, *later), number - 1, time.monotonic() - start_s)
        mission.log(f"{number}/{len(chapters)}  {chapter.title}   (about {left_s:.0f} s left)")
        missing = next((name for name in chapter.needs if name not in found), None)
        if missing is not None:
            skipped = ChapterResult(
                ChapterOutcome.SKIPPED, f"it needs what chapter {missing} was to find out"
            )
            result = replace(skipped, name=chapter.name, title=chapter.title)
            mission.log(f"  {result.outcome.value}: {result.reason}")
        else:
            result = run_chapter(chapter, mission)
        ended[chapter.name] = result
        if result.done:
            found.add(chapter.name)
    return Story(tuple(ended.values()), mission, time.monotonic() - start_s)


def _left_s(chapters: Sequence[Chapter], done: int, spent_s: float) -> float:
    """Remaining time: typical times of the remaining chapters, scaled by the speed so far."""
    typical_s = [chapter.typical_s for chapter in chapters]
    # Before the first chapters, the typical speed counts like a chapter of ten seconds.
    pace = (spent_s + 10.0) / (sum(typical_s[:done]) + 10.0)
    return pace * sum(typical_s[done:])


def run_chapter(chapter: Chapter, mission: Mission) -> ChapterResult:
    """Run one chapter, with a second, different attempt after a failure, and log its outcome.

    Parameters
    ----------
    chapter
        Its requirements are met.
    mission
        Receives its results.
    """
    started = time.monotonic()
    result = _attempt(chapter, mission)
    spent = time.monotonic() - started
    mission.log(f"  {result.outcome.value}: {result.reason} ({spent:.0f} s)")
    return replace(result, name=chapter.name, title=chapter.title, duration_s=spent)


def _attempt(chapter: Chapter, mission: Mission) -> ChapterResult:
    first = _work(chapter, mission)
    if first.done or not chapter.otherwise:
        return first
    mission.log(f"  {first.reason}; once more, {chapter.otherwise}")
    mission.attempt = 1
    second = _work(chapter, mission)
    mission.attempt = 0
    return replace(
        second,
        reason=f"{second.reason}; that was the second attempt, {chapter.otherwise}"
        + (f", after: {first.reason}" if first.reason != second.reason else ""),
        pictures=first.pictures + second.pictures,
    )


def _work(chapter: Chapter, mission: Mission) -> ChapterResult:
    """A chapter that raises an error of the library has failed with that reason; any other exception is a bug."""
    try:
        return chapter.work(mission)
    except VisuohapticError as error:
        _log.debug("chapter %s", chapter.name, exc_info=True)
        return ChapterResult(ChapterOutcome.FAILED, str(error))
