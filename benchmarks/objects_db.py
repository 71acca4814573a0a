"""A database of 10^5 objects or more: time of import, reading, nearest-feature search and synchronisation.

    python -m benchmarks.objects_db --objects 1000000 --folder F --seconds 120
    python -m benchmarks.objects_db --objects 1000000 --vectors        the search among vectors only

The database is kept in the folder (10 GB for 10^6 objects, 5 GB of memory); each call continues the import for this number of
seconds, and the call that completes it runs the other measurements and prints the table.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from visuohaptic.core import Estimate, Evidence, VisuoHapticObject
from visuohaptic.database import (
    FeatureIndex,
    ObjectDatabase,
    add_evidence,
    open_database,
    synchronise,
)
from visuohaptic.database.sync import _note

from . import harness
from ._journal import Journal
from .objects_faults import make_object

#: Searches, and changes of a synchronisation.
SEARCHES, CHANGES = 100, 1000


def imported(folder: Path, count: int, seconds: float) -> tuple[float, float] | None:
    """Import the objects that are missing; CPU and wall time of all of them [s], or ``None`` where time was up."""
    done = Journal(folder / "import.jsonl", {"study": "objects_db"})
    until = time.monotonic() + seconds
    with open_database(folder / "shared") as database:
        for start in range(0, count, 1000):
            if str(start) in done:
                continue
            if time.monotonic() > until:
                return None
            some = [make_object(number) for number in range(start, min(start + 1000, count))]
            began = time.process_time(), time.perf_counter()
            database.add_many(some)
            done.put(str(start), [time.process_time() - began[0], time.perf_counter() - began[1]])
    cpu_s, wall_s = np.sum([done.rows[str(start)] for start in range(0, count, 1000)], axis=0)
    return float(cpu_s), float(wall_s)


def linear_scan(ids: Sequence[str], vectors: np.ndarray, query: np.ndarray, count: int) -> list[str]:
    """The nearest objects by a full comparison of all vectors."""
    known = ~np.isnan(query)
    distances = [
        np.linalg.norm(vectors[start : start + 4096, known] - query[known], axis=1)
        for start in range(0, len(vectors), 4096)
    ]
    return [ids[place] for place in np.argsort(np.concatenate(distances), kind="stable")[:count]]


def search_rows(ids: Sequence[str], vectors: np.ndarray) -> list[dict[str, Any]]:
    """Rows of the search among vectors."""
    rng = np.random.default_rng(2)
    count, n = vectors.shape
    began_s = time.process_time()
    index = FeatureIndex(ids, vectors)
    index_s = time.process_time() - began_s
    searches, walls, same = [], [], True
    for number in range(SEARCHES):
        # A known object measured again: half of its features, with errors.
        again = vectors[rng.integers(count)] + rng.normal(0, 0.1, n)
        again[rng.random(n) < 0.5] = np.nan
        began_s, began_wall_s = time.process_time(), time.perf_counter()
        found = index.nearest(again, 5)
        searches.append(time.process_time() - began_s)
        walls.append(time.perf_counter() - began_wall_s)
        if number < 5:
            same &= [m.id for m in found] == linear_scan(ids, vectors, again, 5)
    query = rng.normal(size=n)
    same &= [m.id for m in index.nearest(query, 5)] == linear_scan(ids, vectors, query, 5)
    search_s = harness.cpu_seconds(lambda: index.nearest(query, 5))
    peer_s = harness.cpu_seconds(lambda: linear_scan(ids, vectors, query, 5), repeats=3)
    return [
        {
            "name": "nearest features, 5 of all, CPU",
            "ours": search_s * 1e3,
            "unit": "ms",
            "peer": peer_s * 1e3,
            "peer_name": "NumPy in blocks",
            "floor": 10,
            "aim": 3,
            "note": "query far from all objects",
        },
        {
            "name": "the same of known objects by half of their features, p95, CPU",
            "ours": float(np.quantile(searches, 0.95)) * 1e3,
            "unit": "ms",
            "floor": 10,
            "aim": 3,
            "note": f"{SEARCHES} searches; median {np.median(searches) * 1e3:.1f} ms; wall, "
            f"median {np.median(walls) * 1e3:.1f} ms, p95 {np.quantile(walls, 0.95) * 1e3:.1f} ms",
        },
        {"name": "index built, CPU", "ours": index_s, "unit": "s", "note": f"{index.bytes / 1e9:.2f} GB"},
        {
            "name": "same answers as in full",
            "ours": float(same),
            "unit": "1",
            "floor": 1,
            "higher_is_better": True,
        },
    ]


def run(
    count: int | None = None, folder: Path | None = None, seconds: float = np.inf
) -> list[dict[str, Any]]:
    """All rows; ``OBJECTS_DB_COUNT`` makes a slice of it."""
    count = count or int(os.environ.get("OBJECTS_DB_COUNT", "100000"))
    if folder is None:
        with tempfile.TemporaryDirectory() as name:
            return run(count, Path(name), seconds)
    taken = imported(folder, count, seconds)
    if taken is None:
        return [{"name": "time is up, call again", "ours": 0.0, "unit": "1"}]
    cpu_s, wall_s = taken
    rng = np.random.default_rng(1)
    note = f"{count} objects, 60 vertices and 192 features each"
    with open_database(folder / "shared") as database:
        chosen = [f"o{number:07d}" for number in rng.integers(0, count, 400)]
        reads = []
        for one in chosen:
            began_s = time.process_time()
            database.get(one)
            reads.append(time.process_time() - began_s)
        began_s = time.process_time()
        ids, vectors = database.features("stiffness")
        index_s = time.process_time() - began_s
        searched = search_rows(ids, vectors)
        with tempfile.TemporaryDirectory() as robot:
            changes_s, changes_wall_s = synchronised_changes(database, Path(robot), count)
    return [
        {
            "name": "import, CPU",
            "ours": count / cpu_s,
            "unit": "1/s",
            "floor": 3000,
            "aim": 5000,
            "higher_is_better": True,
            "note": note,
        },
        {
            "name": "import, wall",
            "ours": count / wall_s,
            "unit": "1/s",
            "floor": 3000,
            "aim": 5000,
            "higher_is_better": True,
            "note": note,
        },
        {
            "name": "read of one object, CPU",
            "ours": harness.median(reads) * 1e3,
            "unit": "ms",
            "floor": 5,
            "aim": 1,
        },
        *searched,
        {"name": "all features read, CPU", "ours": index_s, "unit": "s"},
        {
            "name": f"synchronisation of {CHANGES} changes, CPU",
            "ours": changes_s,
            "unit": "s",
            "floor": 5,
            "aim": 1,
            "note": f"half of them sent, half received; wall {changes_wall_s:.1f} s",
        },
    ]


def synchronised_changes(shared: ObjectDatabase, folder: Path, count: int) -> tuple[float, float]:
    """CPU and wall time of a synchronisation that sends and receives :data:`CHANGES` together [s]."""
    with open_database(folder) as robot:
        # A robot that has synchronised before: it knows some objects, and where both were then. In a database that is kept,
        # each run takes other objects, as those of the last one differ from the robot's.
        last = shared.last_change()
        first = CHANGES * (last % max(1, count // CHANGES))
        robot.add_many(make_object(number) for number in range(first, first + min(count, CHANGES)))
        _note(robot, shared.id, robot.last_change(), last)
        robot.add_many(_felt(number) for number in range(first, first + CHANGES // 2))
        shared.add_many(_felt(number) for number in range(first + CHANGES // 2, first + CHANGES))
        began = time.process_time(), time.perf_counter()
        found = synchronise(robot, shared)
        taken = time.process_time() - began[0], time.perf_counter() - began[1]
        assert (found.sent, found.received) == (CHANGES // 2, CHANGES - CHANGES // 2), found
        return taken


def _felt(number: int) -> VisuoHapticObject:
    """An object that was touched again."""
    felt = Evidence("tag.stiffness_N_per_m", Estimate(1000.0, 10.0), key=str(number))
    return add_evidence(VisuoHapticObject(f"o{number:07d}"), felt)


def main() -> None:
    """Print the rows."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.objects_db", description=__doc__)
    parser.add_argument("--objects", type=int, default=100_000)
    parser.add_argument("--folder", type=Path, help="where the database is kept between calls")
    parser.add_argument("--seconds", type=float, default=np.inf, help="of importing in this call")
    parser.add_argument(
        "--vectors", action="store_true", help="search among random vectors, without a database"
    )
    args = parser.parse_args()
    if args.vectors:
        ids = [f"o{number:07d}" for number in range(args.objects)]
        rows = search_rows(ids, np.random.default_rng(0).normal(size=(args.objects, 192)))
    else:
        rows = run(args.objects, args.folder, args.seconds)
    for row in rows:
        print(f"{row['name']:65s} {row['ours']:10.4g} {row['unit']:4s} {row.get('note', '')}")


if __name__ == "__main__":
    main()
