"""The first hour with the library on a new machine: times, sizes, what new users expect to find, and what they do wrong.

    python -m benchmarks.first_hour                  the next three
    python -m benchmarks.first_hour misuses          typical mistakes, made with the command line: what it answers (1 min)
    python -m benchmarks.first_hour extras           every verb where only the core is installed: what is missing is named first (2 min)
    python -m benchmarks.first_hour expectations     20 expectations of new users: the tests of each are run (5 min)
    python -m benchmarks.first_hour clone            fresh clone, empty kernel cache: ``make demo``, installation timed apart
    python -m benchmarks.first_hour wheels           the wheels of ``make wheel`` in a new environment: first force of the quick start
    python -m benchmarks.first_hour size             installed sizes of the core and of the extras, from this environment

``expectations`` asks pip for the package, and reads real recordings where ``VISUOHAPTIC_DATA`` is set. ``clone`` and ``wheels`` create their environments in a temporary folder and need the package index. ``python -m benchmarks.cold_start``
measures the compilation of the kernels.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.metadata
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

from .house import ROOT

#: The quick start of the documentation; the next lines then print the forces of a recorded push.
QUICK_START = (
    "example foam --out try -q",
    "calibrate foam try/strain_stress.csv --width 0.02 --height 0.01 --out try/foam.yaml -q",
)
FIRST_FORCE = """
import visuohaptic as vh
sensor = vh.FoamSensor.load("try/sensor.yaml")
sensor.zero(vh.open_source("try/rest.mp4"))
print(sensor.read(next(iter(vh.open_source("try/push.mp4")))).force_N)
"""

#: Limit of a command that is run for an expectation or without extras [s]; the slowest takes two minutes.
LIMIT_S = 1200.0

#: A user's program: without the library's types the mistake in it is not found, and the ignored error is reported as unused.
TYPED = """
import visuohaptic as vh
sensor = vh.FoamSensor.load("sensor.yaml")
wrong: str = sensor.read(next(iter(vh.open_source("push.mp4")))).force_N  # type: ignore[assignment]
"""

#: Expectation of a new user -> tests (pytest) or command lines of Python that show it; all of them are run.
EXPECTATIONS: dict[str, tuple[str | list[str], ...]] = {
    "force in newtons with a standard deviation": ("tests/cli/test_start.py::test_from_a_recording_and_a_kitchen_scale_to_newtons",),
    "a live page in the browser": ("tests/viewer/test_page.py",),
    "complete types": (["-m", "mypy", "--strict", "-c", TYPED],),
    "reproducible seeds": ("tests/benchmarks/test_determinism.py", "tests/deformation/test_build.py::test_another_seed_or_setting_is_another_result"),
    "benchmarks against named peers": ("tests/benchmarks/test_harness.py",),
    "installation with pip": (
        ["-m", "pip", "wheel", "-q", "--no-deps", "--wheel-dir", "{folder}", str(ROOT)],
        ["-m", "pip", "download", "-q", "--no-deps", "--dest", "{folder}", "visuohaptic"],
    ),
    "sensible defaults": ("tests/cli/test_defaults.py",),
    "progress with the remaining time, without a terminal too": ("tests/cli/test_console.py",),
    "plots of results": (
        "tests/cli/test_help_examples.py::test_the_examples_run_and_their_numbers_hold[sense foam]",
        "tests/cli/test_help_examples.py::test_the_examples_run_and_their_numbers_hold[plan]",
        "tests/cli/test_help_examples.py::test_the_examples_run_and_their_numbers_hold[squeeze]",
    ),
    "documentation that is complete and tested": ("tests/docs/test_site.py", "tests/test_front_door.py", "tests/docs/test_blocks.py"),
    "effective configuration as a file": ("tests/cli/test_defaults.py::test_every_setting_is_there_with_its_default",),
    "replay of recordings, SQLite bags included": ("tests/io/test_sqlite_bag.py",),
    "ROS 2": ("tests/ros/test_node.py", "tests/ros/test_first_wrench.py"),
    "USB cameras with fixed focus and exposure": ("tests/io/test_live.py",),
    "RealSense and Orbbec cameras": ("tests/io/test_depth_live.py", "tests/cli/test_recording_capture.py"),
    "a citation": ("tests/docs/test_site.py::test_the_citation_has_the_version",),
    "errors that name the cause and the remedy": ("tests/cli/test_misuse.py", "tests/cli/test_bad_files.py"),
    "public data sets": ("tests/docs/test_data_sets.py",),
    "a demo within a minute": ("tests/demo/test_recorded.py::test_the_verb_replays_it_and_takes_no_part",),
    "notebooks": ("tests/docs/test_notebooks.py",),
}  # fmt: skip


def timed(words: Sequence[str | Path], folder: Path, environment: dict[str, str]) -> tuple[float, float]:
    """Run a command; wall time and CPU time of it and of the processes it starts [s]."""
    before, started_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    subprocess.run(words, cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL)
    wall_s, after = time.monotonic() - started_s, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall_s, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def clean_environment(folder: Path) -> dict[str, str]:
    """Variables of a user without a kernel cache and without settings of Python."""
    kept = {
        name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "NUMBA", "VISUO"))
    }
    return {**kept, "HOME": str(folder), "XDG_CACHE_HOME": str(folder / "cache")}


def clone_rows(folder: Path) -> Iterator[tuple[str, float, float]]:
    """(what, wall time, CPU time [s]) of ``make demo`` in a fresh clone."""
    environment = clean_environment(folder)
    subprocess.run(["git", "clone", "-q", str(ROOT), str(folder / "clone")], check=True)
    yield (
        "make .venv/.installed-demo",
        *timed(["make", ".venv/.installed-demo"], folder / "clone", environment),
    )
    yield "make demo", *timed(["make", "demo"], folder / "clone", environment)


def wheel_rows(folder: Path, dist: Path) -> Iterator[tuple[str, float, float]]:
    """(what, wall time, CPU time [s]) of the quick start with the wheels of a release."""
    environment, python = clean_environment(folder), folder / "venv/bin/python"
    subprocess.run([sys.executable, "-m", "venv", str(folder / "venv")], check=True)
    wheels = [str(path.resolve()) for path in sorted(dist.glob("visuohaptic*.whl"))]
    needed = [f"{path}[recording]" if "kernels" not in path else path for path in wheels]
    yield "pip install", *timed([python, "-m", "pip", "install", "-q", *needed], folder, environment)
    for text in QUICK_START:
        yield (
            text.partition(" -")[0],
            *timed([python, "-m", "visuohaptic", *text.split()], folder, environment),
        )
    yield "first force from Python", *timed([python, "-c", FIRST_FORCE], folder, environment)
    compiled = [path for path in (folder / "cache").rglob("*") if path.is_file()]
    print(f"{len(compiled)} kernels were compiled instead of found")


def distributions(requirement: str) -> set[str]:
    """Names of the installed distributions that a requirement brings with it."""
    found: set[tuple[str, str]] = set()
    todo = [Requirement(requirement)]
    while todo:
        one = todo.pop()
        for extra in ("", *one.extras):
            key = (re.sub(r"[-_.]+", "-", one.name).lower(), extra)
            if key in found:
                continue
            found.add(key)
            needs = map(Requirement, importlib.metadata.requires(one.name) or ())
            todo += [need for need in needs if need.marker is None or need.marker.evaluate({"extra": extra})]
    return {name for name, _ in found}


def megabytes(name: str) -> float:
    """Size of the installed files of a distribution, with byte code [MB]."""
    paths = {str(path.locate()) for path in importlib.metadata.files(name) or ()}
    return sum(os.path.getsize(path) for path in paths if os.path.exists(path)) / 1e6


def print_sizes() -> None:
    """Core, and the extras of the two commands of the README."""
    for requirement in ("visuohaptic", "visuohaptic[demo]", "visuohaptic[all]"):
        sizes = {name: megabytes(name) for name in distributions(requirement)}
        largest = sorted(sizes.items(), key=lambda item: -item[1])[:6]
        parts = ", ".join(f"{name} {size:.0f}" for name, size in largest)
        print(f"{requirement:<20}{sum(sizes.values()):7.0f} MB   {parts}")


class _Outcomes:
    """Outcome of each test by its identifier: a plugin of pytest."""

    def __init__(self) -> None:
        self.of: dict[str, str] = {}
        self.seconds: Counter[str] = Counter()

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Keep the worst outcome of set-up, call and end."""
        self.seconds[report.nodeid] += report.duration
        if report.when == "call" or report.outcome != "passed":
            self.of[report.nodeid] = report.outcome

    def pytest_collectreport(self, report: Any) -> None:
        """A file that is skipped or broken as a whole."""
        if report.outcome != "passed":
            self.of[report.nodeid] = report.outcome


