"""The order of the demonstration's chapters, and parts that can be run alone."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING

from ..core.errors import InputError
from ..simulation.faults import FaultKind
from ..tasks.fetch import DECIDED, ContainerBelief, FetchRequest, FetchStep, deliveries_per_s, next_container
from . import drive_chapters as drive
from . import floor_chapters as floor
from . import hand_chapters as hand
from . import probe_chapters as probe
from . import touch_chapters as touch
from .bottle import TAUGHT
from .judge import Claim
from .results import ChapterResult, done, failed
from .served import place_bottle
from .story import Chapter, Mission, Story, run_chapter, run_chapters

if TYPE_CHECKING:
    from ..viewer.page import LivePage


CHAPTERS: tuple[Chapter, ...] = (
    Chapter(
        "map", "The platform maps its path with the laser", (), floor.map_route, 3, floor.default_map,
        "the round is led the other way about",
    ),
    Chapter(
        "door", "Today the door is blocked", ("map",), floor.find_the_door_blocked, 1, floor.default_door,
        "it turns to either side and looks again",
    ),
    Chapter(
        "foam", "It touches the obstacles and tags them", ("door",), touch.explore_obstacles, 75,
        touch.default_tags, "off the centre of the obstacles",
    ),
    Chapter(
        "drive", "It plans with the tags, pushes and arrives", ("map", "foam"), drive.drive_to_the_table, 5,
        drive.default_arrival, "from its present pose, with the forces measured so far",
    ),
    Chapter(
        "beam", "At the table the probe's beam sensor is zeroed", ("drive",), probe.zero_the_beam, 3,
        probe.default_beam, "zeroed again",
    ),
    Chapter(
        "glass", "The camera circles, and finds what is transparent", ("drive",), probe.find_the_glass, 6,
        None, "with twice the views", 3, ("transparent",),
    ),
    Chapter(
        "probe", "The probe completes the bottle", ("glass", "beam"), probe.complete_the_bottle, 13,
        probe.default_outline, "with twice the lines", 50,
    ),
    Chapter(
        "squeeze", "The gripper squeezes: class and contents", ("probe",), hand.recognise_the_bottle, 13,
        None, "at as many places more", 60, ("closed", "filled", "class_name"),
    ),
    Chapter(
        "grasp", "The grasp is planned and carried out", ("squeeze",), hand.grasp_the_bottle, 3, robot_s=10,
    ),
)  # fmt: skip

#: Parts of the demonstration -> their chapters.
PARTS: dict[str, tuple[str, ...]] = {
    "foam": ("foam",),
    "beam": ("beam",),
    "navigate": ("map", "door", "drive"),
    "glass": ("glass", "probe"),
    "bottle": ("squeeze", "grasp"),
}

#: What becomes of a container.
LIFTED, NOT_REQUESTED = "is lifted", "is not requested"

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Visit:
    """World of the mission, and prior knowledge."""

    #: seed of a random house with its obstacles and the object on its table; 0: the fixed office
    world: int = 0
    day: int = 0  #: people have moved objects since the previous one
    memory: Path | str | None = None  #: database of learnt objects, a folder or a URL
    apart: bool = False  #: the worlds at the table run in processes of their own
    #: request for containers, see :meth:`.FetchRequest.parse`; on the table stand two or three
    bring: str = ""


def run_mission(
    folder: Path | str,
    *,
    part: str | tuple[str, ...] | None = None,
    seed: int = 1,
    on_message: Callable[[str], None] = log.info,
    page: LivePage | None = None,
    fault: FaultKind | None = None,
    quick: bool = False,
    visit: Visit | None = None,
) -> Story:
    """Run the end-to-end demonstration, or a part of it.

    Parameters
    ----------
    folder
        Receives the recordings of sensors and chapters.
    part
        One of ``PARTS``, or names of chapters; all chapters by default. The results of omitted earlier chapters
        are then filled in from the simulated world and marked as such.
    seed
        Seed of all random numbers: order of the objects, noise, bottle, state.
    on_message
        Called with each line of the log.
    page
        Live page.
    fault
        Fault to inject.
    quick
        Fewer frames and views, shorter pushes: for tests.
    visit
        World, day, and stored knowledge; the fixed office by default.

    Raises
    ------
    InputError
        Unknown part or chapter, or a request that cannot be read, or without the chapters at the table.

    Examples
    --------
    >>> story = run_mission("results/bottle", part="bottle")  # doctest: +SKIP
    >>> story.summary()  # doctest: +SKIP
    'all 2 chapters done'
    """
    if isinstance(part, str) and part not in PARTS:
        raise InputError("mission", f"found {part!r}, expected one of {', '.join(PARTS)}", field="part")
    names = PARTS[part] if isinstance(part, str) else part or tuple(one.name for one in CHAPTERS)
    visit = visit or Visit()
    known = {one.name for one in CHAPTERS}
    if unknown := [name for name in names if name not in known]:
        raise InputError("mission", f"found chapter {unknown[0]!r}, expected one of {', '.join(known)}")
    chosen = tuple(one for one in CHAPTERS if one.name in names)
    request, repeated = None, tuple(one for one in chosen if one.robot_s)
    if visit.bring:
        request = FetchRequest.parse(visit.bring, TAUGHT)
        if len(repeated) < len([one for one in CHAPTERS if one.robot_s]):
            raise InputError("mission", "found a request for containers without all chapters at the table")
    required = {need for one in chosen for need in one.needs} - set(names)
    # Chapters that the given ones require come first.
    required |= {below for name in required for below in CHAPTER_REQUIREMENTS.get(name, ())}
    given = [one for one in CHAPTERS if one.name in required and one.name not in names]
    if request is not None:
        chosen = tuple(one for one in chosen if not one.robot_s)
    mission = Mission(
        seed,
        Path(folder),
        on_message,
        page,
        fault,
        obstacles=1 if part == "foam" or (quick and not visit.world) else 3,
        quick=quick,
        world=visit.world,
        visit=visit.day,
        apart=visit.apart,
    )
    with mission.opened as stack:
        if visit.memory is not None:
            from ..tasks.memory import PlaceMemory

            kitchen = f"house-{visit.world}" if visit.world else "office"
            mission.memory = stack.enter_context(PlaceMemory(visit.memory, kitchen))
        # At least two containers stand on the table.
        story = run_chapters(mission, chosen, given, later=() if request is None else 2 * repeated)
        if request is None or not story.complete:
            return story
        start_s = time.monotonic()
        results = (*story.chapters, *_fetch(mission, request, repeated))
        return Story(results, mission, story.duration_s + time.monotonic() - start_s)


def _fetch(mission: Mission, request: FetchRequest, chapters: Sequence[Chapter]) -> list[ChapterResult]:
    """Examine the containers in the order of :func:`.next_container`, and lift the requested ones."""
    places = {k: mission.at(k) for k in range(int(mission.world_rng(40).integers(2, 4)))}
    left, results = {k: list(chapters) for k in places}, list[ChapterResult]()
    spent_s = {one.name: [one.robot_s] for one in chapters}
    ends: dict[int, str] = {}

    def steps(k: int) -> list[FetchStep]:
        belief = places[k].known.belief
        tested = [request.probability(belief, one.tells) if one.tells else 1.0 for one in left[k]]
        return [FetchStep(fmean(spent_s[one.name]), p) for one, p in zip(left[k], tested, strict=True)]

    while left and (request.every or LIFTED not in ends.values()):
        chains = {k: steps(k) for k in left}
        k = next_container(chains)
        place, chapter = places[k], left[k].pop(0)
        mission.log("")
        mission.log(
            f"place {k + 1}, requested with a probability of {request.probability(place.known.belief):.2f}, "
            f"{1.0 / deliveries_per_s(chains[k]):.0f} s per expected delivery: {chapter.title}"
        )
        before_s, touches = place.robot_s, place.touches
        result = run_chapter(chapter, place)
        if place.robot_s > before_s:  # an opaque container is not probed
            spent_s[chapter.name].append(place.robot_s - before_s)
        mission.record_cost(place.robot_s - before_s, place.touches - touches)
        probability = request.probability(place.known.belief)
        decided = max(probability, 1.0 - probability) >= DECIDED
        if decided and probability < 0.5:
            ends[k] = NOT_REQUESTED
        elif not result.done:
            ends[k] = f"could not be {'lifted' if not left[k] else 'examined'}"
        elif not left[k]:
            ends[k] = LIFTED
        elif len(left[k]) == 1 and not decided:
            ends[k] = f"is left: requested with a probability of {probability:.2f}"
        if k in ends:
            del left[k]
            if decided and result.done:
                result = replace(result, claims=(*result.claims, _request_claim(request, place, probability)))
        results.append(
            replace(result, name=f"{chapter.name} {k + 1}", title=f"Place {k + 1}: {chapter.title}")
        )
    reason = ", ".join(f"container {k + 1} {end}" for k, end in sorted(ends.items()))
    brought = set(ends.values()) <= {LIFTED, NOT_REQUESTED} if request.every else LIFTED in ends.values()
    outcome = done if brought else failed
    return [*results, replace(outcome(reason), name="bring", title="The request")]


def _request_claim(request: FetchRequest, place: Mission, probability: float) -> Claim:
    """Whether the container is a requested one, by the robot's knowledge and in truth."""
    true, value = place_bottle(place), probability > 0.5
    known = ContainerBelief(
        float(true.transparent), float(true.closed), float(true.fill > 0), {true.name: 1.0}
    )
    return Claim(
        "requested", f"container {place.place + 1}", value, request.probability(known) > 0.5,
        probability=probability if value else 1.0 - probability,
    )  # fmt: skip


#: Chapters that a given chapter itself requires, unless it fills in their results.
CHAPTER_REQUIREMENTS: dict[str, tuple[str, ...]] = {"door": ("map",), "foam": ("map",)}
