"""The whole mission: many seeds, and every fault that can be switched on; counts crashes and false claims of success.

``python -m benchmarks.mission`` runs a slice; ``--whole`` runs 20 seeds of the whole mission and 20 runs of
each fault. A fault is run through the chapters that it affects and those after them up to the next that
measures again: the results of earlier chapters are taken from the simulated world.

    python -m benchmarks.mission --whole --report mission.jsonl                 everything
    python -m benchmarks.mission --whole --part seeds --report seeds.jsonl      the seeds only
    python -m benchmarks.mission --part faults --runs 3 --report faults.jsonl   three runs of each fault

    python -m benchmarks.mission --worlds open --count 10 --report worlds.jsonl  ten random houses, every claim evaluated
    python -m benchmarks.mission --worlds open --count 5 --visits 2 --report visits.jsonl  each visited twice
    python -m benchmarks.mission --worlds open --visits 2 --robots 2  the second time by another robot with the first one's memory
    python -m benchmarks.mission --worlds open --count 5 --full --robot-seed 1 --report full.jsonl  as demo --world N does
    python -m benchmarks.mission --worlds open --first 4 --count 3 --bring "every transparent container"  two or three containers each

Each prints the table of successes, claims and reasons. A finished mission is a line of the report; the same command
continues after the last one.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from visuohaptic.demo import run_mission, write_story
from visuohaptic.simulation import FaultKind

from ._journal import Journal
from ._mission_worlds import Robot, worlds

SEEDS, RUNS = 20, 20
PARTS = ("seeds", "faults")
#: Chapters that a fault touches, and those that follow from them.
TOUCHED: dict[FaultKind, tuple[str, ...]] = {
    **dict.fromkeys(
        (
            FaultKind.DROPPED_FRAMES,
            FaultKind.LATE_FRAMES,
            FaultKind.DUPLICATE_FRAMES,
            FaultKind.CAMERA_BUMP,
            FaultKind.LIGHTING,
        ),
        ("foam",),
    ),
    FaultKind.WRONG_MAP: ("map", "door", "drive"),
    FaultKind.LOST_POSE: ("drive",),
    FaultKind.SLIP: ("squeeze", "grasp"),
    FaultKind.OBJECT_FALLS: ("squeeze", "grasp"),
}


def run(
    seeds: int = 1,
    runs: int = 2,
    *,
    camera_runs: int = 1,
    parts: Sequence[str] = PARTS,
    first: int = 1,
    faults: Sequence[FaultKind] = tuple(TOUCHED),
    report: Path | None = None,
) -> list[dict[str, Any]]:
    """A slice by default.

    Parameters
    ----------
    seeds, runs
        Whole stories, and runs of each fault; ``camera_runs`` of those that render the foam's frames.
    first
        The first seed; the others follow it.
    report
        File that keeps every story; a stopped campaign goes on from there.
    """
    kept = Journal(report, {"campaign": "mission", "first": first})
    rows: list[dict[str, Any]] = []
    if "seeds" in parts:
        rows += _seeds([_told(kept, seed, None, None) for seed in range(first, first + seeds)])
    if "faults" in parts:
        for kind in faults:
            count = camera_runs if TOUCHED[kind] == ("foam",) else runs
            told = [_told(kept, seed, kind, TOUCHED[kind]) for seed in range(first, first + count)]
            rows.append(_fault(kind, told))
    return rows


def _seeds(told: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of whole missions."""
    reasons = Counter(one["summary"] for one in told if not one["complete"])
    why = "; ".join(f"{count} {text}" if count > 1 else text for text, count in reasons.items())
    crashes = [one for one in told if "crash" in one]
    wrong = [(one["seed"], name) for one in told for name in one["wrong"]]
    spent = sorted(one["cpu_s"] for one in told)
    slowest = Counter[str]()
    for one in told:
        slowest.update(one["spent_s"])
    chapters = ", ".join(f"{name} {total / len(told):.0f}" for name, total in slowest.most_common())
    return [
        {
            "name": "missions complete",
            "ours": 20 * sum(one["complete"] for one in told) / len(told),
            "unit": "of 20",
            "floor": 18,
            "aim": 20,
            "note": f"{len(told)} seeds; {why or 'none failed'}",
        },
        _least("missions that crashed", len(crashes), "; ".join(one["crash"] for one in crashes)),
        _least("wrong claims", len(wrong), ", ".join(f"seed {seed}: {name}" for seed, name in wrong)),
        _least(
            "mission, CPU time [s]",
            spent[len(spent) // 2],
            f"median, {spent[0]:.0f} to {spent[-1]:.0f}; not the time on idle cores; "
            f"seconds by chapter, mean: {chapters}",
            240,
            120,
        ),
    ]


def _fault(kind: FaultKind, told: list[dict[str, Any]]) -> dict[str, Any]:
    """Rows of the runs with one fault."""
    bad = sum(bool(one["wrong"]) or "crash" in one for one in told)
    ended = Counter(one["ended"] for one in told)
    note = f"{len(told)} runs: " + ", ".join(f"{n} {name}" for name, n in ended.items())
    return _least(f"{kind.value}: crashes and wrong claims", bad, note)


def _least(name: str, value: float, note: str, floor: float = 0, aim: float = 0) -> dict[str, Any]:
    return {
        "name": name,
        "ours": value,
        "unit": "",
        "floor": floor,
        "aim": aim,
        "higher_is_better": False,
        "note": note,
    }


def _told(
    kept: Journal, seed: int, fault: FaultKind | None, chapters: tuple[str, ...] | None
) -> dict[str, Any]:
    """One mission, from the journal or run now."""
    key = f"{fault.value if fault else 'story'} {seed}"
    if key not in kept:
        begin_s = time.process_time()
        found = _tell(seed, fault, chapters)
        kept.put(key, {"seed": seed, "cpu_s": round(time.process_time() - begin_s, 2), **found})
    row: dict[str, Any] = kept.rows[key]
    return row


def _tell(seed: int, fault: FaultKind | None, chapters: tuple[str, ...] | None) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        try:
            story = run_mission(folder, seed=seed, fault=fault, part=chapters, on_message=lambda _: None)
            write_story(story, Path(folder) / "report.html")
        except Exception as error:  # noqa: BLE001 - a crash is what is counted here
            crash = f"{type(error).__name__}: {error}"
            return {
                "complete": False,
                "wrong": [],
                "crash": crash,
                "summary": "crash",
                "ended": "crash",
                "spent_s": {},
            }
    last = story.chapters[-1].outcome.value
    return {
        "complete": story.complete,
        "wrong": list(story.wrong_claims),
        "summary": story.summary(),
        "ended": last,
        "spent_s": {one.name: round(one.duration_s, 2) for one in story.chapters},
        "chapters": {one.name: [one.outcome.value, one.correct, one.reason] for one in story.chapters},
    }


def main() -> None:
    """The campaign."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--whole", action="store_true", help=f"{SEEDS} seeds, {RUNS} runs of each fault")
    parser.add_argument("--part", choices=PARTS, help="these alone")
    parser.add_argument("--seeds", type=int, help="so many stories")
    parser.add_argument("--runs", type=int, help="so many runs of each fault")
    parser.add_argument("--first", type=int, default=1, help="first seed, or number of the first house (1)")
    parser.add_argument("--fault", choices=[kind.value for kind in TOUCHED], help="this one alone")
    parser.add_argument("--report", type=Path, help="file with a line for every story; goes on from there")
    parser.add_argument("--worlds", choices=("open", "closed"), help="drawn houses of even or odd seeds")
    parser.add_argument("--count", type=int, default=2, help="houses (2)")
    parser.add_argument("--visits", type=int, default=1, help="to each house (1)")
    parser.add_argument(
        "--full", action="store_true", help="all views and whole pushes in houses, as the demo"
    )
    parser.add_argument("--robot-seed", type=int, default=0, help="in houses (the number of each)")
    parser.add_argument(
        "--robots", type=int, default=1, help="that visit houses in turn, with one memory (1)"
    )
    parser.add_argument("--bring", default="", help="ask for containers, at the table of each house")
    parser.add_argument("--figure", type=Path, help="PNG of the calibration")
    args = parser.parse_args()
    if args.worlds is not None:
        robot = Robot(args.robot_seed, args.full, args.bring, args.robots)
        found = worlds(
            args.worlds, args.count, args.report,
            first=args.first, visits=args.visits, robot=robot, figure=args.figure,
        )  # fmt: skip
        _show(found)
        return
    seeds = args.seeds or (SEEDS if args.whole else 1)
    runs = args.runs or (RUNS if args.whole else 2)
    rows = run(
        seeds,
        runs,
        camera_runs=args.runs or (RUNS if args.whole else 1),
        parts=PARTS if args.part is None else (args.part,),
        first=args.first,
        faults=tuple(TOUCHED) if args.fault is None else (FaultKind(args.fault),),
        report=args.report,
    )
    _show(rows)


def _show(rows: list[dict[str, Any]]) -> None:
    for row in rows:
        print(
            f"{row['name']:50s} {row['ours']:8.3g} {row['unit']:6s} floor {row['floor']}, aim {row['aim']}  {row['note']}"
        )


if __name__ == "__main__":
    main()