def expectation_rows(folder: Path) -> Iterator[tuple[str, Counter[str], float, str]]:
    """(expectation, outcomes, seconds, what failed or was skipped): tests and commands are run."""
    import pytest

    tests = dict.fromkeys(
        proof for proofs in EXPECTATIONS.values() for proof in proofs if isinstance(proof, str)
    )
    outcomes = _Outcomes()
    with (folder / "pytest.log").open("w") as log, contextlib.redirect_stdout(log), contextlib.chdir(ROOT):
        pytest.main(
            ["-q", "-n", "0", "-p", "no:cacheprovider", f"--basetemp={folder / 'tests'}", *tests], [outcomes]
        )
    for what, proofs in EXPECTATIONS.items():
        found: dict[str, str] = {}
        seconds = 0.0
        for proof in proofs:
            if isinstance(proof, str):
                own = {
                    name: one
                    for name, one in outcomes.of.items()
                    if re.match(re.escape(proof) + r"($|[:\[])", name)
                }
                found |= own or {proof: "failed"}
                seconds += sum(outcomes.seconds[name] for name in own)
            else:
                words = [
                    sys.executable,
                    *(word.format(folder=folder) if "{" in word else word for word in proof),
                ]
                started_s = time.monotonic()
                code = subprocess.run(
                    words, cwd=folder, capture_output=True, check=False, timeout=LIMIT_S
                ).returncode
                seconds += time.monotonic() - started_s
                found[" ".join(proof[:3])] = "failed" if code else "passed"
        left = [f"{one}: {name}" for name, one in found.items() if one != "passed"]
        yield what, Counter(found.values()), seconds, "; ".join(left)


