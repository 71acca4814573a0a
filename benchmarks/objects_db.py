"""A database of 10^5 objects: import, read and nearest-feature search (needs 2 GB of disk)."""

from __future__ import annotations

import os
import tempfile
import time
from typing import Any

import numpy as np

from visuohaptic.database import PlainIndex, index_of, open_database

from . import harness
from .objects_faults import make_object


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
        search_s = harness.cpu_seconds(lambda: index.nearest(query, 5))
        peer_s = harness.cpu_seconds(lambda: plain.nearest(query, 5), repeats=3)
    return [
        {
            "name": "import, CPU",
            "ours": count / cpu_s,
            "unit": "1/s",
            "floor": 2000,
            "higher_is_better": True,
            "note": note,
        },
        {
            "name": "import, wall",
            "ours": count / wall_s,
            "unit": "1/s",
            "floor": 2000,
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
            "floor": 20,
            "aim": 5,
            "note": note,
        },
        {
            "name": "same answers as in full",
            "ours": float(same),
            "unit": "1",
            "floor": 1,
            "higher_is_better": True,
        },
    ]
