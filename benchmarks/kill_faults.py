"""Recordings whose writer is killed or meets a full disk, and recordings that are truncated anywhere: is anything lost?

python -m benchmarks.kill_faults --count 40    prints one line for each fault: acknowledged and lost rows
"""

from __future__ import annotations

import argparse
import csv
import resource
import signal
import struct
import tempfile
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from visuohaptic.core import ErrorBudget, ForceProfile, InputError, Reason
from visuohaptic.core.camera import Camera, Pose
from visuohaptic.io import DepthFrame, McapFile, MeasurementWriter, TableWriter, recover
from visuohaptic.io.depth import DepthSequence, write_sequence

from ._victim import Say, Victim

KINDS = ("r.csv", "r.parquet", "r.mcap", "scan")
_S_M = np.linspace(0.0, 0.1, 30)


def _profile(number: int) -> ForceProfile:
    values = (_S_M, 1e-3 * _S_M, 1e-5 + 0 * _S_M, _S_M, _S_M, np.ones(30, bool))
    return ForceProfile(0.1 * number, True, Reason.OK, float(number), ErrorBudget(image_N=0.1), *values)


def _views(count: int, say: Say) -> Iterator[DepthFrame]:
    rng = np.random.default_rng(0)
    camera = Camera.simple(20, 16, 30.0)
    for n in range(count):
        depth_m = rng.uniform(0.5, 3.0, (16, 20)).astype(np.float32)
        yield DepthFrame(0.1 * n, depth_m, None, Pose(np.eye(3), np.array([n, 0.0, 0.0]) * 1e-3), camera)
        say(f"{n}")  # the next one is requested when this one is written


def write(path: Path, say: Say, count: int = 10**6) -> None:
    """Write rows 0, 1, ... into a recording, and report each number when it is acknowledged."""
    if path.suffix == "":
        write_sequence(path, _views(count, say))
    elif path.suffix == ".mcap":
        with MeasurementWriter(path) as writer:
            for n in range(count):
                writer.write_force(_profile(n))
                say(f"{n}")
    else:
        with TableWriter(path) as table:
            for n in range(count):
                table.write(_profile(n))
                say(f"{n}")


@cache
def load_libraries() -> None:
    """A row of every kind, so that a fork need not import what writes it."""
    with tempfile.TemporaryDirectory() as folder:
        for name in KINDS:
            write(Path(folder, name), str, 1)


def kill(path: Path, *, cpu_s: float = 0.0, file_bytes: int = 0) -> int:
    """Kill a writer without warning; returns the number of acknowledged rows."""
    load_libraries()
    lines, code = Victim.start(partial(write, path), cpu_s=cpu_s, file_bytes=file_bytes).end()
    if code not in (-signal.SIGPROF, -signal.SIGXFSZ):
        raise RuntimeError(f"{path.name}: the writer ended by itself with {code}")
    return len(lines)


def fill_disk(path: Path, limit: int) -> tuple[int, str]:
    """Write until files may not grow beyond ``limit`` bytes; rows acknowledged by then, and the error."""

    def work(say: Say) -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))  # Python ignores the signal
        try:
            write(path, say)
        except ValueError as error:
            say(str(error))

    (*rows, message), _ = Victim.start(work).end()
    return len(rows), message


def numbers(path: Path) -> list[float]:
    """Numbers of the rows in a whole recording, by third-party readers where available."""
    if path.suffix == ".csv":
        with path.open(newline="") as stream:
            return [float(row["force_N"]) for row in csv.DictReader(stream)]
    if path.suffix == ".parquet":
        import pyarrow.parquet as pq

        return [float(value) for value in pq.read_table(path).column("force_N").to_pylist()]
    if path.suffix == ".mcap":
        from mcap.reader import make_reader

        with path.open("rb") as stream:
            times_s = [m.log_time * 1e-9 for _, _, m in make_reader(stream).iter_messages(["/foam/profile"])]
        return [float(np.rint(10 * t_s)) for t_s in times_s]
    return [float(np.rint(1e3 * frame.T_world_camera.translation_m[0])) for frame in DepthSequence(path)]


def killed_row(number: int, folder: Path) -> dict[str, Any]:
    """One killed writer: acknowledged rows, and those of them that are lost after recovery.

    By turns after a time of the processor, and inside of a ``write``.
    """
    name = KINDS[number % len(KINDS)]
    rng = np.random.default_rng([6, number])
    in_write = number // len(KINDS) % 2 == 1 and name != "scan"  # whose files are small
    acknowledged = (
        kill(folder / name, file_bytes=int(rng.integers(2_000, 100_000)))
        if in_write
        else kill(folder / name, cpu_s=rng.uniform(0.005, 0.15))
    )
    left = folder / (name if name == "scan" else f"{name}.part")
    try:
        found = numbers(recover(left).path)
    except InputError:
        found = []  # there may be nothing yet
    right = found[:acknowledged] == list(range(acknowledged)) and len(found) <= acknowledged + 1
    return {"kind": name, "acknowledged": acknowledged, "lost": 0 if right else 1}


def full_disk_row(number: int, folder: Path) -> dict[str, Any]:
    """One full disk: is the error one line with the file, is anything lost, has half a file its final name?"""
    name = KINDS[number % 3]
    limit = int(np.random.default_rng([7, number]).integers(30_000, 200_000))
    acknowledged, message = fill_disk(folder / name, limit)
    clear = message.startswith(str(folder / name)) and "recording recover" in message
    final = (folder / name).exists()
    found = numbers(recover(folder / f"{name}.part").path)
    return {
        "kind": name,
        "acknowledged": acknowledged,
        "lost": int(found != list(range(acknowledged))),
        "wrong": int(final or not clear),
    }


def _ends(data: bytes) -> list[int]:
    """Where each message of an MCAP file without chunks ends, by the layout of the format alone."""
    place, ends = 8, []
    while place + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, place)
        place += 9 + length
        if opcode == 0x05:
            ends.append(place)
        if opcode == 0x0F:
            break
    return ends


def cut_rows(count: int) -> list[dict[str, Any]]:
    """One recording, cut at ``count`` places: messages that were whole, and those of them that are recovered."""
    rows = []
    with tempfile.TemporaryDirectory() as root:
        folder = Path(root)
        write(folder / "r.mcap", str, 40)
        data = (folder / "r.mcap").read_bytes()
        ends = _ends(data)
        first = ends[0]
        for number in range(count):
            cut = int(np.random.default_rng([8, number]).integers(first, len(data)))
            path = folder / f"cut{number}.mcap"
            path.write_bytes(data[:cut])
            whole = sum(end <= cut for end in ends)
            found = sum(1 for _ in McapFile(recover(path, folder / f"whole{number}.mcap").path).messages())
            rows.append({"whole": whole, "lost": abs(whole - found)})
    return rows


def main() -> None:
    """Print one line for each fault."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=8)
    args = parser.parse_args()
    for number in range(args.count):
        for row in (killed_row, full_disk_row):
            with tempfile.TemporaryDirectory() as root:
                print(row.__name__, row(number, Path(root)))
    rows = cut_rows(5 * args.count)
    print("cut", len(rows), "lost", sum(row["lost"] for row in rows))


if __name__ == "__main__":
    main()
