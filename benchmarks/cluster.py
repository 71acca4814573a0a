"""Every long verb on a cluster with a worker that is killed: is the output identical to a local run, and how does it scale?

    python -m benchmarks.cluster               all verbs, and the speed; needs pip install 'visuohaptic[cluster]'
    python -m benchmarks.cluster --only "map build" "classify train"    these verbs only

Scheduler and workers are processes of this machine. Speed is measured with tasks that sleep, which emulates
more cores than this machine may have; thus only the overhead of the distribution is measured.
"""

from __future__ import annotations

import argparse
import hashlib
import math
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest import mock

import numpy as np

from visuohaptic.cli.main import main as visuohaptic
from visuohaptic.core import LaserScan, map_tasks
from visuohaptic.deformation.maps import build, load_plan, plan_jobs
from visuohaptic.io.laser_scans import write_scans
from visuohaptic.recognition import HapticClassifier
from visuohaptic.recognition.data import FeatureSet
from visuohaptic.reproduce import reproduce_all

from . import completion, templates_evidence
from ._dask_cluster import DaskCluster, noted_square

PLAN = "seed: 3\naround: 16\nband: false\nclasses: [{class: cup, variants: 6}]\n"
#: Sleeping tasks, and how long each is [s].
TASKS, SLEEP_S = 40, 0.2
#: Durations of the study, which differ between runs.
MEASURED_TIMES = ("step_s",)
#: Modules with few kernels, which are recompiled.
WARM_MODULES = ("visuohaptic.database._search_kernels", "visuohaptic.recognition.trees._tree_kernels")


def _objects_build(workers: int | str, folder: Path) -> str:
    (folder / "plan.yaml").write_text(PLAN)
    return build(plan_jobs(*load_plan(folder / "plan.yaml")), folder / "out", workers=workers).content_sha256


def _reproduce(workers: int | str, folder: Path) -> str:
    found = reproduce_all(["figure-4.1", "figure-4.2", "figure-4.3"], folder, quick=True, workers=workers)
    assert not any(one.problem for one in found), found
    return _digest(path.read_bytes() for one in found for path in sorted(one.folder.glob("*.csv")))


def _campaign(workers: int | str, folder: Path) -> str:
    rows = templates_evidence.campaign(count=4, report=folder / "rows.jsonl", workers=workers)
    return _digest([repr(rows).encode()])


def _completion(workers: int | str, folder: Path) -> str:
    found = completion.study(2, touches=2, journal=folder / "rows.jsonl", workers=workers)
    return _digest([repr({key: found[key] for key in found if key not in MEASURED_TIMES}).encode()])


def _map_build(workers: int | str, folder: Path) -> str:
    names = []
    for floor in range(4):
        names.append(str(folder / f"floor-{floor}.csv"))
        write_scans(names[-1], _drive(3.0 + floor))
    _verb("map", "build", *names, "--out", str(folder / "maps"), workers=workers)
    return _digest(path.read_bytes() for path in sorted((folder / "maps").iterdir()))


def _drive(half_m: float) -> list[tuple[LaserScan, tuple[float, float, float]]]:
    """Scans along the middle of a room of 4 m width and twice ``half_m`` length."""
    angle = -math.pi + math.pi / 360 * np.arange(720)
    scans = []
    for step in range(40):
        x, c, s = 0.05 * step, np.cos(angle), np.sin(angle)
        with np.errstate(divide="ignore"):
            ranges = np.minimum(np.where(c > 0, (half_m - x) / c, (-half_m - x) / c), np.abs(2 / s))
        scans.append((LaserScan(0.1 * step, ranges, -math.pi, math.pi / 360, 0.05, 20.0), (x, 0.0, 0.0)))
    return scans


def _classify_train(workers: int | str, folder: Path) -> str:
    return _saved(HapticClassifier().fit(_containers(), workers=workers), folder)


def _classify_tune(workers: int | str, folder: Path) -> str:
    return _saved(HapticClassifier().tune(_containers(), workers=workers), folder)


def _containers() -> FeatureSet:
    """Twelve objects of three classes, which differ in the stiffness of their upper end."""
    rng, height = np.random.default_rng(0), np.linspace(0, 1, 16)
    top = np.repeat([500.0, 4e3, 2e4], 12)
    profile = 8e3 * (top[:, None] / 8e3) ** height * rng.lognormal(0, 0.3, (36, 1))
    stiffness = np.repeat(profile[:, :, None], 4, axis=2) * rng.lognormal(0, 0.1, (36, 16, 4))
    width = np.full((36, 16, 2), 0.06) * rng.lognormal(0, 0.02, (36, 1, 1))
    return FeatureSet.of_stiffness(stiffness, width, ["cup"] * 12 + ["bottle"] * 12 + ["jar"] * 12)


def _saved(classifier: HapticClassifier, folder: Path) -> str:
    classifier.save(folder / "tree.json")
    return _digest([(folder / "tree.json").read_bytes(), repr(classifier.fitted().calibration).encode()])


