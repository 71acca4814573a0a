"""``visuohaptic warmup``: compile every kernel once and say how long it took."""

from __future__ import annotations

import argparse
import importlib
import logging
import time
from typing import Any

from ._console import Arguments

__all__ = ["EPILOG", "HELP", "WARMUPS", "add_arguments", "run"]

HELP = "Compile the kernels once, so that later starts are fast."
EPILOG = """\
reads   nothing
writes  numba's cache beside the installed package (or in NUMBA_CACHE_DIR)

example: visuohaptic warmup
"""

#: "module:function" of each package that has kernels; the function compiles all of them.
WARMUPS = (
    "visuohaptic.objects._warmup:warmup",
    "visuohaptic.tracking._warmup:warmup",
    "visuohaptic.sensing._warmup:warmup",
    "visuohaptic.sensing.foam._warmup:warmup",
    "visuohaptic.sensing.beam._warmup:warmup",
    "visuohaptic.navigation._warmup:warmup",
    "visuohaptic.reconstruction._warmup:warmup",
    "visuohaptic.deformation._warmup:warmup",
    "visuohaptic.simulation._warmup:warmup",
)

_log = logging.getLogger(__name__)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """It has no arguments of its own."""


def run(args: Arguments) -> dict[str, Any]:
    """Call each package's warm-up and time it."""
    seconds: dict[str, float] = {}
    for entry in WARMUPS:
        module_name, _, function = entry.partition(":")
        package = module_name.rpartition(".")[0]
        started_s = time.perf_counter()
        try:
            module = importlib.import_module(module_name)
        except ModuleNotFoundError as error:
            # Absent because this version has no such kernels; anything else is a real fault.
            if error.name is None or not module_name.startswith(error.name):
                raise
            _log.debug("%s has nothing to compile", package)
            continue
        getattr(module, function)()
        seconds[package] = time.perf_counter() - started_s
        args.report(f"{package:<32}{seconds[package]:7.2f} s")
    total_s = sum(seconds.values())
    args.report(f"{'compiled or read from the cache':<32}{total_s:7.2f} s")
    return {"seconds": seconds, "total_s": total_s}
