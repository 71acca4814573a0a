"""Runs benchmark modules and reports machine, versions and commit.

A benchmark is a module of this folder with ``run() -> list[dict]``. Each dict is
one row; its keys are those of :class:`Row` (``name``, ``ours`` and ``unit`` are
required). Measure CPU time with :func:`cpu_seconds` on one thread, alternating between ours and the
peer's in the same process.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import json
import math
import os
import pkgutil
import platform
import statistics
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from visuohaptic._version import __version__
from visuohaptic.core.files import write_text

__all__ = [
    "Report", "Row", "benchmark_names", "comparison", "cpu_seconds", "read_rows", "run", "save", "table",
    "use_one_thread",
]  # fmt: skip

#: Campaigns of more than a few minutes, which run only if named.
CAMPAIGNS = (
    "beam",
    "build_faults",
    "cluster",
    "completion",
    "crown_cap",
    "foam_evidence",
    "foam_faults",
    "foam_tags",
    "foam_tension",
    "foreign_glass",
    "gcs_compressions",
    "glass_evidence",
    "grasp",
    "icub_grasps",
    "mission",
    "nav_push",
    "nav_scenes",
    "objects_db",
    "objects_faults",
    "odometry_evidence",
    "recog_state",
    "recog_table62",
    "reproduce",
    "scene",
    "scene_evidence",
    "shell_evidence",
    "soak",
    "tag_evidence",
    "templates_evidence",
    "touch_map",
    "transparency",
)

#: Modules of this folder that are not benchmarks.
_NOT_BENCHMARKS = {"constants", "harness", "house", "kernel_signatures", "kernel_wheel"}

#: Libraries whose versions change what is measured.
_LIBRARIES = ("numpy", "scipy", "numba", "opencv-python-headless", "scikit-image", "mujoco-core", "av")

ROOT = Path(__file__).resolve().parents[1]


#: A bound, or a range that the figure has to lie in; in a benchmark's dict also as text, "0.8-1.25".
Limit = float | tuple[float, float]


@dataclass(frozen=True, slots=True)
class Row:
    """One figure."""

    name: str
    ours: float  #: measured here, in ``unit``
    unit: str
    peer: float | None = None  #: the peer's figure, in the same unit, from the same process
    peer_name: str = ""
    ratio: float | None = None  #: peer / ours or ours / peer: larger than 1 means that we are better
    floor: Limit | None = None  #: what is owed, in ``unit``
    aim: Limit | None = None  #: what puts us ahead, in ``unit``
    higher_is_better: bool | None = None  #: told from floor and aim when not given
    note: str = ""
    benchmark: str = ""  #: module that it comes from; filled in by :func:`run`
    verdict: str = ""  #: "aim", "floor", "missed", "failed" or ""; filled in by :func:`run`


@dataclass(frozen=True, slots=True)
class Report:
    """All rows of one run, and where they were measured."""

    machine: dict[str, Any]
    versions: dict[str, str]
    commit: str
    command: str
    started: str  #: UTC
    rows: list[Row] = field(default_factory=list)


def benchmark_names() -> list[str]:
    """Modules of this folder that are benchmarks."""
    found = [module.name for module in pkgutil.iter_modules([str(Path(__file__).parent)])]
    return [name for name in found if name not in _NOT_BENCHMARKS and not name.startswith("_")]


def use_one_thread() -> None:
    """Limit every library to one thread, so that CPU time is that of one core."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[name] = "1"
    import cv2
    from numba import config

    cv2.setNumThreads(1)
    # numba reads its variable at the next compilation, and raises an error if its threads already run.
    config.reload_config()


def cpu_seconds(work: Callable[[], object], *, repeats: int = 7, min_s: float = 0.02, warm: int = 1) -> float:
    """CPU time of one call [s]: the smallest mean over ``repeats`` batches.

    A batch is long enough (``min_s``) for the clock; the smallest batch is
    the one that other work on the machine disturbed least. ``warm`` calls
    before that compile kernels and fill caches.
    """
    for _ in range(warm):
        work()
    calls, spent_s = 1, 0.0
    while True:
        started_s = time.process_time()
        for _ in range(calls):
            work()
        spent_s = time.process_time() - started_s
        if spent_s >= min_s:
            break
        calls *= 2
    best_s = spent_s
    for _ in range(repeats - 1):
        started_s = time.process_time()
        for _ in range(calls):
            work()
        best_s = min(best_s, time.process_time() - started_s)
    return best_s / calls


def run(names: Iterable[str], package: str = __package__ or "benchmarks") -> Report:
    """Run benchmarks one after the other; a failure becomes a row of its own."""
    report = Report(
        _machine(),
        _versions(),
        _commit(),
        " ".join(["python -m benchmarks", *sys.argv[1:]]),
        time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    )
    for name in names:
        try:
            found = importlib.import_module(f"{package}.{name}").run()
            report.rows.extend(_judged(name, row) for row in found)
        except Exception as error:  # noqa: BLE001 - the others still run, and this one is told as failed
            traceback.print_exc()
            note = f"{type(error).__name__}: {error}"
            report.rows.append(Row(name, float("nan"), "", note=note, benchmark=name, verdict="failed"))
    return report


