"""Faults of ``objects build``: builds that are killed, and malformed input files.

    python -m benchmarks.build_faults --kills 200 --workers 20 --files 300 --report faults.jsonl
                                      prints lost objects, crashes, unclear messages and peak memory

An existing report is continued, and every row of the table is computed from it. ``python -m benchmarks build_faults`` does the
same with the report named by the variable ``BUILD_FAULTS_JOURNAL``.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import subprocess
import sys
import tempfile
import threading
import time
import zipfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from visuohaptic.core import VisuohapticError
from visuohaptic.deformation.maps import BuildJob, build, load_plan, plan_jobs

from ._dask_cluster import DaskCluster
from ._journal import Journal

SEED = 20261121
PLAN = """\
seed: 5
around: 16
band: false
classes:
  - {class: cup, variants: 40}
  - {class: elliptic, variants: 40}
"""
_BUILD = "import sys; from visuohaptic.deformation import *; build(plan_jobs(*load_plan(sys.argv[1])), sys.argv[2])"
#: Damaged files per line of the report.
FILES_A_LINE = 50
#: Address space of the reading process [bytes].
ROOM_BYTES = 4 << 30
_READ = """\
import resource, sys
from visuohaptic.deformation import load_object, mesh_container, load_container
from visuohaptic.core.errors import VisuohapticError
import trimesh, collada, scipy.sparse.csgraph
resource.setrlimit(resource.RLIMIT_AS, ({room}, {room}))
for line in sys.stdin:
    path = line.strip()
    try:
        load_object(path, around=32)
        print("accepted", flush=True)
    except VisuohapticError as error:
        print("refused" if chr(10) not in str(error) else "many lines", flush=True)
    except BaseException as error:
        print("leaked", type(error).__name__, str(error)[:100].replace(chr(10), " "), flush=True)
