"""Recordings whose writer is killed or meets a full disk, and recordings that are cut anywhere.

python -m benchmarks.kill_faults --count 40
"""

from __future__ import annotations

import argparse
import csv
import os
import signal
import struct
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

#: Writes rows 0, 1, ... and prints each number when ``write`` has returned.
_WRITER = """
import sys
import numpy as np
from visuohaptic.core import ErrorBudget, ForceProfile, Reason
from visuohaptic.core.camera import Camera, Pose
from visuohaptic.io import DepthFrame, MeasurementWriter, TableWriter
from visuohaptic.io.depth import write_sequence

path, count, limit = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
if limit:
    import resource, signal
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

def said(number):
    print(number, flush=True)

s_m = np.linspace(0.0, 0.1, 30)
def profile(n):
    values = (s_m, 1e-3 * s_m, 1e-5 + 0 * s_m, s_m, s_m, np.ones(30, bool))
    return ForceProfile(0.1 * n, True, Reason.OK, float(n), ErrorBudget(image_N=0.1), *values)

camera = Camera.simple(20, 16, 30.0)
def views():
    rng = np.random.default_rng(0)
    for n in range(count):
        depth_m = rng.uniform(0.5, 3.0, (16, 20)).astype(np.float32)
        yield DepthFrame(0.1 * n, depth_m, None, Pose(np.eye(3), np.array([n, 0.0, 0.0]) * 1e-3), camera)
        said(n)  # the next one is asked for when this one is written

try:
    if path.endswith("scan"):
        write_sequence(path, views())
    elif path.endswith(".mcap"):
        with MeasurementWriter(path) as writer:
            for n in range(count):
                writer.write_force(profile(n))
                said(n)
    else:
        with TableWriter(path) as table:
            for n in range(count):
                table.write(profile(n))
                said(n)
except ValueError as error:
    print(error)
"""
KINDS = ("r.csv", "r.parquet", "r.mcap", "scan")


def start(path: Path, count: int, limit: int = 0) -> subprocess.Popen[str]:
    """A process that writes rows into a recording, whose files may have ``limit`` bytes."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen(
        [sys.executable, "-c", _WRITER, str(path), str(count), str(limit)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment,
        text=True,
    )


def kill(path: Path, after: int) -> int:
    """Kill a writer without warning when it has acknowledged some rows; how many it had by then."""
    with start(path, 10**6) as child:
        assert child.stdout is not None
        assert child.stderr is not None
        for _ in range(after):
            if not child.stdout.readline():
                raise RuntimeError(child.stderr.read())
        child.send_signal(signal.SIGKILL)
        return after + len(child.stdout.read().split())


def numbers(path: Path) -> list[float]:
    """Numbers of the rows in a whole recording, by readers that are not ours where there are some."""
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
    from visuohaptic.io.depth import DepthSequence

    return [float(np.rint(1e3 * frame.T_world_camera.translation_m[0])) for frame in DepthSequence(path)]


def killed_row(number: int, folder: Path) -> dict[str, Any]:
    """One killed writer: acknowledged rows, and those of them that are lost after recovery."""
    from visuohaptic.io import recover

    name = KINDS[number % len(KINDS)]
    after = int(np.random.default_rng([6, number]).integers(1, 60))
    acknowledged = kill(folder / name, after)
    found = numbers(recover(folder / name if name == "scan" else folder / f"{name}.part").path)
    right = found[:acknowledged] == list(range(acknowledged)) and len(found) <= acknowledged + 1
    return {"kind": name, "acknowledged": acknowledged, "lost": 0 if right else 1}


def full_disk_row(number: int, folder: Path) -> dict[str, Any]:
    """One full disk: is the error one line with the file, is anything lost, has half a file its final name?"""
    from visuohaptic.io import recover

    name = KINDS[number % 3]
    limit = int(np.random.default_rng([7, number]).integers(30_000, 200_000))
    with start(folder / name, 10**6, limit) as child:
        out, trouble = child.communicate(timeout=300)
    *acknowledged, message = out.splitlines()
    clear = message.startswith(str(folder / name)) and "recording recover" in message and not trouble
    final = (folder / name).exists()
    found = numbers(recover(folder / f"{name}.part").path)
    lost = found != list(range(len(acknowledged)))
    return {
        "kind": name,
        "acknowledged": len(acknowledged),
        "lost": int(lost),
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
    from visuohaptic.io import McapFile, recover

    rows = []
    with tempfile.TemporaryDirectory() as root:
        folder = Path(root)
        with start(folder / "r.mcap", 40) as child:
            child.communicate(timeout=300)
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