def _warmup(workers: int | str, folder: Path) -> str:
    """Names of the machine code that was written: each is the digest of its inputs."""
    packages = [module.partition(".")[2].rpartition(".")[0] for module in WARM_MODULES]
    _verb("warmup", *packages, workers=2 if workers == 1 else workers)
    return _digest(path.name.encode() for path in sorted(folder.rglob("visuohaptic.*")))


#: Long verb -> its run, which returns a digest.
LONG: dict[str, Callable[[int | str, Path], str]] = {
    "objects build": _objects_build,
    "reproduce": _reproduce,
    "campaign (templates)": _campaign,
    "completion study": _completion,
    "map build": _map_build,
    "classify train": _classify_train,
    "classify train --tune": _classify_tune,
    "warmup": _warmup,
}


def _verb(*words: str, workers: int | str) -> None:
    chosen = ["--cluster", workers] if isinstance(workers, str) else ["--workers", str(workers)]
    if code := visuohaptic([*words, *chosen, "--quiet"]):
        raise RuntimeError(f"visuohaptic {' '.join(words)}: exit code {code}")


def _digest(parts: Any) -> str:
    out = hashlib.sha256()
    for part in parts:
        out.update(len(part).to_bytes(8, "little") + part)
    return out.hexdigest()


@contextmanager
def _killer(cluster: DaskCluster) -> Iterator[list[int]]:
    """Kill the first worker that has a task; its number is appended to the list."""
    import distributed

    killed: list[int] = []
    done = threading.Event()

    def watch() -> None:
        with distributed.Client(cluster.address, set_as_default=False) as client:
            while not (killed or done.wait(0.01)):
                ports = {worker.rpartition(":")[2] for worker, keys in client.processing().items() if keys}
                for number, worker in enumerate(cluster.workers):
                    if not killed and ports & set(cluster.ports(worker)):
                        cluster.kill_worker(number)
                        killed.append(number)

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield killed
    finally:
        done.set()
        thread.join()


def same_bytes(only: Sequence[str] = ()) -> list[dict[str, Any]]:
    """Run each of :data:`LONG` locally and on two workers of which one is killed; compare the bytes."""
    rows = []
    for name in only or LONG:
        with TemporaryDirectory() as here, TemporaryDirectory() as there:
            with mock.patch.dict(os.environ, _cache(name, here)):
                expected = LONG[name](1, Path(here))
            with DaskCluster(2, Path(there), _cache(name, there)) as cluster, _killer(cluster) as killed:
                cluster.wait()
                same = LONG[name](cluster.address, Path(there)) == expected
        rows.append({"name": name, "same": same, "killed": len(killed)})
        print(
            f"{name}: {'the same bytes' if same else 'OTHER BYTES'}, {len(killed)} worker killed", flush=True
        )
    return rows


def _cache(name: str, folder: str) -> dict[str, str]:
    return {"VISUOHAPTIC_CACHE_DIR": folder} if name == "warmup" else {}


def speed(counts: Sequence[int] = (1, 2, 4)) -> dict[int, float]:
    """Wall time of the sleeping tasks on a number of workers [s]."""
    times = {}
    for count in counts:
        with TemporaryDirectory() as text, DaskCluster(count, Path(text)) as cluster:
            cluster.wait()
            # First tasks import the library; they are not timed.
            list(map_tasks(noted_square, [(text, -1, 0.5)] * count, name="cluster", workers=cluster.address))
            tasks = [(text, number, SLEEP_S) for number in range(TASKS)]
            began_s = time.perf_counter()
            list(map_tasks(noted_square, tasks, name="cluster", workers=cluster.address))
            times[count] = time.perf_counter() - began_s
    return times


def run(only: Sequence[str] = ()) -> list[dict[str, Any]]:
    """Rows of the table."""
    rows = same_bytes(only)
    good = sum(row["same"] and row["killed"] == 1 for row in rows)
    found: list[dict[str, Any]] = [
        {"name": "long verbs on the cluster, a worker killed, same bytes as here", "ours": float(good),
         "unit": f"of {len(rows)}", "floor": float(len(rows)), "aim": float(len(rows)),
         "higher_is_better": True, "note": ", ".join(row["name"] for row in rows)},
    ]  # fmt: skip
    times = speed()
    for count, floor, aim in ((2, 1.8, 1.95), (4, 3.4, 3.8)):
        found.append(
            {"name": f"speed of {count} one-core workers, of one", "ours": times[1] / times[count], "unit": "x",
             "floor": floor, "aim": aim, "higher_is_better": True,
             "note": f"{TASKS} tasks that sleep {SLEEP_S} s: {times[1]:.2f} s and {times[count]:.2f} s"}
        )  # fmt: skip
    return found


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.cluster", description=__doc__)
    parser.add_argument("--only", nargs="*", choices=list(LONG), default=[], help="some of the verbs")
    for row in run(parser.parse_args().only):
        print(
            f"{row['name']}: {row['ours']:.3g} {row['unit']}, floor {row['floor']}, aim {row['aim']}  ({row['note']})"
        )


if __name__ == "__main__":
    main()
