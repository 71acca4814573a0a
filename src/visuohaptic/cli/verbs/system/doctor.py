"""``visuohaptic doctor``: test every library in a separate process, or a robot against its protocols.

reads   nothing; with --robot, a Python module, searched for in the current folder too
writes  nothing; the exit code is 2 when a core library fails or the robot violates a protocol

The function that --robot names returns the parts of the robot: base, arm, gripper, camera, localizer, depth,
feel (a mapping, or RobotParts of visuohaptic.tasks.framework). The base drives 10 cm and turns, the arm lifts its tip by 2 cm,
the fingers close by 1 cm: clear the space around the robot and keep a hand on the emergency stop.

examples
  visuohaptic doctor
  visuohaptic doctor --robot my_robot:connect
  visuohaptic doctor --robot my_robot:connect --still
  visuohaptic doctor --robot visuohaptic.simulation.served:kitchen --apart
"""

from __future__ import annotations

import contextlib
import importlib
import os
import platform
import re
import subprocess
import sys
import traceback
from dataclasses import dataclass
from typing import Any

from ....core.errors import InputError, VisuohapticError
from ....io import remote
from ....tasks import framework
from ..._console import Arguments
from ..._extras import CORE, OPTIONAL, Library

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
    """Result of the test of one library."""

    library: Library
    version: str  #: empty when it does not work
    problem: str  #: empty when it works
    remedy: str  #: command that repairs it; empty when it works


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("--robot", str, "test this robot instead of the libraries", metavar="MODULE:FUNCTION")
    add("--still", bool, "do not move the robot; test signatures and readings only")
    add("--apart", bool, "create the robot in a separate process, and access it by its protocols")


def run(args: Arguments) -> dict[str, Any]:
    """Examine all libraries, core first; or a robot."""
    if args.robot is not None:
        return _robot(args)
    args.report(f"Python {platform.python_version()} on {platform.platform()}")
    findings = []
    libraries = (*CORE, *OPTIONAL)
    width = 1 + max(len(library.package) for library in libraries)
    for library in libraries:
        finding = examine(library)
        findings.append(finding)
        kind = f"extra {library.extra}" if library.extra else "core"
        state = finding.version or f"{finding.problem}; without it: no {library.purpose}"
        args.report(f"{library.package:<{width}}{kind:<18}{state}")
        if finding.remedy:
            args.report(f"{'':<{width + 18}}{finding.remedy}")
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


def _robot(args: Arguments) -> dict[str, Any]:
    """Test a robot, and report which rules of its protocols it satisfies."""
    with contextlib.ExitStack() as stack:
        robot = (
            stack.enter_context(remote.start_robot(args.robot)).served() if args.apart else _made(args.robot)
        )
        rules = framework.check_robot(robot, motion=not args.still, where=args.robot)
    for rule in rules:
        args.report(f"{rule.part:<9}{'BROKEN' if rule.problem else 'kept':<8}{rule.rule}")
        if rule.problem:
            args.report(f"{'':<17}{rule.problem}")
    broken = [rule for rule in rules if rule.problem]
    if broken:
        first = f"{broken[0].part}: {broken[0].rule}: {broken[0].problem}"
        raise VisuohapticError(f"{args.robot} breaks {len(broken)} of {len(rules)} rules; the first: {first}")
    return {"robot": args.robot, "rules": [{"part": rule.part, "rule": rule.rule} for rule in rules]}


def _made(name: str) -> Any:
    """What the function of a module returns."""
    module, _, function = name.partition(":")
    if not (module and function):
        raise InputError("--robot", f"found {name!r}, expected MODULE:FUNCTION such as my_robot:connect")
    folder = os.getcwd()  # a module may change it
    sys.path.insert(0, folder)
    try:
        make = getattr(importlib.import_module(module), function)
    except (Exception, SystemExit) as problem:
        why = problem if isinstance(problem, ImportError) else repr(problem)
        raise InputError("--robot", f"{name!r} cannot be imported: {why}") from problem
    finally:
        if folder in sys.path:
            sys.path.remove(folder)
    try:
        return make()
    except VisuohapticError:
        raise
    except (Exception, SystemExit) as problem:
        # Code of the user: the last place in it says more than the kind of the error.
        frames = traceback.extract_tb(problem.__traceback__)
        own = getattr(sys.modules[module], "__file__", None)
        place = ([one for one in frames if one.filename == own] or frames)[-1]
        found = f"{name} failed: {type(problem).__name__}: {problem}"
        raise InputError("--robot", f"{found} ({place.filename}, line {place.lineno})") from problem


def examine(library: Library, *, patience_s: float = PATIENCE_S) -> Finding:
    """Import a library in a separate process, so that a crash or exit there does not end this one.

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