def print_expectations(folder: Path) -> int:
    """Answer each expectation by what its tests did; number of those that are not met."""
    met = Counter[str]()
    for what, count, seconds, left in expectation_rows(folder):
        passed, failed = count["passed"], count["failed"]
        answer = "no" if not passed else "partly" if failed else "yes"
        met[answer] += 1
        print(
            f"{what:<58}{answer:<8}{passed:4d} passed {failed} failed {count['skipped']} skipped {seconds:6.1f} s  {left}"
        )
    print(f"{met['yes']} of {met.total()} expectations are met, {met['partly']} partly, {met['no']} not")
    return met.total() - met["yes"]


def print_misuses(folder: Path) -> int:
    """Make each misuse with the command line and print the answer; number of those that are not answered."""
    from tests.cli.misuses import MISUSES, add_files, respond

    from visuohaptic.rigs import write_example

    add_files(write_example(folder / "files"))
    count = Counter[str]()
    for number, (name, misuse) in enumerate(MISUSES.items()):
        response = respond(misuse, folder / "files", folder / str(number))
        answer = "silent" if response.faults else "refused" if response.code else "told"
        count[answer] += 1
        lines = [line for line in response.said.splitlines() if any(words in line for words in misuse.says)]
        print(f"{name:<34}{answer:<9}{'; '.join(response.faults) or ' | '.join(lines)}", flush=True)
    print(
        f"{count.total() - count['silent']} of {count.total()} misuses are refused ({count['refused']}) or told ({count['told']})"
    )
    return count["silent"]


def print_extras(folder: Path) -> int:
    """Run every verb's examples where only the core is installed; number of verbs that start without what they need."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    words = [sys.executable, str(ROOT / "tests" / "cli" / "bare_core.py")]
    done = subprocess.run(
        words, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True, check=True, timeout=LIMIT_S
    )
    runs: dict[str, list[dict[str, Any]]] = {}
    for run in json.loads(done.stdout):
        runs.setdefault(run["verb"], []).append(run)
    count, written = Counter[str](), list[str]()
    for verb, examples in runs.items():
        answers, said = set(), ""
        for run in examples:
            one_line = len(run["error"].splitlines()) == 1 and "pip install 'visuohaptic[" in run["error"]
            named = run["code"] == 2 and one_line and run["written"] == written
            failed = (
                run["code"] == 1
                or "ModuleNotFoundError" in run["error"]
                or bool(run["declared"] and not named)
            )
            answers.add("late" if failed else "named" if run["declared"] else "core")
            said = run["error"].strip() if run["declared"] or failed else said
            written = run["written"]
        answer = next(one for one in ("late", "named", "core") if one in answers)
        count[answer] += 1
        print(f"{verb:<20}{answer:<7}{said}")
    print(
        f"{count['named']} of {count['named'] + count['late']} verbs that need an extra name it before they compute or write; "
        f"{count['core']} need the core only; all {count.total()} verbs were run"
    )
    return count["late"]


#: What is run without arguments.
CHECKS = {"misuses": print_misuses, "extras": print_extras, "expectations": print_expectations}


def main() -> int:
    """Run the named parts and print their rows; 1 if something is not as it should be."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", nargs="*", choices=("clone", "wheels", "size", *CHECKS, []))
    parser.add_argument("--dist", type=Path, default=ROOT / "dist", help="folder of the wheels (dist)")
    args = parser.parse_args()
    missed = 0
    for what in args.what or CHECKS:
        with tempfile.TemporaryDirectory() as text:
            folder = Path(text)
            if what in CHECKS:
                missed += CHECKS[what](folder)
            elif what == "size":
                print_sizes()
            else:
                rows = clone_rows(folder) if what == "clone" else wheel_rows(folder, args.dist)
                for name, wall_s, cpu_s in rows:
                    print(f"{name:<40}{wall_s:8.1f} s {cpu_s:8.1f} CPU-s", flush=True)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
