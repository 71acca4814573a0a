"""Every task with one fault at a time: crashes, wrong claims, force above the limit, and time until motion stops.

``python -m benchmarks.mission_faults --seeds open --count 5 --report faults.jsonl`` prints these figures.

Robots are simulated (:mod:`benchmarks._task_rigs`), under a supervisor; the fault begins at a random time between
robot and supervisor. Each run is a line of the report; the same command continues after the last one. Even seeds are
open, odd ones closed.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from visuohaptic.tasks.framework import Supervisor

from ._journal import Journal
from ._seeds import add_seeds, seeds_of
from ._task_rigs import FAULTS, STOPPING, TASKS, Fault, Record, Rig

__all__ = ["figures", "run", "try_task"]

#: Time until motion has to stop [s], and allowed excess of the force over its limit.
STOPPED_S, OVER = 0.2, 1.1
#: The fault begins in this fraction of the duration of a run without faults.
FROM, TO = 0.1, 0.9


def try_task(kind: type[Rig], fault_kind: str, seed: int, duration_s: float) -> dict[str, Any]:
    """One run.

    Parameters
    ----------
    kind
        Task and world.
    fault_kind
        One of ``FAULTS``.
    seed
        Of world and fault.
    duration_s
        Of the run without a fault, within which the fault begins.
    """
    rig, rng = kind(seed), np.random.default_rng([seed, FAULTS.index(fault_kind)])
    fault = Fault(fault_kind, float(rng.uniform(FROM, TO)) * duration_s, rng, rig.now_s)
    record = Record()
    row: dict[str, Any] = {"task": kind.name, "fault": fault_kind, "seed": seed, "at_s": fault.at_s}
    with Supervisor(rig.limits, clock=rig.now_s) as guard:
        try:
            claim = rig.attempt(guard, fault, record)
        except Exception as problem:  # noqa: BLE001 - a crash is what is counted here
            return {**row, "crash": f"{type(problem).__name__}: {problem}"}
        holds = [hold.reason for hold in guard.holds]
    begun = fault_kind in STOPPING and rig.now_s() >= fault.at_s
    return {
        **row,
        "success": bool(claim.success),
        "outcome": claim.outcome,
        "why": claim.why,
        "right": bool(claim.right),
        "duration_s": rig.now_s(),
        "over": max(record.force_N, default=0.0) / rig.limits.max_force_N,
        "motion_s": record.longest_motion_s(fault.at_s) if begun else None,
        "holds": len(holds),
        "held": holds[-1] if holds else "",
    }


def run(
    seeds: str = "open",
    count: int = 1,
    first: int = 0,
    *,
    tasks: Sequence[str] = (),
    faults: Sequence[str] = FAULTS,
    report: Path | None = None,
) -> list[dict[str, Any]]:
    """Every task with every fault.

    Parameters
    ----------
    seeds
        ``open`` (even) or ``closed`` (odd).
    count, first
        So many seeds, from the one numbered ``first`` among them.
    tasks, faults
        These alone.
    report
        Keeps the runs; a stopped campaign goes on from there.
    """
    journal = Journal(report, {"campaign": "mission_faults", "seeds": seeds})
    for seed in seeds_of(seeds, count, first):
        for kind in TASKS:
            if tasks and kind.name not in tasks:
                continue
            duration_s = 0.0
            for fault in ("none", *(one for one in faults if one != "none")):
                key = f"{kind.name} {fault} {seed}"
                if key not in journal:
                    journal.put(key, try_task(kind, fault, seed, duration_s))
                if fault == "none":
                    duration_s = journal.rows[key].get("duration_s", 10.0)
    return list(journal.rows.values())


def figures(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of the table of the issue.

    Parameters
    ----------
    rows
        Runs.
    """
    ended = [row for row in rows if "crash" not in row]
    crashes = [
        f"{row['task']}/{row['fault']}/{row['seed']}: {row['crash']}" for row in rows if "crash" in row
    ]
    wrong = [f"{row['task']}/{row['fault']}/{row['seed']}" for row in ended if not row["right"]]
    over = [f"{row['task']}/{row['fault']}/{row['seed']}" for row in ended if row["over"] > OVER]
    stops = [row for row in ended if row["motion_s"] is not None]
    late = [
        f"{row['task']}/{row['fault']}/{row['seed']}" for row in stops if row["motion_s"] > STOPPED_S + 1e-9
    ]
    worst = max((row["over"] for row in ended), default=0.0)
    slowest = max((row["motion_s"] for row in stops), default=0.0)
    fine = [row for row in ended if row["fault"] == "none"]
    return [
        _row("crashes", len(crashes), len(rows), 0, "; ".join(crashes[:5])),
        _row("wrong claims", len(wrong), len(rows), 2, ", ".join(wrong)),
        _row("force over the limit by more than 10 %", len(over), len(ended), 0,
             f"worst {worst:.2f} of the limit; {', '.join(over)}"),
        _row("stale, frozen, clocks: motion after 0.2 s", len(late), len(stops), 0,
             f"longest {slowest:.3f} s; {', '.join(late)}"),
        _row("without a fault: not done", sum(not row["success"] for row in fine), len(fine), 0,
             ", ".join(f"{row['task']}/{row['seed']} {row['outcome']}" for row in fine if not row["success"])),
    ]  # fmt: skip


def _row(name: str, value: float, of: int, floor: float, note: str) -> dict[str, Any]:
    return {
        "name": name,
        "ours": value,
        "unit": f"of {of}",
        "floor": floor,
        "aim": 0,
        "higher_is_better": False,
        "note": note,
    }


def main() -> None:
    """The campaign."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_seeds(parser, 1)
    parser.add_argument("--task", action="append", default=[], choices=[kind.name for kind in TASKS])
    parser.add_argument("--fault", action="append", default=[], choices=FAULTS)
    parser.add_argument("--report", type=Path, help="file with a line for every run; goes on from there")
    args = parser.parse_args()
    rows = run(
        args.seeds,
        args.count,
        args.first,
        tasks=args.task,
        faults=tuple(args.fault) or FAULTS,
        report=args.report,
    )
    for row in figures(rows):
        print(f"{row['name']:42s} {row['ours']:4g} {row['unit']:8s} floor {row['floor']}  {row['note']}")


if __name__ == "__main__":
    main()
