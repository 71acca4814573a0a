"""Missions in random houses: evaluation of every claim, and the cost of a second visit."""

from __future__ import annotations

import math
import tempfile
import time
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from visuohaptic.demo import Story, Visit, run_mission
from visuohaptic.demo.judge import CONFIDENT_PROBABILITY, RunOutcome

from ._forecasts import calibration_figure, expected_calibration_error
from ._journal import Journal

__all__ = ["Robot", "worlds"]


#: Chapters at the table.
TABLE = ("beam", "glass", "probe", "squeeze", "grasp")


@dataclass(frozen=True, slots=True)
class Robot:
    """How the houses are visited."""

    seed: int = 0  #: of all that is random but the house, as ``demo --seed``; 0: the number of the house
    full: bool = False  #: all views and whole pushes, as the demo has them
    bring: str = ""  #: containers that are asked for, as ``demo --bring``, by a robot that is at the table
    count: int = 1  #: robots that visit in turn, with one memory; each has other sensors and errors


def worlds(
    seeds: str,
    count: int,
    report: Path | None,
    *,
    first: int = 1,
    visits: int = 1,
    robot: Robot = Robot(),
    figure: Path | None = None,
) -> list[dict[str, Any]]:
    """Rows of the table.

    Parameters
    ----------
    seeds
        ``open``: even seeds from 2 on; ``closed``: odd ones from 1 on.
    count
        Houses.
    report
        File that keeps every run; a stopped campaign goes on from there.
    first
        Number of the first house, from 1 on.
    visits
        To each house; from the second on with what was remembered.
    robot
        That visits them.
    figure
        Of the calibration, PNG.
    """
    kept = Journal(report, {"campaign": "worlds", "visits": visits, **asdict(robot)})
    begin = 2 * first - (seeds == "closed")
    numbers = range(begin, begin + 2 * count, 2)
    for world in numbers:
        if str(world) not in kept:
            kept.put(str(world), _visits(world, visits, robot))
    days: list[list[dict[str, Any]]] = [kept.rows[str(world)] for world in numbers]
    runs = [run for house in days for run in house]
    claims = [claim for run in runs for claim in run["claims"]]
    forecasts = [(float(claim[4]), bool(claim[5])) for claim in claims]
    if figure is not None and forecasts:
        calibration_figure(forecasts).savefig(figure, dpi=120)
    ended = Counter(run["outcome"] for run in runs)
    why = Counter(run["summary"].split(":")[0] for run in runs if run["outcome"] == RunOutcome.HONEST_FAILURE)
    sure = [claim for claim in claims if not claim[5] and claim[4] > CONFIDENT_PROBABILITY]
    fills = [claim[2] - claim[3] for claim in claims if claim[0] == "fill"]
    lids, requested = ([claim[5] for claim in claims if claim[0] == kind] for kind in ("lid", "requested"))
    rows = [
        _row("complete", 100 * ended[RunOutcome.COMPLETE] / len(runs), "%", 75, 90, True, f"{len(runs)} runs: {dict(ended)}; {dict(why)}"),
        _row("wrong claims of p > 0.98", 100 * len(sure) / max(len(claims), 1), "%", 1.0, 0.2, False, f"{len(sure)} of {len(claims)}: {sure}"),
        _row("crashes", ended["crash"], "", 0, 0, False, "; ".join(run["summary"] for run in runs if run["outcome"] == "crash")),
        _row("expected calibration error", expected_calibration_error(forecasts), "", 0.05, 0.02, False, f"{len(forecasts)} claims, {sum(1 for _, good in forecasts if not good)} wrong"),
        _row("fill, rms error", math.sqrt(sum(e * e for e in fills) / max(len(fills), 1)), "", 0.1, 0.05, False, f"{len(fills)} claims"),
        _row("lid right", 100 * sum(lids) / max(len(lids), 1), "%", 95, 99, True, f"{len(lids)} claims"),
        *[_row("requested or not, right", 100 * sum(requested) / len(requested), "%", 95, 99, True, f"{len(requested)} containers") for _ in requested[:1]],
        _row("CPU time of a run", sum(run["cpu_s"] for run in runs) / len(runs), "s", 240, 120, False, f"mean, {'all views and whole' if robot.full else 'half of the views, short'} pushes"),
    ]  # fmt: skip
    if visits > 1:
        rows += _second(days)
    return rows


def _second(days: list[list[dict[str, Any]]]) -> list[dict[str, Any]]:
    """Touches and duration of later visits relative to the first, where both reached the same chapter."""
    pairs = [
        (house[0], later) for house in days for later in house[1:] if house[0]["ended"] == later["ended"]
    ]
    rows = []
    for what, floor, aim in (("touches", 0.6, 0.35), ("robot_s", 0.7, 0.4)):
        before, after = (sum(pair[k][what] for pair in pairs) for k in (0, 1))
        note = f"{len(pairs)} pairs of visits that ended alike: {after:.0f} of {before:.0f}"
        rows.append(
            _row(f"second visit by first, {what}", after / max(before, 1e-9), "", floor, aim, False, note)
        )
    return rows


def _row(name: str, ours: float, unit: str, floor: float, aim: float, up: bool, note: str) -> dict[str, Any]:
    return {
        "name": name, "ours": ours, "unit": unit, "floor": floor, "aim": aim, "higher_is_better": up, "note": note,
    }  # fmt: skip


def _visits(world: int, visits: int, robot: Robot) -> list[dict[str, Any]]:
    """Runs of one house, with one memory."""
    with tempfile.TemporaryDirectory() as folder:
        memory = Path(folder) / "memory" if visits > 1 else None
        return [
            _run(Visit(world, day, memory, bring=robot.bring), Path(folder) / str(day), robot)
            for day in range(visits)
        ]


def _run(visit: Visit, folder: Path, robot: Robot) -> dict[str, Any]:
    start_s, seed = time.process_time(), (robot.seed or visit.world) + 1000 * (visit.day % robot.count)
    try:
        story: Story | None = run_mission(
            folder,
            part=TABLE if robot.bring else None,
            seed=seed,
            visit=visit,
            quick=not robot.full,
            on_message=lambda _: None,
        )
        crash = ""
    except Exception as error:  # noqa: BLE001 - a crash is what is counted here
        story, crash = None, f"{type(error).__name__}: {error}"
    row = {"world": visit.world, "visit": visit.day, "cpu_s": round(time.process_time() - start_s, 1)}
    if story is None:
        return {
            **row,
            "outcome": "crash",
            "summary": f"world {visit.world}: {crash}",
            "claims": [],
            "ended": "crash",
            "touches": 0,
            "robot_s": 0.0,
        }
    return {
        **row,
        "outcome": story.outcome.value,
        "summary": story.summary(),
        "ended": next((one.name for one in story.chapters if not one.done), ""),
        "claims": [claim.as_row() for claim in story.claims],
        "touches": story.mission.touches,
        "robot_s": round(story.mission.robot_s, 1),
        "chapters": {one.name: [one.outcome.value, one.reason] for one in story.chapters},
    }
