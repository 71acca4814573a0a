"""Extrapolation to a thousand robots with a shared database: storage, load, and the first bottleneck.

    python -m benchmarks.fleet --robots 1000 --objects 1e8    prints storage, CPU time and traffic with their limits

Bytes and CPU time of one object are measured on a small database and a few robots that synchronise with it in turn;
all other figures are extrapolated and marked as such. The server is a file here; a PostgreSQL server is not faster.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

from visuohaptic.database import index_of, open_database, synchronise

from .objects_faults import make_object

#: Objects of the sample, robots that take turns, and objects that each learns between two turns.
SAMPLE, TURNS, LEARNT = 2000, 4, 100
#: Objects that one robot meets in its building, and how often it synchronises [s].
OWN, EVERY_S = 20_000, 600.0
#: A server's cores and memory, and the memory of a robot's computer [bytes].
CORES, SERVER_BYTES, ROBOT_BYTES = 32, 256e9, 16e9


def measured() -> dict[str, float]:
    """Bytes on disk and in memory of an object, CPU time of a change, sent and received together [s]."""
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        with open_database(folder / "shared") as shared:
            shared.add_many(make_object(number) for number in range(SAMPLE))
            index = index_of(shared, "stiffness")
            memory = index.bytes / SAMPLE
            disk = (
                sum(path.stat().st_size for path in (folder / "shared").rglob("*") if path.is_file()) / SAMPLE
            )
            changes, spent_s = 0, 0.0
            for turn in range(TURNS):
                with open_database(folder / f"robot{turn % 2}") as robot:
                    first = SAMPLE + turn * LEARNT
                    robot.add_many(make_object(number) for number in range(first, first + LEARNT))
                    began_s = time.process_time()
                    found = synchronise(robot, shared)
                    spent_s += time.process_time() - began_s
                    changes += found.sent + found.received
    return {"disk": disk, "memory": memory, "change_s": spent_s / changes}


def fleet(robots: int, objects: float, one: dict[str, float]) -> list[tuple[str, float, str, str]]:
    """Lines of the table: figure, value, unit, what follows."""
    learnt_per_s = objects / (365 * 86400.0)
    load = robots * OWN * 0.01 / 86400.0 * one["change_s"]
    line = robots * learnt_per_s * one["disk"]
    return [
        ("an object on disk, in the index", one["disk"], "B", f"{one['memory']:.0f} B in memory"),
        ("a robot's own building on its disk", OWN * one["disk"] / 1e6, "MB", f"{OWN} objects; fits anywhere"),
        ("all objects on the server's disk", objects * one["disk"] / 1e12, "TB", "arrays are most of it"),
        ("all objects on a robot's disk", objects * one["disk"] / 1e12, "TB",
         f"breaks first: a robot with {ROBOT_BYTES / 1e9:.0f} GB holds {ROBOT_BYTES / one['disk']:.2g}"),
        ("search index of all objects", objects * one["memory"] / 1e9, "GB",
         f"{SERVER_BYTES / 1e9:.0f} GB hold {SERVER_BYTES / one['memory']:.2g}"),
        ("a first synchronisation with all", objects * one["change_s"] / 3600.0, "hours of a core",
         "and all bytes over the net, for each robot"),
        ("CPU of 1 % of each building changed a day", load, "cores", f"of {CORES}"),
        ("everybody hears of all, learnt evenly over a year", line / 1e6, "MB/s", "out of the server"),
        ("turns a second", robots / EVERY_S, "1/s", f"each robot every {EVERY_S:.0f} s; writers take turns"),
        ("changes that one writer at a time takes", 1.0 / one["change_s"], "1/s",
         f"{robots} robots make {robots * OWN * 0.01 / 86400.0:.2g}"),
    ]  # fmt: skip


def run(robots: int = 1000, objects: float = 1e8) -> list[dict[str, Any]]:
    """The table as rows."""
    return [
        {"name": name, "ours": value, "unit": unit, "note": note}
        for name, value, unit, note in fleet(robots, objects, measured())
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fleet", description=__doc__)
    parser.add_argument("--robots", type=int, default=1000)
    parser.add_argument("--objects", type=float, default=1e8)
    args = parser.parse_args()
    for row in run(args.robots, args.objects):
        print(f"{row['name']:50s} {row['ours']:10.3g} {row['unit']:15s} {row['note']}")


if __name__ == "__main__":
    main()
