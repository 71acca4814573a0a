"""Database faults: writers that are killed, a full disk, sixteen concurrent writers. Counts lost and half-written objects.

    python -m benchmarks objects_faults

No acknowledged object may be lost, none half-written, and the integrity check must pass.
The disk is a small memory file system, which requires the right to mount one; otherwise this row is left out.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import tempfile
from collections import Counter
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from visuohaptic.core import DatabaseError, Estimate, Evidence, FeatureVector, StiffnessMap, VisuoHapticObject
from visuohaptic.database import add_evidence, open_database

from ._journal import Journal
from ._victim import Say, Victim


def make_object(number: int, vertices: int = 60) -> VisuoHapticObject:
    """An object defined by its number."""
    rng = np.random.default_rng(number)
    surface = StiffnessMap(
        rng.normal(size=(vertices, 3)),
        rng.integers(0, vertices, size=(2 * vertices - 4, 3)),
        rng.uniform(100, 5000, vertices),
        np.full(vertices, 50.0),
    )
    known = VisuoHapticObject(
        f"o{number:07d}",
        name=f"object {number}",
        visual_class=f"class {number % 50}",
        stiffness=surface,
        features={"stiffness": FeatureVector(rng.normal(size=192))},
    )
    return add_evidence(known, Evidence("material.youngs_modulus_Pa", Estimate(1e9 + number, 1e8)))


def losses(folder: Path, acknowledged: set[str]) -> tuple[int, list[str]]:
    """Acknowledged objects that are missing or changed, and the problems of the check."""
    with open_database(folder) as database:
        lost = 0
        for one in acknowledged:
            try:
                found = database.get(one)
                wanted = make_object(int(one[1:])).stiffness
                assert found.stiffness is not None
                assert wanted is not None
                lost += not np.array_equal(found.stiffness.vertices_m, wanted.vertices_m)
            except Exception:  # noqa: BLE001 - whatever it is, it is a loss
                lost += 1
        return lost, list(database.check().problems)


@cache
def _load_libraries() -> None:
    """An object written and read, so that a fork need not import what does it."""
    with tempfile.TemporaryDirectory() as folder, open_database(folder) as database:
        database.get(database.add(make_object(0)).id)


def kills(folder: Path, count: int, rng: random.Random) -> dict[str, int]:
    """Kill an import ``count`` times: after a CPU time, or inside a ``write`` to one of its files."""
    _load_libraries()
    with open_database(folder):
        pass
    total = Counter({"tried": count, "acknowledged": 0, "lost": 0, "problems": 0, "half-written": 0})
    acknowledged: set[str] = set()
    start = 0
    for number in range(count):

        def work(say: Say, first: int = start) -> None:
            with open_database(folder) as database:
                database.add_many(
                    (make_object(number) for number in range(first, first + 100_000)),
                    batch=8,
                    stored=lambda ids: say(" ".join(ids)),
                )

        grown = max(path.stat().st_size for path in folder.iterdir())
        victim = (
            Victim.start(work, file_bytes=grown + rng.randint(1, 200_000))
            if number % 2
            else Victim.start(work, cpu_s=rng.uniform(0.005, 0.15))
        )
        lines, code = victim.end()
        if code not in (-signal.SIGPROF, -signal.SIGXFSZ):
            raise RuntimeError(f"the import ended by itself with {code}")
        new = {one for line in lines for one in line.split()}
        acknowledged |= new
        gone, found = losses(folder, new)
        with open_database(folder) as database:
            stored = len(database)
        # Whole transactions only.
        total.update({"lost": gone, "problems": len(found), "half-written": int(stored % 8 != 0)})
        start = stored
    gone, found = losses(folder, acknowledged)
    total.update({"acknowledged": len(acknowledged), "lost": gone, "problems": len(found)})
    return dict(total)


def writers(
    folder: Path, processes: int = 16, objects: int = 40, kill_rng: random.Random | None = None
) -> dict[str, int]:
    """Concurrent writers: each adds its own objects and evidence on a shared one; with ``kill_rng`` all are killed."""
    _load_libraries()
    with open_database(folder):
        pass

    def work(say: Say, own: int) -> None:
        with open_database(folder) as database:
            for number in range(objects):
                database.add(make_object(own * 1000 + number))
                seen = Evidence("tag.stiffness_N_per_m", Estimate(1000.0 + own, 10.0), key=f"{own} {number}")
                database.add(add_evidence(VisuoHapticObject("shared"), seen))
                say(f"{number}")

    victims = [
        Victim.start(partial(work, own=own), cpu_s=0.0 if kill_rng is None else kill_rng.uniform(0.005, 0.15))
        for own in range(processes)
    ]
    ends = [victim.end() for victim in victims]
    said = {(own, int(line)) for own, (lines, _) in enumerate(ends) for line in lines}
    failed = sum(code != 0 and (kill_rng is None or code != -signal.SIGPROF) for _, code in ends)
    lost, problems = losses(folder, {f"o{own * 1000 + number:07d}" for own, number in said})
    with open_database(folder) as database:
        kept = {one.key for one in database.get("shared").evidence} if "shared" in database else set()
    return {
        "tried": processes,
        "acknowledged": 2 * len(said),
        "lost": lost + sum(f"{own} {number}" not in kept for own, number in said),
        "problems": len(problems) + failed,
        "killed": sum(code == -signal.SIGPROF for _, code in ends),
    }


def full_disk(count: int, rng: random.Random) -> dict[str, int] | None:
    """Write until the disk is full, ``count`` times; ``None`` where no small disk can be mounted."""
    total = {"tried": count, "acknowledged": 0, "lost": 0, "problems": 0}
    for _ in range(count):
        with tempfile.TemporaryDirectory() as name:
            size = rng.randint(600, 3000)
            options = ["mount", "-t", "tmpfs", "-o", f"size={size}k", "tmpfs", name]
            if subprocess.run(options, capture_output=True, check=False).returncode:
                return None
            try:
                folder = Path(name) / "db"
                acknowledged: set[str] = set()
                with open_database(folder) as database:
                    try:
                        database.add_many(
                            (make_object(n) for n in range(100_000)), batch=4, stored=acknowledged.update
                        )
                        total["problems"] += 1  # the disk cannot have held them
                    except (DatabaseError, ValueError) as error:
                        total["problems"] += not isinstance(error, DatabaseError)
                    # Still readable with the full disk, in this process and in the next.
                    total["problems"] += sum(one not in database for one in acknowledged)
                lost, problems = losses(folder, acknowledged)
                total["acknowledged"] += len(acknowledged)
                total["lost"] += lost
                total["problems"] += len(problems)
            finally:
                subprocess.run(["umount", name], capture_output=True, check=False)
    return total


def run(kill_count: int = 200, disk_count: int = 20) -> list[dict[str, Any]]:
    """All rows; with ``OBJECTS_FAULTS_JOURNAL`` naming a file, an interrupted campaign is continued."""
    named = os.environ.get("OBJECTS_FAULTS_JOURNAL")
    about = {"campaign": "objects faults", "kills": kill_count, "disks": disk_count}
    done = Journal(Path(named) if named else None, about)

    def kept(key: str, work: Callable[[], dict[str, int] | None]) -> dict[str, int] | None:
        if key not in done:
            done.put(key, work())
        return done.rows[key]

    def in_blocks(
        name: str, count: int, block: int, work: Callable[[int, random.Random], dict[str, int] | None]
    ) -> dict[str, int] | None:
        total: dict[str, int] = {}
        for start in range(0, count, block):
            size = min(block, count - start)
            rng = random.Random(f"{name} {start}")
            part = kept(f"{name} {start}", lambda size=size, rng=rng: work(size, rng))
            if part is None:
                return None
            for key, value in part.items():
                total[key] = total.get(key, 0) + value
        return total

    def some_kills(count: int, rng: random.Random) -> dict[str, int]:
        with tempfile.TemporaryDirectory() as name:
            return kills(Path(name) / "db", count, rng)

    def some_writers(rng: random.Random | None = None) -> dict[str, int]:
        with tempfile.TemporaryDirectory() as name:
            return writers(Path(name) / "db", kill_rng=rng)

    def killed_writers(count: int, rng: random.Random) -> dict[str, int]:
        return some_writers(rng)

    rows: list[dict[str, Any]] = []
    found = {
        f"{kill_count} x kill -9 during import": in_blocks("kills", kill_count, 5, some_kills),
        "16 writers at once": kept("16 writers", some_writers),
        f"16 writers at once, {kill_count} of them killed": in_blocks(
            "killed writers", kill_count, 16, killed_writers
        ),
        f"{disk_count} x full disk": in_blocks("disks", disk_count, 5, full_disk),
    }
    for case, result in found.items():
        if result is None:
            continue
        note = f"{result['acknowledged']} acknowledged"
        for key in result.keys() - {"tried", "acknowledged", "killed"}:
            rows.append(
                {
                    "name": f"{case}: {key}",
                    "ours": float(result[key]),
                    "unit": "1",
                    "floor": 0.0,
                    "aim": 0.0,
                    "higher_is_better": False,
                    "note": note,
                }
            )
    return rows
