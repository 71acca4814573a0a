"""The order of the demonstration, and its parts that can be run alone."""

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

__all__ = ["CHAPTERS", "PARTS", "Visit", "run_mission"]

CHAPTERS: tuple[Chapter, ...] = (
    Chapter(
        "map", "The platform maps its path with the laser", (), floor.map_the_way, 1, floor.default_map,
        "the round is led the other way about",
    ),
    Chapter(
        "door", "Today the door is blocked", ("map",), floor.find_the_door_blocked, 1, floor.default_door,
        "it turns to either side and looks again",
    ),
    Chapter(
        "foam", "It touches what stands there, and tags it", ("door",), touch.explore_obstacles, 120,
        touch.default_tags, "beside the middle of what stands there",
    ),
    Chapter(
        "drive", "It plans with the tags, pushes and arrives", ("map", "foam"), drive.drive_to_the_table, 2,
        drive.default_arrival, "from where it has ended, with what it has felt on the way",
    ),
    Chapter(
        "beam", "At the table the probe's beam sensor is zeroed", ("drive",), probe.zero_the_beam, 12,
        probe.default_beam, "zeroed anew",
    ),
    Chapter(
        "glass", "The camera circles, and finds what is transparent", ("drive",), probe.find_the_glass, 11,
        None, "with twice the views",
    ),
    Chapter(
        "probe", "The probe completes the bottle", ("glass", "beam"), probe.complete_the_bottle, 1,
        probe.default_outline, "with twice the lines",
    ),
    Chapter(
        "squeeze", "The gripper squeezes: class and contents", ("probe",), hand.recognise_the_bottle, 2,
        None, "at as many places more",
    ),
    Chapter("grasp", "The grasp is planned and carried out", ("squeeze",), hand.grasp_the_bottle),
)  # fmt: skip

#: Parts of the story -> their chapters.
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
    """Where the mission takes place, and what is known before."""

    world: int = (
        0  #: seed of a drawn house, of what blocks its doorway and is on its table; 0: the fixed office
    )
    day: int = 0  #: people have moved things since the one before
    memory: Path | str | None = None  #: database of what was learnt, a folder or a URL


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
        One of ``PARTS``, or names of chapters; the whole story without. What earlier chapters would have
        learnt is then filled in from the simulated world, and said so.
    seed
        Of everything random: order of the objects, noise, bottle, state.
    on_message
        Takes the lines of the story.
    page
        Shows it live.
    fault
        Something that goes wrong.
    quick
        Fewer frames and views, shorter pushes: for tests.
    visit
        Which world, on which day, and what is remembered of it; the fixed office without.

    Raises
    ------
    InputError
        Part or chapter is not known.

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
    wanted = {need for one in chosen for need in one.needs} - set(names)
    # What is needed by what is given comes first.
    wanted |= {below for name in wanted for below in CHAPTERS_NEED.get(name, ())}
    given = [one for one in CHAPTERS if one.name in wanted and one.name not in names]
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
    )
    if visit.memory is None:
        return run_chapters(mission, chosen, given)
    from .memory import MissionMemory

    with MissionMemory(visit.memory, f"house-{visit.world}" if visit.world else "office") as mission.memory:
        return run_chapters(mission, chosen, given)


#: What a given chapter itself builds on, as far as it is not filled in by it.
CHAPTERS_NEED: dict[str, tuple[str, ...]] = {"door": ("map",), "foam": ("map",)}
