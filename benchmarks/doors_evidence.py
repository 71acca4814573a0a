"""Doors on floors of buildings: recall, precision, and whether the confidence is a probability.

    python -m benchmarks.doors_evidence generated real --seeds open --count 30 --report out.jsonl

Even seeds are buildings to train on, odd ones (``--seeds closed``) those that are reported; of the real floors with
doors drawn by others, the first floor of the building trains and the third reports. A door counts as found when its middle is
within 0.75 m of the true one's, one to one. Closed doors are wall on a map, and are no truth.
"""

from __future__ import annotations

import argparse
import itertools
import time
from pathlib import Path
from typing import Any

import numpy as np
from tests.worlds.buildings import building

from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.mapping import DoorMap, find_doors

from ._journal import Journal
from ._plan_judge import Row
from .nav_doors import data_folder, drawn_doors, matched
from .plan_evidence import print_rows, seeds_of

__all__ = ["main", "table"]

#: Real floors whose doors were drawn by others, by what they may be used for.
REAL = {"open": ("ut_gdc_1/1.yaml",), "closed": ("ut_gdc_3/3.yaml",)}
BINS = (0.0, 0.5, 0.7, 0.9, 1.0)


def judged(grid: OccupancyMap, jambs_m: np.ndarray) -> Row:
    """Doors of one map: confidence of each, whether it is true, and how many there are."""
    began = time.process_time()
    found = find_doors(grid)
    spent_s = time.process_time() - began
    true = {i for i, _ in matched(found, jambs_m)} if len(jambs_m) else set()
    return {
        "confidence": [round(float(door.confidence), 4) for door in found.doors],
        "true": [index in true for index in range(len(found.doors))],
        "drawn": len(jambs_m),
        "cpu_s": round(spent_s, 3),
        "curve": [_at(found, jambs_m, level) for level in BINS[1:-1]],
    }


def _at(found: DoorMap, jambs_m: np.ndarray, level: float) -> list[float]:
    """Level, hits and number of the doors above a confidence, matched anew."""
    sure = DoorMap(tuple(door for door in found.doors if door.confidence >= level), found.rooms)
    hits = len(matched(sure, jambs_m)) if len(jambs_m) and sure.doors else 0
    return [level, hits, len(sure.doors)]


def play(key: str) -> Row:
    """One building."""
    kind, name = key.split(" ", 1)
    if kind == "generated":
        made = building(int(name))
        return {"kind": made.name.split()[0], **judged(OccupancyMap(made.cells, made.cell_m), made.jambs_m)}
    path = data_folder() / name
    corners, _ = drawn_doors(path.parent / "doors.yaml")
    return {"kind": "real", **judged(OccupancyMap.load(path), corners)}


def table(name: str, rows: list[Row]) -> list[Row]:
    """Recall, precision and calibration of some buildings together."""
    drawn, told = sum(row["drawn"] for row in rows), sum(len(row["true"]) for row in rows)
    if not drawn:
        return []
    confidence = np.array([value for row in rows for value in row["confidence"]])
    true = np.array([value for row in rows for value in row["true"]], dtype=bool)
    lines: list[dict[str, Any]] = [
        {
            "name": f"{name}: recall",
            "ours": true.sum() / drawn,
            "unit": "1",
            "floor": 0.8,
            "aim": 0.9,
            "note": f"{drawn} doors, {len(rows)} floors",
        },
        {
            "name": f"{name}: precision",
            "ours": true.mean() if told else None,
            "unit": "1",
            "floor": 0.8,
            "aim": 0.9,
            "note": f"{told} told",
        },
    ]
    for index, level in enumerate(BINS[1:-1]):
        hits, many = (sum(row["curve"][index][k] for row in rows) for k in (1, 2))
        lines.append(
            {
                "name": f"{name}: precision from confidence {level}",
                "ours": hits / many if many else None,
                "unit": "1",
                "note": f"recall {hits / drawn:.2f}, {many} told",
            }
        )
    gap = 0.0
    for low, high in itertools.pairwise(BINS):
        inside = (confidence >= low) & ((confidence < high) | (high == 1.0))
        if not inside.any():
            continue
        declared, held = float(confidence[inside].mean()), float(true[inside].mean())
        gap += abs(declared - held) * inside.mean()
        error = float(np.sqrt(held * (1 - held) / inside.sum()))
        lines.append(
            {
                "name": f"{name}: true of those told {low:g} to {high:g}",
                "ours": held,
                "unit": "1",
                "note": f"declared {declared:.2f}, {inside.sum()} doors, standard error {error:.2f}",
            }
        )
    lines.append({"name": f"{name}: calibration error", "ours": gap, "unit": "1", "floor": 0.1, "aim": 0.05})
    lines.append(
        {
            "name": f"{name}: CPU time of a floor, median",
            "ours": float(np.median([row["cpu_s"] for row in rows])),
            "unit": "s",
        }
    )
    return lines


def main(arguments: list[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("source", nargs="+", choices=("generated", "real"))
    parser.add_argument("--seeds", choices=("open", "closed"), default="open")
    parser.add_argument("--count", type=int, default=12, help="generated buildings")
    parser.add_argument("--report", type=Path, help="file of rows; those that it has are not made again")
    given = parser.parse_args(arguments)
    journal = Journal(given.report, {"benchmark": "doors_evidence", "seeds": given.seeds})
    for source in given.source:
        names = [str(seed) for seed in seeds_of(given.seeds, given.count)] if source == "generated" else []
        names += [name for name in REAL[given.seeds] if source == "real" and (data_folder() / name).exists()]
        rows = []
        for name in names:
            key = f"{source} {name}"
            if key not in journal:
                journal.put(key, play(key))
            rows.append(journal.rows[key])
        for kind in sorted({row["kind"] for row in rows}):
            print_rows(table(kind, [row for row in rows if row["kind"] == kind]))
        if source == "generated":
            print_rows(table("all generated", rows))


if __name__ == "__main__":
    main()
