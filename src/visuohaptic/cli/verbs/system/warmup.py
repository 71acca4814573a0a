"""``visuohaptic warmup``: compile every kernel once, on this machine or on all machines of a cluster.

reads   nothing
writes  machine code into the user's cache folder (or VISUOHAPTIC_CACHE_DIR), and removes the code of other
        versions of this library; with --cluster, on every machine that has a worker now

examples
  visuohaptic warmup
  visuohaptic warmup sensing tracking --workers 1
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .... import core
from ....core.errors import InputError
from ....core.map_tasks import available_cores, cluster_hosts, map_tasks
from ..._console import Arguments, Progress
from ..._workers import add_worker_arguments, chosen_workers

#: One line for each kernel that Python calls, ``module:function (types of the arguments)``; the kernels that
#: these call follow. Written by ``python -m benchmarks.kernel_signatures``.
SIGNATURES = Path(__file__).parents[3] / "core" / "kernel_signatures.txt"

#: Maximum number of useful processes: ``navigation.graph`` alone is a quarter of the work.
MAX_USEFUL_WORKERS = 4


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add(
        "packages",
        str,
        "packages to compile, such as navigation or sensing.foam (all)",
        nargs="*",
        metavar="PACKAGE",
    )
    add_worker_arguments(add, f"one per core, at most {MAX_USEFUL_WORKERS}")


def read_signatures() -> dict[str, list[tuple[str, str]]]:
    """(function, types of its arguments) of each signature, by module."""
    found: dict[str, list[tuple[str, str]]] = {}
    for line in _lines():
        name, _, arguments = line.partition(" ")
        module, _, function = name.partition(":")
        found.setdefault(module, []).append((function, arguments))
    return found


def run(args: Arguments) -> dict[str, Any]:
    """Compile or load each signature, and time each package."""
    workers = chosen_workers(args, min(available_cores(), MAX_USEFUL_WORKERS))
    parts = _by_package(_chosen(args.packages), shared=workers != 1)
    hosts = None if args.cluster is None else cluster_hosts(args.cluster)
    tasks = [lines for lines in parts.values() for _ in hosts or ("here",)]
    seconds = dict.fromkeys(sorted(parts), 0.0)
    bar: Progress[Any]
    with args.progress(sum(map(len, tasks)), "compiling") as bar:
        places = None if hosts is None else hosts * len(parts)
        for number, taken_s in map_tasks(compile_lines, tasks, name="warmup", hosts=places, workers=workers):
            package = _package(tasks[number][0])
            seconds[package] += taken_s
            bar.advance(len(tasks[number]), package.removeprefix("visuohaptic."))
    for package, package_s in seconds.items():
        args.report(f"{package:<40}{package_s:7.2f} s")
    total_s = sum(seconds.values())
    args.report(f"{'compiled or read from the cache, CPU':<40}{total_s:7.2f} s")
    return {
        "seconds": seconds,
        "total_s": total_s,
        "workers": workers if isinstance(workers, str) else min(workers, len(parts)),
        "hosts": hosts or [],
        "removed": _remove_stale() if hosts is None else 0,
    }


def _by_package(lines: Sequence[str], *, shared: bool = True) -> dict[str, list[str]]:
    """Lines of the list by package, so that few kernels are compiled twice; the largest sources come first if shared."""
    size: dict[str, int] = {}
    for module in dict.fromkeys(line.partition(":")[0] for line in lines):
        path = SIGNATURES.parents[2].joinpath(*module.split(".")).with_suffix(".py")
        package = module.rpartition(".")[0]
        size[package] = size.get(package, 0) + (path.stat().st_size if path.exists() else 1)
    order = sorted(size, key=lambda name: (-size[name], name)) if shared else list(size)
    return {name: [line for line in lines if _package(line) == name] for name in order}


def compile_lines(lines: Sequence[str]) -> float:
    """Compile or load signatures; returns the CPU time [s].

    Parameters
    ----------
    lines
        Of the list of signatures.
    """
    started_s = time.process_time()
    for line in lines:
        name, _, arguments = line.partition(" ")
        module, _, function = name.partition(":")
        kernel = getattr(importlib.import_module(module), function)
        if hasattr(kernel, "compile"):  # missing with NUMBA_DISABLE_JIT
            kernel.compile(arguments)
    return time.process_time() - started_s


@contextmanager
def compiling_in_background(packages: Sequence[str] = ()) -> Iterator[subprocess.Popen[bytes] | None]:
    """Compile kernels while the block runs, in another process of the lowest priority that is terminated after it.

    No process is started (None) on a single core, or if the cache has as many entries of each kernel as the list.

    Parameters
    ----------
    packages
        As for the verb, in the order in which they are needed; all by default.
    """
    from ....core.kernels import cache_folder

    folder = cache_folder()
    entries = folder.iterdir() if folder is not None and folder.is_dir() else ()
    missing = Counter(line.partition(" ")[0].replace(":", ".") for line in _chosen(packages))
    missing -= Counter(entry.name.partition("-")[0] for entry in entries)
    if available_cores() < 2 or not missing:
        yield None
        return
    command = [sys.executable, "-m", "visuohaptic", "warmup", *packages, "--workers", "1", "--quiet"]
    nobody = subprocess.DEVNULL
    process = subprocess.Popen(command, stdin=nobody, stdout=nobody, stderr=nobody)
    try:
        if hasattr(os, "setpriority"):
            os.setpriority(os.PRIO_PROCESS, process.pid, 19)  # the lowest
        yield process
    finally:
        process.kill()  # entries of the cache are written whole or not at all
        process.wait(timeout=60)


def _remove_stale() -> int:
    for module in read_signatures():  # only listed kernels can be stale
        importlib.import_module(module)
    return core.remove_stale()


def _lines() -> list[str]:
    return SIGNATURES.read_text(encoding="utf-8").splitlines()


def _package(line: str) -> str:
    return line.partition(":")[0].rpartition(".")[0]


def _chosen(packages: Sequence[str]) -> list[str]:
    """The lines of some packages, of all without any."""
    lines = _lines()
    for package in packages:
        if not any(line.startswith(f"visuohaptic.{package}.") for line in lines):
            known = ", ".join(dict.fromkeys(line.split(".")[1] for line in lines))
            raise InputError("PACKAGE", f"found {package!r}, expected one of {known}, or a part of one")
    prefixes = [f"visuohaptic.{package}." for package in packages] or [""]
    return list(dict.fromkeys(line for prefix in prefixes for line in lines if line.startswith(prefix)))
