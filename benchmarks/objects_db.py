"""A database of 10^5 objects: import, read, nearest-feature search and synchronisation (needs 2 GB of disk).

OBJECTS_DB_COUNT=1000000 python -m benchmarks objects_db    # 20 GB of disk, 8 GB of memory, half an hour
"""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from visuohaptic.core import Estimate, Evidence, VisuoHapticObject
from visuohaptic.database import (
    ObjectDatabase,
    PlainIndex,
    add_evidence,
    index_of,
    open_database,
    synchronise,
)
from visuohaptic.database.sync import _note

from . import harness
from .objects_faults import make_object

#: Searches, and changes of a synchronisation.
SEARCHES, CHANGES = 100, 1000


def run(count: int | None = None) -> list[dict[str, Any]]:
    """All rows; ``OBJECTS_DB_COUNT`` makes a slice of it."""
    count = count or int(os.environ.get("OBJECTS_DB_COUNT", "100000"))
    rng = np.random.default_rng(1)
    note = f"{count} objects, 60 vertices and 192 features each"
    with tempfile.TemporaryDirectory() as folder, open_database(folder) as database:
        cpu_s = wall_s = 0.0
        for start in range(0, count, 1000):
            some = [make_object(number) for number in range(start, min(start + 1000, count))]
            began = time.process_time(), time.perf_counter()
            database.add_many(some)
            cpu_s += time.process_time() - began[0]
            wall_s += time.perf_counter() - began[1]
        chosen = [f"o{number:07d}" for number in rng.integers(0, count, 400)]
        reads = []
        for one in chosen:
            began_s = time.process_time()
            database.get(one)
            reads.append(time.process_time() - began_s)
        index = index_of(database, "stiffness")
        ids, vectors, _ = database.features("stiffness")
        plain = PlainIndex(ids, vectors)
        query = rng.normal(size=192)
        same = all(
            [m.id for m in index.nearest(q, 5)] == [m.id for m in plain.nearest(q, 5)]
            for q in rng.normal(size=(5, 192))
        )
        searches = []
        for _ in range(SEARCHES):
            # An object that is known, felt once more: half of its features, with an error.
            again = vectors[rng.integers(count)] + rng.normal(0, 0.1, 192)
            again[rng.random(192) < 0.5] = np.nan
            began_s = time.process_time()
            index.nearest(again, 5)
            searches.append(time.process_time() - began_s)
        search_s = harness.cpu_seconds(lambda: index.nearest(query, 5))
        peer_s = harness.cpu_seconds(lambda: plain.nearest(query, 5), repeats=3)
        changes_s, changes_wall_s = synchronised_changes(database, Path(folder) / "robot", count)
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
            "note": f"{SEARCHES} searches",
        },
        {
            "name": f"synchronisation of {CHANGES} changes, CPU",
            "ours": changes_s,
            "unit": "s",
            "floor": 5,
            "aim": 1,
            "note": f"half of them sent, half received; wall {changes_wall_s:.1f} s",
        },
        {
            "name": "same answers as in full",
            "ours": float(same),
            "unit": "1",
            "floor": 1,
            "higher_is_better": True,
        },
    ]


def synchronised_changes(shared: ObjectDatabase, folder: Path, count: int) -> tuple[float, float]:
    """CPU and wall time of a synchronisation that sends and receives :data:`CHANGES` together [s]."""
    with open_database(folder) as robot:
        # A robot that has synchronised before: it knows some objects, and where both were then.
        robot.add_many(make_object(number) for number in range(min(count, CHANGES)))
        _note(robot, shared.id, robot.last_change(), shared.last_change())
        robot.add_many(_felt(number) for number in range(CHANGES // 2))
        shared.add_many(_felt(number) for number in range(CHANGES // 2, CHANGES))
        began = time.process_time(), time.perf_counter()
        found = synchronise(robot, shared)
        taken = time.process_time() - began[0], time.perf_counter() - began[1]
        assert (found.sent, found.received) == (CHANGES // 2, CHANGES - CHANGES // 2), found
        return taken


def _felt(number: int) -> VisuoHapticObject:
    """An object that was touched once more."""
    felt = Evidence("tag.stiffness_N_per_m", Estimate(1000.0, 10.0), key=str(number))
    return add_evidence(VisuoHapticObject(f"o{number:07d}"), felt)
