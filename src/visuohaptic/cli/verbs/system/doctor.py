"""``visuohaptic doctor``: try every library in a process of its own and say what to install."""

from __future__ import annotations

import argparse
import platform
import re
import subprocess
import sys
from dataclasses import dataclass
from typing import Any

from ....core.errors import VisuohapticError
from ..._console import Arguments
from ..._extras import CORE, OPTIONAL, Library

__all__ = ["EPILOG", "Finding", "add_arguments", "examine", "run"]

EPILOG = """\
reads   nothing
writes  nothing; ends with code 2 when a library of the core does not work

example: visuohaptic doctor
"""

#: Seconds after which a library counts as hanging.
PATIENCE_S = 60.0

#: Debian package of a shared library that a wheel may miss on a bare machine.
APT_PACKAGES = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libOSMesa.so.8": "libosmesa6",
    "libglib-2.0.so.0": "libglib2.0-0",
    "libgomp.so.1": "libgomp1",
    "libgthread-2.0.so.0": "libglib2.0-0",
    "libstdc++.so.6": "libstdc++6",
    "libturbojpeg.so.0": "libturbojpeg0",
    "libudev.so.1": "libudev1",
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libxcb.so.1": "libxcb1",
}

_SCRIPT = """
import importlib, importlib.metadata
{module} = importlib.import_module("{module}")
{trial}
print("version", importlib.metadata.version("{package}"))
"""


@dataclass(frozen=True, slots=True)
class Finding:
    """What happened to one library."""

    library: Library
    version: str  #: empty when it does not work
    problem: str  #: empty when it works
    remedy: str  #: command that mends it; empty when it works


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """It has no arguments of its own."""


def run(args: Arguments) -> dict[str, Any]:
    """Examine all libraries, core first."""
    args.report(f"Python {platform.python_version()} on {platform.platform()}")
    findings = []
    for library in (*CORE, *OPTIONAL):
        finding = examine(library)
        findings.append(finding)
        kind = f"extra {library.extra}" if library.extra else "core"
        state = finding.version or f"{finding.problem}; without it: no {library.purpose}"
        args.report(f"{library.package:<24}{kind:<18}{state}")
        if finding.remedy:
            args.report(f"{'':<24}{'':<18}{finding.remedy}")
    broken = [finding for finding in findings if finding.problem and not finding.library.extra]
    if broken:
        names = ", ".join(finding.library.package for finding in broken)
        raise VisuohapticError(f"doctor: the core does not work without {names}; run: {broken[0].remedy}")
    return {
        "python": platform.python_version(),
        "libraries": {
            finding.library.package: {
                "extra": finding.library.extra,
                "version": finding.version or None,
                "problem": finding.problem or None,
                "remedy": finding.remedy or None,
            }
            for finding in findings
        },
    }


def examine(library: Library, *, patience_s: float = PATIENCE_S) -> Finding:
    """Import a library in a process of its own: a crash or an exit there does not end us.

    Parameters
    ----------
    library
        Library to try.
    patience_s
        Time after which it counts as hanging [s].
    """
    script = _SCRIPT.format(module=library.module, package=library.package, trial=library.trial)
    command = [sys.executable, "-c", script]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=patience_s, check=False)
    except subprocess.TimeoutExpired:
        return _broken(library, f"did not answer within {patience_s:.0f} s")
    if done.returncode == 0 and (found := re.search(r"^version (\S+)$", done.stdout, re.MULTILINE)):
        return Finding(library, found[1], "", "")
    if done.returncode < 0:
        return _broken(library, f"crashed with signal {-done.returncode}")
    last = (done.stderr.strip().splitlines() or [f"ended with code {done.returncode}"])[-1]
    return _broken(library, last.removeprefix("ModuleNotFoundError: "), missing="ModuleNotFoundError" in last)


def _broken(library: Library, problem: str, *, missing: bool = False) -> Finding:
    shared = re.search(r"(lib[\w+.-]+\.so[.\d]*): cannot open shared object", problem)
    if shared and shared[1] in APT_PACKAGES:
        remedy = f"sudo apt-get install {APT_PACKAGES[shared[1]]}"
    elif shared:
        remedy = f"sudo apt-get install apt-file && apt-file update && apt-file search {shared[1]}"
    elif missing and library.extra:
        remedy = f"pip install 'visuohaptic[{library.extra}]'"
    elif missing:
        remedy = f"pip install {library.package}"
    else:
        remedy = f"pip install --force-reinstall {library.package}"
    return Finding(library, "", problem, remedy)
