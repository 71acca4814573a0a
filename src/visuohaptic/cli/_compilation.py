"""The list of compiled signatures, and compilation in another process while a command runs."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from ..core import InputError, available_cores

#: One line for each kernel that Python calls, ``module:function (types of the arguments)``; the kernels that
#: these call follow. Written by ``python -m benchmarks.kernel_signatures``.
SIGNATURES = Path(__file__).parents[1] / "core" / "kernel_signatures.txt"


def signature_lines() -> list[str]:
    """All lines of the list of signatures."""
    return SIGNATURES.read_text(encoding="utf-8").splitlines()


def read_signatures() -> dict[str, list[tuple[str, str]]]:
    """(function, types of its arguments) of each signature, by module."""
    found: dict[str, list[tuple[str, str]]] = {}
    for line in signature_lines():
        name, _, arguments = line.partition(" ")
        module, _, function = name.partition(":")
        found.setdefault(module, []).append((function, arguments))
    return found


def chosen_lines(packages: Sequence[str]) -> list[str]:
    """The lines of some packages or modules, in their order; all lines without any.

    Parameters
    ----------
    packages
        Names without ``visuohaptic.``.

    Raises
    ------
    InputError
        If one of them has no kernels.
    """
    lines = signature_lines()
    for package in packages:
        if not any(line.startswith(_prefixes(package)) for line in lines):
            known = ", ".join(dict.fromkeys(line.split(".")[1] for line in lines))
            raise InputError("PACKAGE", f"found {package!r}, expected one of {known}, or a part of one")
    prefixes = [_prefixes(package) for package in packages] or [("",)]
    return list(dict.fromkeys(line for some in prefixes for line in lines if line.startswith(some)))


def _prefixes(package: str) -> tuple[str, ...]:
    """Of the lines of a package or a module."""
    return f"visuohaptic.{package}.", f"visuohaptic.{package}:"


@contextmanager
def compiling_in_background(packages: Sequence[str] = ()) -> Iterator[subprocess.Popen[bytes] | None]:
    """Compile kernels while the block runs, in another process of the lowest priority that is terminated after it.

    No process is started (None) on a single core, where nothing can be cached, or if the cache has as many entries of
    each kernel as the list.

    Parameters
    ----------
    packages
        As for the verb, and modules, in the order in which they are compiled; all by default.
    """
    from ..core.kernels.cache import cached_names, may_be_cached

    missing = Counter(line.partition(" ")[0].replace(":", ".") for line in chosen_lines(packages))
    missing -= Counter(name.partition("-")[0] for name in cached_names())
    if available_cores() < 2 or not missing or not may_be_cached():
        yield None
        return
    command = [sys.executable, "-m", "visuohaptic", "warmup", *packages, "--workers", "1", "--quiet"]
    nobody = subprocess.DEVNULL
    try:
        process = subprocess.Popen(command, stdin=nobody, stdout=nobody, stderr=nobody)
    except OSError:  # no more processes are permitted: the command compiles by itself
        yield None
        return
    try:
        if hasattr(os, "setpriority"):
            with suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, process.pid, 19)  # the lowest
        yield process
    finally:
        process.kill()  # entries of the cache are written whole or not at all
        process.wait(timeout=60)
