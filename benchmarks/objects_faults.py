"""Databases under fire: writers that are killed, a disk that is full, sixteen writers at once (issue: database).

Nothing acknowledged may be lost, nothing may be half-written, and the integrity check must be clean.
The disk is a small memory file system, which needs the right to mount one; without it that row is left out.
"""

from __future__ import annotations

import os
import random
import select
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from visuohaptic.core import DatabaseError, Estimate, Evidence, FeatureVector, StiffnessMap, VisuoHapticObject
from visuohaptic.database import add_evidence, open_database

from ._journal import Journal


def make_object(number: int, vertices: int = 60) -> VisuoHapticObject:
    """An object that is told by its number alone."""
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


def forked(work: Callable[[], None]) -> int:
    """Run in a child process; its id."""
    pid = os.fork()
    if pid == 0:
        try:
            work()
        except BaseException:  # noqa: BLE001 - the child must end here whatever happens
            os._exit(1)
        os._exit(0)
    return pid


def losses(folder: Path, acknowledged: set[str]) -> tuple[int, list[str]]:
    """Acknowledged objects that are missing or changed, and the problems of the check."""
    with open_database(folder) as database:
        lost = 0
        for one in acknowledged:
            try:
                found = database.get(one)
                wanted = make_object(int(one[1:])).stiffness
                lost += not np.array_equal(found.stiffness.vertices_m, wanted.vertices_m)
            except Exception:  # noqa: BLE001 - whatever it is, it is a loss
                lost += 1
        return lost, list(database.check().problems)


def kills(folder: Path, count: int, rng: random.Random) -> dict[str, int]:
    """Kill an import ``count`` times at random moments."""
    with open_database(folder) as database:  # also loads the libraries, which the children share
        database.add_many(make_object(number) for number in range(8))
    acknowledged: set[str] = set()
    lost = problems = wrong = 0
    start = 8
    for number in range(count):
        reader, writer = os.pipe()

        def work(first: int = start, reader: int = reader, writer: int = writer) -> None:
            os.close(reader)
            with open_database(folder) as database:
                database.add_many(
                    (make_object(number) for number in range(first, first + 100_000)),
                    batch=8,
                    stored=lambda ids: os.write(writer, (" ".join(ids) + "\n").encode()),
                )

        pid = forked(work)
        os.close(writer)
        if number % 2:
            # Half of them are killed in the midst of writing, however slowly the machine gets there.
            select.select([reader], [], [], 60.0)
        time.sleep(rng.uniform(0.02, 0.5))
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        with os.fdopen(reader) as pipe:
            new = {one for line in pipe if line.endswith("\n") for one in line.split()}
        acknowledged |= new
        gone, found = losses(folder, new)
        lost, problems = lost + gone, problems + len(found)
        with open_database(folder) as database:
            stored = len(database)
            wrong += stored % 8 != 0  # whole transactions only
        start = stored
    gone, found = losses(folder, acknowledged)
    return {
        "acknowledged": len(acknowledged),
        "lost": lost + gone,
        "problems": problems + len(found),
        "half-written": wrong,
    }


def writers(folder: Path, processes: int = 16, objects: int = 40) -> dict[str, int]:
    """Many at once: objects of their own, and evidence on one that all share."""
    with open_database(folder):
        pass

    def work(own: int) -> None:
        with open_database(folder) as database:
            for number in range(objects):
                database.add(make_object(own * 1000 + number))
                seen = Evidence("tag.stiffness_N_per_m", Estimate(1000.0 + own, 10.0), key=f"{own} {number}")
                database.add(add_evidence(VisuoHapticObject("shared"), seen))

    pids = [forked(lambda own=own: work(own)) for own in range(processes)]
    failed = sum(os.waitpid(pid, 0)[1] != 0 for pid in pids)
    wanted = {f"o{own * 1000 + number:07d}" for own in range(processes) for number in range(objects)}
    lost, problems = losses(folder, wanted)
    with open_database(folder) as database:
        evidence = len(database.get("shared").evidence)
    return {
        "acknowledged": 2 * processes * objects,
        "lost": lost + processes * objects - evidence,
        "problems": len(problems) + failed,
    }


def full_disk(count: int, rng: random.Random) -> dict[str, int] | None:
    """Write until the disk is full, ``count`` times; ``None`` where no small disk can be mounted."""
    total = {"acknowledged": 0, "lost": 0, "problems": 0}
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
    """All rows; with ``OBJECTS_FAULTS_JOURNAL`` naming a file, a stopped campaign goes on where it was."""
    named = os.environ.get("OBJECTS_FAULTS_JOURNAL")
    about = {"study": "objects_faults", "kills": kill_count, "disks": disk_count}
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

    def some_writers() -> dict[str, int]:
        with tempfile.TemporaryDirectory() as name:
            return writers(Path(name) / "db")

    rows: list[dict[str, Any]] = []
    found = {
        f"{kill_count} x kill -9 during import": in_blocks("kills", kill_count, 20, some_kills),
        "16 writers at once": kept("16 writers", some_writers),
        f"{disk_count} x full disk": in_blocks("disks", disk_count, 5, full_disk),
    }
    for case, result in found.items():
        if result is None:
            continue
        note = f"{result['acknowledged']} acknowledged"
        for key in result.keys() - {"acknowledged"}:
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
