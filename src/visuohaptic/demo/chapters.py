"""The order of the demonstration's chapters, and parts that can be run alone."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.errors import InputError
from ..simulation.faults import FaultKind
from . import drive_chapters as drive
from . import floor_chapters as floor
from . import hand_chapters as hand
from . import probe_chapters as probe
from . import touch_chapters as touch
from .story import Chapter, Mission, Story, run_chapters

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
        None, "with twice the views",
    ),
    Chapter(
        "probe", "The probe completes the bottle", ("glass", "beam"), probe.complete_the_bottle, 13,
        probe.default_outline, "with twice the lines",
    ),
    Chapter(
        "squeeze", "The gripper squeezes: class and contents", ("probe",), hand.recognise_the_bottle, 13,
        None, "at as many places more",
    ),
    Chapter("grasp", "The grasp is planned and carried out", ("squeeze",), hand.grasp_the_bottle, 3),
)  # fmt: skip

#: Parts of the demonstration -> their chapters.
PARTS: dict[str, tuple[str, ...]] = {
    "foam": ("foam",),
    "beam": ("beam",),
    "navigate": ("map", "door", "drive"),
    "glass": ("glass", "probe"),
    "bottle": ("squeeze", "grasp"),
}

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Visit:
    """World of the mission, and prior knowledge."""

    world: int = (
        0  #: seed of a random house with its obstacles and the object on its table; 0: the fixed office
    )
    day: int = 0  #: people have moved objects since the previous one
    memory: Path | str | None = None  #: database of learnt objects, a folder or a URL
    apart: bool = False  #: the worlds at the table run in processes of their own


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
        Unknown part or chapter.

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
    required = {need for one in chosen for need in one.needs} - set(names)
    # Chapters that the given ones require come first.
    required |= {below for name in required for below in CHAPTER_REQUIREMENTS.get(name, ())}
    given = [one for one in CHAPTERS if one.name in required and one.name not in names]
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
        return run_chapters(mission, chosen, given)


#: Chapters that a given chapter itself requires, unless it fills in their results.
CHAPTER_REQUIREMENTS: dict[str, tuple[str, ...]] = {"door": ("map",), "foam": ("map",)}