"""


def run(
    kills: int = 200, workers: int = 20, files: int = 300, report: Path | None = None
) -> list[dict[str, Any]]:
    """Rows of the table; an interrupted campaign is continued from ``report``."""
    named = os.environ.get("BUILD_FAULTS_JOURNAL")
    done = Journal(
        report or (Path(named) if named else None),
        {"campaign": "build_faults", "kills": kills, "workers": workers, "files": files},
    )
    return [_kills(kills, done), _worker_kills(workers, done), _files(files, done)]


def _rounds(kind: str, count: int, done: Journal, attempt: Callable[..., dict[str, Any]]) -> list[Any]:
    """Builds that are killed repeatedly, until there are enough kills; each build is a line of the report.

    ``attempt`` takes the plan's file, its jobs, a folder, the number of the round, how many kills are
    left, and the hash of a build that nobody disturbed.
    """
    found: list[Any] = []
    with tempfile.TemporaryDirectory() as scratch:
        plan = Path(scratch) / "classes.yaml"
        plan.write_text(PLAN)
        jobs = plan_jobs(*load_plan(plan))
        whole = ""
        while (left := count - sum(row["kills"] for row in found)) > 0:
            number = len(found)
            if (key := f"{kind} {number}") not in done:
                whole = whole or build(jobs, Path(scratch) / "whole").content_sha256
                row = attempt(plan, jobs, Path(scratch) / f"{kind}{number}", number, left, whole)
                done.put(key, {**row, "objects": len(jobs)})
            found.append(done.rows[key])
    return found


def _kills(count: int, done: Journal) -> dict[str, Any]:
    found = _rounds("kill", count, done, _killed_build)
    return {
        "name": f"builds with another hash after {sum(row['kills'] for row in found)} kills",
        "ours": float(sum(row["lost"] for row in found)),
        "unit": f"of {len(found)}",
        "floor": 0.0,
        "higher_is_better": False,
        "note": f"{found[0]['objects'] if found else 0} objects a build, {sum(row['left_over'] for row in found)} half-written files "
        "under a result's name",
    }


def _killed_build(
    plan: Path, jobs: Sequence[BuildJob], folder: Path, number: int, left: int, whole: str
) -> dict[str, Any]:
    """One build, killed after every one or two objects until it is complete or the number of kills is reached."""
    rng = np.random.default_rng([SEED, number])
    kills, left_over = 0, 0
    while kills < left:
        before = _written(folder)
        # Forks avoid the start of an interpreter; every tenth is a new interpreter.
        fresh = kills % 10 == 9
        process: Any
        if fresh:
            process = subprocess.Popen([sys.executable, "-c", _BUILD, str(plan), str(folder)], env=os.environ)
        else:
            process = multiprocessing.get_context("fork").Process(target=build, args=(jobs, folder))
            process.start()
        while len(_written(folder)) <= len(before) and _alive(process):
            time.sleep(0.001)
        time.sleep(float(rng.uniform(0, 0.05)))
        ended = not _alive(process)
        process.kill()
        process.wait() if fresh else process.join()
        for path in _written(folder) - before:
            try:
                with np.load(path, allow_pickle=False) as data:
                    left_over += any(data[name] is None for name in data.files)
            except (OSError, ValueError, EOFError, zipfile.BadZipFile):
                left_over += 1
        if ended:
            break
        kills += 1
    report = build(jobs, folder)
    return {"kills": kills, "lost": int(report.content_sha256 != whole), "left_over": left_over}


def _written(folder: Path) -> set[Path]:
    return {path for path in folder.glob("*/*.npz") if not path.name.startswith(".")}


def _alive(process: Any) -> bool:
    return bool(process.poll() is None if hasattr(process, "poll") else process.is_alive())


def _worker_kills(count: int, done: Journal) -> dict[str, Any]:
    found = _rounds("worker", count, done, _cluster_build)
    reason = next((row["reason"] for row in found if row["reason"]), "")
    return {
        "name": f"builds on a cluster with another hash after {sum(row['kills'] for row in found)} workers "
        "were killed -9",
        "ours": float(sum(row["lost"] for row in found)),
        "unit": f"of {len(found)}",
        "floor": 0.0,
        "higher_is_better": False,
        "note": f"two dask workers, {found[0]['objects'] if found else 0} objects a build"
        + (f"; {reason}" if reason else ""),
    }


def _cluster_build(
    _plan: Path, jobs: Sequence[BuildJob], folder: Path, number: int, left: int, whole: str
) -> dict[str, Any]:
    """A scheduler and two workers as processes of their own; a worker is killed (SIGKILL) and replaced."""
    rng = np.random.default_rng([SEED, number])
    with tempfile.TemporaryDirectory() as scratch, DaskCluster(2, Path(scratch)) as cluster:
        kills = 0
        found: list[Any] = []
        builder = threading.Thread(target=_collect, args=(jobs, folder, cluster.address, found))
        builder.start()
        while builder.is_alive() and kills < min(left, 5):
            before = len(_written(folder))
            deadline = time.monotonic() + 120
            while len(_written(folder)) <= before and time.monotonic() < deadline and builder.is_alive():
                time.sleep(0.005)
            time.sleep(float(rng.uniform(0, 0.05)))
            if builder.is_alive():
                cluster.kill_worker(int(rng.integers(len(cluster.workers))))
                kills += 1
        builder.join(900)
    report = found[0] if found else None
    return {
        "kills": kills,
        "lost": int(getattr(report, "content_sha256", "") != whole),
        "reason": str(report) if isinstance(report, Exception) else "",
    }


def _collect(jobs: Any, folder: Path, address: str, found: list[Any]) -> None:
    try:
        found.append(build(jobs, folder, workers=address))
    except VisuohapticError as error:
        found.append(error)


def _files(count: int, done: Journal) -> dict[str, Any]:
    answers: dict[str, int] = {}
    bad: list[str] = []
    whole: list[Any] = []
    for begin in range(0, count, FILES_A_LINE):
        key = f"files {begin}"
        if key not in done:
            whole = whole or malformed(np.random.default_rng(SEED), count)
            done.put(key, _read_files(whole[begin : begin + FILES_A_LINE], begin))
        for kind, number in done.rows[key]["answers"].items():
            answers[kind] = answers.get(kind, 0) + number
        bad += done.rows[key]["bad"]
    return {
        "name": "damaged meshes and descriptions that end in anything but a map or one line",
        "ours": float(len(bad)),
        "unit": f"of {count}",
        "floor": 0.0,
        "higher_is_better": False,
        "note": f"{answers}, address space of {ROOM_BYTES >> 30} GiB"
        + ("; " + "; ".join(bad[:3]) if bad else ""),
    }


def _read_files(some: Sequence[tuple[str, bytes]], begin: int) -> dict[str, Any]:
    answers: dict[str, int] = {}
    bad = []
    reader: Any = None
    with tempfile.TemporaryDirectory() as scratch, ExitStack() as stack:
        for number, (suffix, data) in enumerate(some, begin):
            if reader is None or reader.poll() is not None:
                reader = subprocess.Popen(
                    [sys.executable, "-c", _READ.format(room=ROOM_BYTES)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    text=True,
                )
                stack.callback(reader.kill)
            path = Path(scratch) / f"file{number}{suffix}"
            path.write_bytes(data)
            reader.stdin.write(f"{path}\n")
            reader.stdin.flush()
            answer = reader.stdout.readline().strip() or "died"
            kind = answer.split()[0]
            answers[kind] = answers.get(kind, 0) + 1
            if kind not in {"refused", "accepted"}:
                bad.append(f"{path.name}: {answer}")
                if kind == "died":
                    reader.wait()
            path.unlink()
        reader.stdin.close()
        reader.wait()
    return {"answers": answers, "bad": bad}


def malformed(rng: np.random.Generator, count: int) -> list[tuple[str, bytes]]:
    """Cut, changed, stretched and swapped files of every kind; some may still contain a valid container."""
    import io

    import trimesh

    from visuohaptic.deformation.shapes import tube_mesh

    found = tube_mesh(0.03, 0.1, 0.0005, around=32, along=32, crossed=False)
    mesh = trimesh.Trimesh(found.vertices_m, found.faces, process=False)
    whole = {}
    for kind in ("stl", "ply", "obj", "glb", "dae"):
        out = mesh.export(file_type=kind)
        whole[f".{kind}"] = out.encode() if isinstance(out, str) else bytes(out)
    text = io.StringIO()
    text.write("name: a\nbase: {shape: ellipse, radius: 35 mm, radius_y: [20 mm, 25 mm]}\n")
    text.write("sections:\n  - {height: 50 mm, bulge: 2 mm}\n  - {height: 30 mm, radius: 15 mm}\n")
    text.write("rings: [{z: 20 mm, depth: -1 mm, width: 8 mm}]\nwall: 0.5 mm\nmaterial: PET\n")
    whole[".yaml"] = text.getvalue().encode()
    kinds = list(whole)
    out_files = []
    for number in range(count):
        suffix = kinds[number % len(kinds)]
        data = np.frombuffer(whole[suffix], np.uint8).copy()
        how = (number // len(kinds)) % 5
        if how == 0:
            data = data[: rng.integers(0, len(data))]
        elif how == 1:
            places = rng.integers(0, min(len(data), 400), 4)
            data[places] = rng.integers(0, 256, 4)
        elif how == 2:
            places = rng.integers(0, len(data), 40)
            data[places] = rng.integers(0, 256, 40)
        elif how == 3:
            a, b = np.sort(rng.integers(0, len(data), 2))
            data = np.concatenate([data[:a], data[a:b], data[a:b], data[b:]])
        else:
            digits = np.flatnonzero((data >= 48) & (data <= 57))
            if suffix in {".stl", ".glb"} or not digits.size:
                digits = np.arange(len(data))
            places = rng.choice(digits, min(8, digits.size), replace=False)
            data[places] = 57 if suffix not in {".stl", ".glb"} else 255
        out_files.append((suffix, data.tobytes()))
    return out_files


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--workers", type=int, default=20)
    parser.add_argument("--files", type=int, default=300)
    parser.add_argument(
        "--report",
        type=Path,
        default=Path("results/build_faults.jsonl"),
        help="JSON lines; a stopped campaign goes on where it was (%(default)s)",
    )
    options = parser.parse_args()
    for row in run(options.kills, options.workers, options.files, options.report):
        print(row)