def _judged(benchmark: str, found: dict[str, Any]) -> Row:
    limits = {name: _limit(found.get(name)) for name in ("floor", "aim")}
    row = Row(**{**found, **limits, "benchmark": benchmark})
    higher = row.higher_is_better
    if higher is None and isinstance(row.floor, float) and isinstance(row.aim, float):
        higher = row.aim > row.floor
    verdict = ""
    if row.floor is not None or row.aim is not None:
        met = [name for name in ("aim", "floor") if _meets(row.ours, limits[name], bool(higher))]
        verdict = met[0] if met else "missed"
    ratio = row.ratio
    if ratio is None and row.peer is not None and row.ours:
        ratio = row.ours / row.peer if higher else row.peer / row.ours
    return replace(row, verdict=verdict, ratio=ratio)


def _limit(value: object) -> Limit | None:
    if value is None or value == "":
        return None
    if isinstance(value, str):
        low, separator, high = value.partition("-")
        return (float(low), float(high)) if separator else float(low)
    if isinstance(value, (tuple, list)):
        return float(value[0]), float(value[1])
    return float(value)


def _meets(value: float, limit: Limit | None, higher: bool) -> bool:
    if limit is None:
        return False
    if isinstance(limit, tuple):
        return limit[0] <= value <= limit[1]
    return value >= limit if higher else value <= limit


def table(report: Report) -> str:
    """The report as text, one line per row."""
    machine = report.machine
    head = [
        f"machine   {machine['cpu']}, {machine['cores']} cores, load {machine['load']}, {machine['system']}",
        "versions  " + ", ".join(f"{name} {version}" for name, version in report.versions.items()),
        f"commit    {report.commit}",
        f"command   {report.command}, started {report.started}",
        "",
    ]
    cells = [["figure", "ours", "peer", "ratio", "unit", "floor", "aim", "verdict", "peer is / note"]]
    for row in report.rows:
        name = row.name if row.name.startswith(row.benchmark) else f"{row.benchmark}: {row.name}"
        about = "; ".join(text for text in (row.peer_name, row.note) if text)
        numbers = [_number(value) for value in (row.ours, row.peer, row.ratio)]
        cells.append([name, *numbers, row.unit, _number(row.floor), _number(row.aim), row.verdict, about])
    widths = [max(len(line[column]) for line in cells) for column in range(len(cells[0]))]
    right = {1, 2, 3, 5, 6}
    lines = [
        "  ".join(
            text.rjust(width) if column in right else text.ljust(width)
            for column, (text, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in cells
    ]
    lines.insert(1, "-" * max(len(line) for line in lines))
    return "\n".join(head + lines)


def save(path: Path, report: Report) -> None:
    """Write the report as JSON, atomically."""
    from visuohaptic.core.files.plain_json import plain

    write_text(path, json.dumps(plain(asdict(report)), indent=2) + "\n")


def read_rows(path: Path) -> tuple[str, dict[str, tuple[float, str]]]:
    """Commit of a saved report, and value and unit of each figure.

    Parameters
    ----------
    path
        File of :func:`save`.
    """
    report = json.loads(path.read_text(encoding="utf-8"))
    rows = [row for row in report["rows"] if row["ours"] is not None]
    return report["commit"], {
        f"{row['benchmark']}: {row['name']}": (row["ours"], row["unit"]) for row in rows
    }


def comparison(reports: list[tuple[str, dict[str, tuple[float, str]]]]) -> str:
    """Ratio of every figure after and before, with the range of its pairs.

    Parameters
    ----------
    reports
        As :func:`read_rows`, of two commits in turn: before, after, before, after, ...
    """
    pairs = list(zip(reports[::2], reports[1::2], strict=True))
    for (before, _), (after, _) in pairs:
        if (before, after) != (reports[0][0], reports[1][0]):
            raise SystemExit(f"found {before} before {after}, expected {reports[0][0]} and {reports[1][0]}")
    lines = [f"before {reports[0][0]}, after {reports[1][0]}, {len(pairs)} pairs"]
    for name, (_, unit) in reports[0][1].items():
        found = [(old[name][0], new[name][0]) for (_, old), (_, new) in pairs if name in old and name in new]
        if not found or not all(old for old, _ in found):
            continue
        old_value, new_value = (median(values) for values in zip(*found, strict=True))
        ratios = sorted(new / old for old, new in found)
        text = f"{median(ratios):6.3f} ({ratios[0]:.3f} - {ratios[-1]:.3f})"
        lines.append(f"{text}  {old_value:10.4g} -> {new_value:10.4g} {unit:10s} {name}")
    return "\n".join(lines)


def median(values: Iterable[float]) -> float:
    """The median element."""
    return float(statistics.median(values))


def _number(value: Limit | None) -> str:
    if isinstance(value, tuple):
        return f"{value[0]:g}-{value[1]:g}"
    return "" if value is None or math.isnan(value) else f"{value:.4g}"


def _machine() -> dict[str, Any]:
    cpu = platform.processor()
    information = Path("/proc/cpuinfo")
    if information.is_file():
        lines = information.read_text().splitlines()
        models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
        cpu = models[0] if models else cpu
    load = f"{os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else "unknown"
    system = f"{platform.system()} {platform.release()}, Python {platform.python_version()}"
    return {"cpu": cpu or platform.machine(), "cores": os.cpu_count(), "load": load, "system": system}


def _versions() -> dict[str, str]:
    versions = {"visuohaptic": __version__}
    for name in _LIBRARIES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "absent"
    return versions


def _commit() -> str:
    def git(*words: str) -> str:
        done = subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=False)
        return done.stdout.strip() if done.returncode == 0 else ""

    commit = git("rev-parse", "--short=12", "HEAD")
    if not commit:
        return "unknown"
    return commit + (" with changes" if git("status", "--porcelain", "--untracked-files=no") else "")
