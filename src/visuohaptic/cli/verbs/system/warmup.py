"""``visuohaptic warmup``: compile every kernel once and say how long it took."""

from __future__ import annotations

import argparse
import importlib
import time
from pathlib import Path
from typing import Any

from ..._console import Arguments

__all__ = ["EPILOG", "SIGNATURES", "add_arguments", "read_signatures", "run"]

EPILOG = """\
reads   nothing
writes  machine code into the user's cache folder (or VISUOHAPTIC_CACHE_DIR), and removes what other
        sources of this library left there

example: visuohaptic warmup
"""

#: One line for each kernel that Python calls, ``module:function (types of the arguments)``; the kernels that
#: these call follow. Written by ``python -m benchmarks.kernel_signatures``.
SIGNATURES = Path(__file__).parents[3] / "core" / "kernel_signatures.txt"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """It has no arguments of its own."""


def read_signatures() -> dict[str, list[tuple[str, str]]]:
    """(function, types of its arguments) of each signature, by module."""
    found: dict[str, list[tuple[str, str]]] = {}
    for line in SIGNATURES.read_text(encoding="utf-8").splitlines():
        name, _, arguments = line.partition(" ")
        module, _, function = name.partition(":")
        found.setdefault(module, []).append((function, arguments))
    return found


def run(args: Arguments) -> dict[str, Any]:
    """Compile or load each signature, and time each package."""
    from ....core.kernels import remove_stale

    seconds: dict[str, float] = {}
    for module, signatures in read_signatures().items():
        started_s = time.perf_counter()
        kernels = importlib.import_module(module)
        for function, arguments in signatures:
            compiled = getattr(kernels, function)
            if hasattr(compiled, "compile"):  # it has not with NUMBA_DISABLE_JIT
                compiled.compile(arguments)
        package = module.rpartition(".")[0]
        if package not in seconds:
            args.report(f"{package} ...")
        seconds[package] = seconds.get(package, 0.0) + time.perf_counter() - started_s
    for package, package_s in seconds.items():
        args.report(f"{package:<32}{package_s:7.2f} s")
    total_s = sum(seconds.values())
    args.report(f"{'compiled or read from the cache':<32}{total_s:7.2f} s")
    return {"seconds": seconds, "total_s": total_s, "removed": remove_stale()}
