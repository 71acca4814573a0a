"""Door detection on floors of buildings: recall, precision, and calibration of the confidence.

    python -m benchmarks.doors_evidence generated real --seeds open --count 30 --report out.jsonl
                                      prints recall, precision and calibration error for generated and real floors

Even seeds are buildings for training, odd ones (``--seeds closed``) those that are reported. Of the real buildings, the
one with third-party door annotations and those of ``real_doors.yaml`` with ``use: training`` are for training, the others for
reporting. Open floors are part of the fit; ``benchmarks.doors_training`` prints results for buildings that are left out. A door
counts as found when its middle is within 0.75 m of the true one's, one to one. Closed doors are wall on a map and not part of
the truth; detections at an ambiguous opening are ignored.
"""

from __future__ import annotations

import argparse
import itertools
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from tests.worlds.buildings import building
from tests.worlds.real_floors import load

from visuohaptic.io.maps import OccupancyMap
from visuohaptic.navigation.mapping import DoorMap, find_doors

from ._journal import Journal
from ._plan_judge import Row
from ._seeds import seeds_of
from .nav_doors import TOLERANCE_M, data_folder, drawn_doors, matched
from .plan_evidence import print_rows

__all__ = ["main", "table"]

TRUTH = Path(__file__).resolve().parents[1] / "tests" / "worlds" / "real_doors.yaml"
BINS = (0.0, 0.5, 0.7, 0.9, 1.0)


def real_names(seeds: str) -> list[str]:
    """Available real floors for training (open) or reporting (closed)."""
    use = {"open": "training", "closed": "reporting"}[seeds]
    names = [name for name, entry in yaml.safe_load(TRUTH.read_text()).items() if entry["use"] == use]
    return [name for name in names if (data_folder() / name).exists()]


def floor(key: str) -> tuple[str, OccupancyMap, np.ndarray, np.ndarray]:
    """Kind, map, jambs of the true doors (n, 2, 2) [m] and middles of unclear openings (n, 2) [m] of a floor."""
    source, name = key.split(" ", 1)
    none = np.zeros((0, 2))
    if source == "generated":
        made = building(int(name))
        return made.name.split()[0], OccupancyMap(made.cells, made.cell_m), made.jambs_m, none
    truth = yaml.safe_load(TRUTH.read_text())[name]
    unclear = np.array(truth["unclear"], dtype=float).reshape(-1, 2)
    if "doors" in truth:
        grid = OccupancyMap(*load(data_folder(), name))
        return "real", grid, np.array(truth["doors"], dtype=float).reshape(-1, 2, 2), unclear
    path = data_folder() / name
    grid = OccupancyMap.load(path)
    return "real", grid, drawn_doors(path.parent / "doors.yaml")[0], unclear + grid.origin[:2]


def judged(found: DoorMap, jambs_m: np.ndarray, unclear_m: np.ndarray) -> Row:
    """Doors of one map: confidence of each, whether it is true, and how many there are."""
    hits = {i for i, _ in matched(found, jambs_m)} if len(jambs_m) else set()
    clear = [
        door
        for index, door in enumerate(found.doors)
        if index in hits or np.hypot(*(unclear_m - door.middle_m).T).min(initial=np.inf) > TOLERANCE_M
    ]
    found = DoorMap(tuple(clear), found.rooms)
    true = {i for i, _ in matched(found, jambs_m)} if len(jambs_m) else set()
    return {
        "confidence": [round(float(door.confidence), 4) for door in found.doors],
        "true": [index in true for index in range(len(found.doors))],
        "drawn": len(jambs_m),
        "curve": [_at(found, jambs_m, level) for level in BINS[1:-1]],
    }


def _at(found: DoorMap, jambs_m: np.ndarray, level: float) -> list[float]:
    """Level, hits and number of the doors above a confidence, matched again."""
    sure = DoorMap(tuple(door for door in found.doors if door.confidence >= level), found.rooms)
    hits = len(matched(sure, jambs_m)) if len(jambs_m) and sure.doors else 0
    return [level, hits, len(sure.doors)]


def play(key: str) -> Row:
    """One building."""
    kind, grid, jambs_m, unclear_m = floor(key)
    began = time.process_time()
    found = find_doors(grid)
    spent_s = round(time.process_time() - began, 3)
    return {"kind": kind, "cpu_s": spent_s, **judged(found, jambs_m, unclear_m)}


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
        names += real_names(given.seeds) if source == "real" else []
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
