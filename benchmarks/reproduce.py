"""The dissertation's experiments: Table 4.1 on several seeds, and the wall time of all experiments.

python -m benchmarks.reproduce --seeds 3     the table only
python -m benchmarks.reproduce --all DIR     runs all experiments into a folder as well
"""

from __future__ import annotations

import argparse
import csv
import json
import tempfile
import time
from pathlib import Path
from typing import Any

from visuohaptic.reproduce import EXPERIMENTS, reproduce, reproduce_all

#: Seeds not used for tuning; seed 0 was inspected.
SEEDS = (101, 102, 103)
WORKERS = 2


def table_rows(seeds: tuple[int, ...] = SEEDS) -> list[dict[str, Any]]:
    """Friction and flags of Table 4.1, the worst over the seeds."""
    static, dynamic, wrong = [], [], 0
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            outcome = reproduce("table-4.1", folder, seed=seed)
            if outcome.problem:
                raise RuntimeError(outcome.problem)
            with (outcome.folder / "tags.csv").open(newline="") as file:
                for row in csv.DictReader(file):
                    wrong += row["fixed"] != row["printed_fixed"] or row["falls"] != row["printed_falls"]
                    if row["printed_dynamic_N"] != "nan":
                        static.append(_off(row["force_N"], row["printed_force_N"]))
                        dynamic.append(_off(row["dynamic_N"], row["printed_dynamic_N"]))
    note = f"{len(seeds)} seeds, {len(static)} pushes"
    return [
        _row("Table 4.1: static friction, largest error [%]", max(static), 10, 5, note),
        _row("Table 4.1: dynamic friction, largest error [%]", max(dynamic), 10, 5, note),
        _row("Table 4.1: objects with a wrong flag", wrong, 0, 0, f"{len(seeds)} seeds, fixed and falls"),
    ]


def all_rows(folder: Path) -> list[dict[str, Any]]:
    """Wall time of all experiments, ``WORKERS`` at a time, and how many have a result."""
    begin = time.perf_counter()
    outcomes = reproduce_all(list(EXPERIMENTS), folder, force=True, workers=WORKERS)
    minutes = (time.perf_counter() - begin) / 60
    cpu = sum(one.cpu_seconds for one in outcomes) / 60
    empty = 0
    for one in outcomes:
        path = one.folder / "result.json"
        empty += not path.is_file() or not json.loads(path.read_text())["pictures"]
    return [
        _row(
            "all experiments, wall time [min]",
            minutes,
            60,
            30,
            f"{WORKERS} at a time; {cpu:.0f} min of CPU time",
        ),
        _row("experiments without a picture", empty, 0, 0, f"of {len(outcomes)}"),
    ]


def run() -> list[dict[str, Any]]:
    """The table on fresh seeds, and everything once."""
    with tempfile.TemporaryDirectory() as folder:
        return table_rows() + all_rows(Path(folder))


def _off(ours: str, printed: str) -> float:
    """Error in percent; a missing value counts as 100 %."""
    return 100.0 if ours == "nan" else 100 * abs(float(ours) / float(printed) - 1)


def _row(name: str, value: float, floor: float, aim: float, note: str) -> dict[str, Any]:
    return {
        "name": name, "ours": value, "unit": "", "floor": floor, "aim": aim, "higher_is_better": False, "note": note
    }  # fmt: skip


def main() -> None:
    """One part, or both."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=len(SEEDS), help="of the table, from 101 on; 0: not")
    parser.add_argument("--all", type=Path, metavar="DIR", help="run all experiments into this folder")
    args = parser.parse_args()
    rows = table_rows(tuple(range(101, 101 + args.seeds))) if args.seeds > 0 else []
    rows += all_rows(args.all) if args.all is not None else []
    for row in rows:
        print(f"{row['name']:50s} {row['ours']:8.3g} floor {row['floor']}, aim {row['aim']}  {row['note']}")


if __name__ == "__main__":
    main()
