"""Builds that are killed, and files that are malformed: nothing lost, one clear line, bounded memory.

    python -m benchmarks.build_faults --kills 200 --workers 20 --files 300

A short slice runs with the other benchmarks' names: ``python -m benchmarks build_faults``.
"""

from __future__ import annotations

import argparse
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from visuohaptic.deformation import load_plan, plan_jobs
from visuohaptic.deformation.build import build
from visuohaptic.errors import VisuohapticError

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
#: Address space of the reading process [bytes].
ROOM_BYTES = 4 << 30
_READ = """\
import resource, sys
from visuohaptic.deformation import load_object, mesh_container, load_container
from visuohaptic.errors import VisuohapticError
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


def run(kills: int = 3, files: int = 60, workers: int = 2) -> list[dict[str, Any]]:
    """Rows of the table."""
    return [_kills(kills), _worker_kills(workers), _files(files)]


def _kills(count: int) -> dict[str, Any]:
    rng = np.random.default_rng(SEED)
    with tempfile.TemporaryDirectory() as scratch:
        plan, killed = Path(scratch) / "classes.yaml", Path(scratch) / "killed"
        plan.write_text(PLAN)
        jobs = plan_jobs(*load_plan(plan))
        whole = build(jobs, Path(scratch) / "whole")
        lost, done, rounds = 0, 0, 0
        while done < count:
            process = subprocess.Popen([sys.executable, "-c", _BUILD, str(plan), str(killed)], env=os.environ)
            before = len(list(killed.glob("*/*.npz")))
            while len(list(killed.glob("*/*.npz"))) <= before and process.poll() is None:
                time.sleep(0.002)
            time.sleep(float(rng.uniform(0, 0.05)))
            if process.poll() is None:
                process.send_signal(signal.SIGKILL)
                done += 1
            process.wait()
            if len(list(killed.glob("*/*.npz"))) >= len(jobs):
                lost += build(jobs, killed).content_sha256 != whole.content_sha256
                rounds += 1
                for path in killed.glob("*/*.npz"):
                    path.unlink()
        lost += build(jobs, killed).content_sha256 != whole.content_sha256
    return {
        "name": f"builds with another hash after {done} kills",
        "ours": float(lost),
        "unit": f"of {rounds + 1}",
        "floor": 0.0,
        "higher_is_better": False,
    }


def _worker_kills(count: int) -> dict[str, Any]:
    """A scheduler and two workers as processes of their own; a worker is killed -9 and another comes."""
    rng = np.random.default_rng(SEED)
    with tempfile.TemporaryDirectory() as scratch, ExitStack() as stack:
        plan, killed = Path(scratch) / "classes.yaml", Path(scratch) / "killed"
        plan.write_text(PLAN)
        jobs = plan_jobs(*load_plan(plan))
        whole = build(jobs, Path(scratch) / "whole")
        port, begin = str(_free_port()), [sys.executable, "-m"]
        address = f"tcp://127.0.0.1:{port}"
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": scratch}
        scheduler = subprocess.Popen(
            [
                *begin,
                "distributed.cli.dask_scheduler",
                "--host",
                "127.0.0.1",
                "--port",
                port,
                "--no-dashboard",
            ],
            **quiet,  # type: ignore[call-overload]
        )
        stack.callback(_end, scheduler)

        def worker() -> subprocess.Popen[bytes]:
            # Without a nanny: its process is the one that computes.
            process: subprocess.Popen[bytes] = subprocess.Popen(
                [
                    *begin,
                    "distributed.cli.dask_worker",
                    address,
                    "--nthreads",
                    "1",
                    "--no-nanny",
                    "--no-dashboard",
                ],
                **quiet,  # type: ignore[call-overload]
            )
            stack.callback(_end, process)
            return process

        running = [worker(), worker()]
        done, rounds, lost = 0, 0, 0
        reason = ""
        while done < count:
            for path in killed.glob("*/*.npz"):
                path.unlink()
            found: list[Any] = []
            builder = threading.Thread(target=_collect, args=(jobs, killed, address, found))
            builder.start()
            while builder.is_alive() and done < count:
                before = len(list(killed.glob("*/*.npz")))
                deadline = time.monotonic() + 60
                while len(list(killed.glob("*/*.npz"))) <= before and time.monotonic() < deadline:
                    if not builder.is_alive():
                        break
                    time.sleep(0.005)
                time.sleep(float(rng.uniform(0, 0.05)))
                if builder.is_alive():
                    which = int(rng.integers(len(running)))
                    running[which].send_signal(signal.SIGKILL)
                    running[which].wait()
                    running[which] = worker()
                    done += 1
            builder.join(600)
            rounds += 1
            report = found[0] if found else None
            if isinstance(report, Exception):
                reason = str(report)
            lost += getattr(report, "content_sha256", "") != whole.content_sha256
    return {
        "name": f"builds on a cluster with another hash after {done} workers were killed -9",
        "ours": float(lost),
        "unit": f"of {rounds}",
        "floor": 0.0,
        "higher_is_better": False,
        "note": f"two dask workers, {len(jobs)} objects a build" + (f"; {reason}" if reason else ""),
    }


def _collect(jobs: Any, folder: Path, address: str, found: list[Any]) -> None:
    try:
        found.append(build(jobs, folder, cluster=address))
    except VisuohapticError as error:
        found.append(error)


def _free_port() -> int:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        return int(server.getsockname()[1])


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()


def _files(count: int) -> dict[str, Any]:
    rng = np.random.default_rng(SEED)
    with tempfile.TemporaryDirectory() as scratch:
        reader = subprocess.Popen(
            [sys.executable, "-c", _READ.format(room=ROOM_BYTES)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert reader.stdin is not None
        assert reader.stdout is not None
        answers: dict[str, int] = {}
        bad = []
        for number, (suffix, data) in enumerate(malformed(rng, count)):
            path = Path(scratch) / f"file{number}{suffix}"
            path.write_bytes(data)
            reader.stdin.write(f"{path}\n")
            reader.stdin.flush()
            answer = reader.stdout.readline().strip() or "died"
            kind = answer.split()[0]
            answers[kind] = answers.get(kind, 0) + 1
            if kind not in {"refused", "accepted"}:
                bad.append(f"{path.name}: {answer}")
            path.unlink()
            if answer == "died":
                break
        reader.stdin.close()
        reader.wait()
    return {
        "name": "damaged meshes and descriptions that end in anything but a map or one line",
        "ours": float(len(bad)),
        "unit": f"of {count}",
        "floor": 0.0,
        "higher_is_better": False,
        "note": f"{answers}, address space of {ROOM_BYTES >> 30} GiB"
        + ("; " + "; ".join(bad[:3]) if bad else ""),
    }


def malformed(rng: np.random.Generator, count: int) -> list[tuple[str, bytes]]:
    """Cut, changed, stretched and swapped files of every kind; some may still hold a container."""
    import io

    import trimesh

    from visuohaptic.deformation import tube_mesh

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
    options = parser.parse_args()
    for row in run(options.kills, options.files, options.workers):
        print(row)
