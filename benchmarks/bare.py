"""Installations on a minimal machine: a wheel is installed and run with few writable folders and few variables set.

    python -m benchmarks.bare --pythons python3.11 python3.12 python3.13 --report bare.jsonl
                                      prints for each Python and case which command failed, and why

For each Python, a virtual environment is created and a wheel of this checkout is installed into it with the dependencies of the
two commands; then ``visuohaptic demo --quick``, and the foam example of the README (``example``, ``calibrate``, ``sense``),
run in an empty folder:

- *plain*;
- *no home*: only ``PATH`` is set, not even ``HOME``; C locale;
- *read-only*: a user without an entry in the password file and without a home, who can write only to the current
  folder (needs root to become that user);
- *read-only C*: the same in the C locale without UTF-8 mode, with temporary files in that folder only.

The cases of another user are skipped, with the reason, if that user may not enter the folder of the interpreter.

A command passes if it exits with 0, prints no traceback, and its files exist. Other operating systems, and
processors without the features that numba needs, are not covered.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ._journal import Journal
from .house import ROOT

#: A user id without an entry in the password and group files, and without a home.
STRANGER = 54321
#: Time limit of one command, including compilation, and of each step of the installation [s].
LIMIT_S = 900
#: Time limit of starting the interpreter without any command [s].
PROBE_S = 60
COMMANDS: dict[str, list[tuple[str, str]]] = {
    "demo --quick": [("demo --quick --out quick", "quick/report.html")],
    "foam": [
        ("example foam --out try", "try/push.mp4"),
        (
            "calibrate foam try/strain_stress.csv --width 0.02 --height 0.01 --out try/foam.yaml",
            "try/foam.yaml",
        ),
        ("sense foam --config try/sensor.yaml --source try/push.mp4 --zero-frames 3 --csv f.csv", "f.csv"),
    ],
}
CASES = ("plain", "no home", "read-only", "read-only C")


def install(python: str, folder: Path) -> Path:
    """Wheel and environment; the command."""
    for words in (
        [python, "-m", "venv", str(folder / "venv")],
        [str(folder / "venv/bin/pip"), "wheel", "-q", "--no-deps", "--wheel-dir", str(folder), str(ROOT)],
    ):
        subprocess.run(words, check=True, capture_output=True, timeout=LIMIT_S)
    (wheel,) = folder.glob("visuohaptic-*.whl")
    subprocess.run(
        [str(folder / "venv/bin/pip"), "install", "-q", f"{wheel}[recording,plot]"],
        check=True,
        capture_output=True,
        timeout=LIMIT_S,
    )
    return folder / "venv/bin/visuohaptic"


def environment(case: str, here: Path, command: Path) -> dict[str, str]:
    """All variables of a run."""
    found = {"PATH": f"{command.parent}:/usr/bin:/bin"}
    if case == "plain":
        found |= {"HOME": str(here), "LANG": "C.UTF-8"}
    elif case == "no home":
        found |= {"LC_ALL": "C"}
    elif case == "read-only C":
        found |= {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "TMPDIR": str(here)}
    return found


def trial(command: Path, case: str, steps: list[tuple[str, str]], folder: Path) -> dict[str, Any]:
    """Run the steps of a command in an empty folder."""
    here = Path(tempfile.mkdtemp(dir=folder))
    user = None
    if case.startswith("read-only"):
        if os.geteuid() != 0:
            return {"tried": 0, "why": "only root can become a user without a home"}
        user = STRANGER
        for place in (folder, folder.parent):
            place.chmod(0o755)  # readable by that user, but owned by root
        os.chown(here, STRANGER, STRANGER)
        python = command.with_name("python")
        try:
            subprocess.run(
                [python, "-c", ""],
                cwd=here,
                user=user,
                group=user,
                extra_groups=[],
                check=True,
                timeout=PROBE_S,
            )
        except PermissionError:
            return {"tried": 0, "why": f"another user may not start {python.resolve()}"}
        except (subprocess.TimeoutExpired, subprocess.CalledProcessError) as problem:
            return {"tried": 0, "why": f"{python.resolve()} does not start for another user: {problem}"}
    for words, file in steps:
        try:
            done = subprocess.run(
                [str(command), *words.split()],
                cwd=here,
                env=environment(case, here, command),
                user=user,
                group=user,
                extra_groups=None if user is None else [],
                umask=0o022,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=LIMIT_S,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return {"tried": 1, "hung": 1, "wrong": 0, "why": f"{words}: longer than {LIMIT_S} s"}
        text = done.stdout + done.stderr
        if done.returncode or "Traceback" in text or not (here / file).exists():
            return {
                "tried": 1,
                "hung": 0,
                "wrong": 1,
                "why": f"{words}: exit {done.returncode}: {text[-400:]}",
            }
    return {"tried": 1, "hung": 0, "wrong": 0, "why": ""}


def cases(
    pythons: list[str], names: list[str], places: list[str]
) -> Iterator[tuple[str, str, str, list[tuple[str, str]]]]:
    """Title, Python, case and steps of every trial."""
    for python in pythons:
        for case in places:
            for name in names:
                yield f"{Path(python).name} {case}: {name}", python, case, COMMANDS[name]


def main() -> None:
    """Run, or continue, and print what failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--pythons", nargs="+", default=[sys.executable])
    parser.add_argument("--commands", nargs="+", choices=COMMANDS, default=list(COMMANDS))
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--report", type=Path)
    args = parser.parse_args()
    journal = Journal(args.report, {"campaign": "bare"})
    commands: dict[str, Path] = {}
    with tempfile.TemporaryDirectory() as root:
        for title, python, case, steps in cases(args.pythons, args.commands, args.cases):
            if title in journal:
                continue
            if shutil.which(python) is None:
                journal.put(title, {"tried": 0, "why": f"{python} is not on this machine"})
                continue
            if python not in commands:
                folder = Path(root, f"{len(commands)}", "x")
                folder.mkdir(parents=True)
                Path(root).chmod(0o755)
                commands[python] = install(python, folder)
            journal.put(title, trial(commands[python], case, steps, commands[python].parents[2]))
            print(title, journal.rows[title], flush=True)
    rows = journal.rows.values()
    print(f"{sum(row['tried'] for row in rows)} tried, {sum(bool(row['why']) for row in rows)} did not work")


if __name__ == "__main__":
    main()
