"""The whole mission: seeds, and every switchable fault; no crash, and no success that is none.

``python -m benchmarks.mission`` runs a slice; ``--whole`` runs 20 seeds of the whole story and 20 runs of
each fault. A fault is run through the chapters it touches and those after them up to the next that
measures anew: what comes before is filled in from the simulated world.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from visuohaptic.experiments.mission import Story, run_mission, write_story
from visuohaptic.simulation.faults import FaultKind

SEEDS, RUNS = 20, 20
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
    seeds: int = 1, runs: int = 2, *, camera_runs: int = 1, report: Path | None = None
) -> list[dict[str, Any]]:
    """A slice by default."""
    rows: list[dict[str, Any]] = []
    log: list[dict[str, Any]] = []
    stories, seconds = [], []
    for seed in range(1, seeds + 1):
        begin = time.process_time()
        story = _told(seed, None, None, log)
        if story is not None:
            stories.append(story)
        seconds.append(time.process_time() - begin)
    crashed = seeds - len(stories)
    reasons = Counter(story.summary() for story in stories if not story.complete)
    rows.append(
        {
            "name": "missions complete",
            "ours": 20 * sum(story.complete for story in stories) / seeds,
            "unit": "of 20",
            "floor": 18,
            "aim": 20,
            "note": f"{seeds} seeds; {'; '.join(reasons) or 'none failed'}",
        }
    )
    rows.append(
        _least("wrong claims", sum(len(story.wrong_claims) for story in stories), f"{crashed} crashes")
    )
    rows.append(
        _least("mission, CPU time [s]", sum(seconds) / seeds, "mean; not the time on idle cores", 240, 120)
    )
    for kind, chapters in TOUCHED.items():
        count = camera_runs if chapters == ("foam",) else runs
        told = [_told(seed, kind, chapters, log) for seed in range(1, count + 1)]
        good = [story for story in told if story is not None]
        bad = sum(bool(story.wrong_claims) for story in good) + len(told) - len(good)
        ended = Counter(story.chapters[-1].outcome.value for story in good)
        note = f"{count} runs: " + ", ".join(f"{n} {name}" for name, n in ended.items())
        rows.append(_least(f"{kind.value}: crashes and wrong claims", bad, note))
    if report is not None:
        report.write_text(json.dumps(log, indent=1) + "\n")
    return rows


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
    seed: int, fault: FaultKind | None, chapters: tuple[str, ...] | None, log: list[dict[str, Any]]
) -> Story | None:
    with tempfile.TemporaryDirectory() as folder:
        entry: dict[str, Any] = {"seed": seed, "fault": fault.value if fault else None}
        log.append(entry)
        try:
            story = run_mission(folder, seed=seed, fault=fault, chapters=chapters, say=lambda _: None)
            write_story(story, Path(folder) / "report.html")
        except Exception as error:  # noqa: BLE001 - a crash is what is counted here
            entry["crash"] = repr(error)
            return None
    entry["chapters"] = {one.name: [one.outcome.value, one.right, one.reason] for one in story.chapters}
    return story


def main() -> None:
    """The campaign."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--whole", action="store_true", help="20 seeds, 20 runs of each fault")
    parser.add_argument("--report", type=Path, help="JSON file with every run")
    args = parser.parse_args()
    rows = run(SEEDS, RUNS, camera_runs=RUNS, report=args.report) if args.whole else run(report=args.report)
    for row in rows:
        print(
            f"{row['name']:50s} {row['ours']:8.3g} {row['unit']:6s} floor {row['floor']}, aim {row['aim']}  {row['note']}"
        )


if __name__ == "__main__":
    main()
