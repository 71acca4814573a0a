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
import time
from collections.abc import Sequence
from typing import Any

from .... import core
from ....core.map_tasks import available_cores, cluster_hosts, map_tasks
from ..._compilation import SIGNATURES, chosen_lines, read_signatures
from ..._console import Arguments, Progress
from ..._workers import add_worker_arguments, chosen_workers

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


def run(args: Arguments) -> dict[str, Any]:
    """Compile or load each signature, and time each package."""
    workers = chosen_workers(args, min(available_cores(), MAX_USEFUL_WORKERS))
    parts = _by_package(chosen_lines(args.packages), shared=workers != 1)
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


def _remove_stale() -> int:
    for module in read_signatures():  # only listed kernels can be stale
        importlib.import_module(module)
    return core.remove_stale()


def _package(line: str) -> str:
    return line.partition(":")[0].rpartition(".")[0]
