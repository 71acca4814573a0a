"""``visuohaptic warmup``: compile every kernel once, in several processes, and say how long it took."""

from __future__ import annotations

import argparse
import contextlib
import gc
import importlib
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Generator, Iterable, Sequence
from pathlib import Path
from typing import Any

from ....core.errors import InputError, VisuohapticError
from ..._console import Arguments, Progress

__all__ = [
    "EPILOG",
    "SIGNATURES",
    "add_arguments",
    "compile_lines",
    "read_signatures",
    "run",
    "share_out",
    "work",
]

EPILOG = """\
reads   nothing
writes  machine code into the user's cache folder (or VISUOHAPTIC_CACHE_DIR), and removes what other
        sources of this library left there

examples
  visuohaptic warmup
  visuohaptic warmup sensing tracking --jobs 1
"""

#: One line for each kernel that Python calls, ``module:function (types of the arguments)``; the kernels that
#: these call follow. Written by ``python -m benchmarks.kernel_signatures``.
SIGNATURES = Path(__file__).parents[3] / "core" / "kernel_signatures.txt"

#: More processes gain nothing: ``navigation.graph`` alone is a quarter of the work.
MAX_JOBS = 4

_WORKER = "from visuohaptic.cli.verbs.system.warmup import work; work()"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument(
        "packages", nargs="*", metavar="PACKAGE", help="only these, as navigation or sensing.foam"
    )
    parser.add_argument("--jobs", type=int, metavar="N", help=f"processes (one per core, at most {MAX_JOBS})")


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
    lines = _chosen(args.packages)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if args.jobs is not None and args.jobs < 1:
        raise InputError("--jobs", f"found {args.jobs}, expected 1 or more")
    parts = share_out(lines, min(cores, MAX_JOBS) if args.jobs is None else args.jobs)
    seconds = dict.fromkeys(sorted(map(_package, lines)), 0.0)
    compiled = _in_processes(parts) if len(parts) > 1 else compile_lines(lines)
    bar: Progress[Any]
    with args.progress(len(lines), "compiling") as bar, contextlib.closing(compiled):
        for package, taken_s in compiled:
            seconds[package] += taken_s
            bar.advance(text=package.removeprefix("visuohaptic."))
    for package, package_s in seconds.items():
        args.report(f"{package:<40}{package_s:7.2f} s")
    total_s = sum(seconds.values())
    args.report(f"{'compiled or read from the cache, CPU':<40}{total_s:7.2f} s")
    return {"seconds": seconds, "total_s": total_s, "jobs": len(parts), "removed": _remove_stale()}


def share_out(lines: Sequence[str], jobs: int) -> list[list[str]]:
    """Lines of the list for each process: whole packages, so that few kernels are compiled twice.

    The largest package goes first, to the process that has the least to do; the size of the source files
    stands for the time.

    Parameters
    ----------
    lines
        Of the list of signatures.
    jobs
        Maximum number of processes.
    """
    size: dict[str, int] = {}
    for module in dict.fromkeys(line.partition(":")[0] for line in lines):
        path = SIGNATURES.parents[2].joinpath(*module.split(".")).with_suffix(".py")
        package = module.rpartition(".")[0]
        size[package] = size.get(package, 0) + (path.stat().st_size if path.exists() else 1)
    parts: list[list[str]] = [[] for _ in range(min(jobs, len(size)))]
    for package in sorted(size, key=lambda name: (-size[name], name)):
        least = min(parts, key=lambda part: sum(size[name] for name in part))
        least.append(package)
    return [[line for line in lines if _package(line) in part] for part in parts]


def compile_lines(lines: Iterable[str]) -> Generator[tuple[str, float]]:
    """Compile or load signatures; yields the package and the CPU time [s] of each.

    The garbage collector rests meanwhile: it would walk through millions of objects of the compiler.

    Parameters
    ----------
    lines
        Of the list of signatures.
    """
    collecting = gc.isenabled()
    gc.disable()
    try:
        for line in lines:
            started_s = time.process_time()
            name, _, arguments = line.partition(" ")
            module, _, function = name.partition(":")
            kernel = getattr(importlib.import_module(module), function)
            if hasattr(kernel, "compile"):  # it has not with NUMBA_DISABLE_JIT
                kernel.compile(arguments)
            yield _package(line), time.process_time() - started_s
    finally:
        if collecting:
            gc.enable()


def work() -> None:
    """Compile the lines that come in, and say so for each: what a process of :func:`run` does."""
    try:
        for package, taken_s in compile_lines(sys.stdin.read().splitlines()):
            print(package, taken_s, flush=True)
    except Exception as error:  # noqa: BLE001 - it is raised again in the process that waits
        print("failed", f"{type(error).__name__}: {error}", flush=True)


def _in_processes(parts: Sequence[Sequence[str]]) -> Generator[tuple[str, float]]:
    said: queue.SimpleQueue[str | None] = queue.SimpleQueue()
    workers = [
        subprocess.Popen([sys.executable, "-c", _WORKER], stdin=-1, stdout=-1, text=True) for _ in parts
    ]
    try:
        for worker, part in zip(workers, parts, strict=True):
            threading.Thread(target=_listen, args=(worker, part, said), daemon=True).start()
        left = len(workers)
        while left:
            line = said.get()
            if line is None:
                left -= 1
                continue
            package, _, text = line.rstrip().partition(" ")
            if package == "failed":
                raise VisuohapticError(f"warmup: {text}; run it again with --jobs 1 --verbose to see where")
            yield package, float(text)
        codes = [worker.wait() for worker in workers]
        if any(codes):
            raise VisuohapticError(
                f"warmup: a process ended with code {next(filter(None, codes))}; run it again with fewer --jobs"
            )
    finally:
        for worker in workers:
            worker.kill()
            worker.wait()


def _listen(worker: subprocess.Popen[str], part: Sequence[str], said: queue.SimpleQueue[str | None]) -> None:
    """Hand a process its lines, and pass on what it says; None when it has ended."""
    assert worker.stdin is not None
    assert worker.stdout is not None
    with contextlib.suppress(OSError):  # it has ended: its code tells
        worker.stdin.write("\n".join(part))
        worker.stdin.close()
    for line in worker.stdout:
        said.put(line)
    said.put(None)


def _remove_stale() -> int:
    from ....core.kernels import remove_stale

    for module in read_signatures():  # only kernels that are known can be stale
        importlib.import_module(module)
    return remove_stale()


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
    prefixes = tuple(f"visuohaptic.{package}." for package in packages) or ("",)
    return [line for line in lines if line.startswith(prefixes)]
