"""The first hour with the library on a new machine: times, sizes, and what new users expect to find.

    python -m benchmarks.first_hour clone            fresh clone, empty kernel cache: ``make demo``, installation timed apart
    python -m benchmarks.first_hour wheels           the wheels of ``make wheel`` in a new environment: first force of the quick start
    python -m benchmarks.first_hour size             installed sizes of the core and of the extras, from this environment
    python -m benchmarks.first_hour expectations     20 expectations of new users, each with the test that proves it

``clone`` and ``wheels`` create their environments in a temporary folder and need the package index. ``python -m benchmarks.cold_start``
measures the compilation of the kernels.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

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

#: (expectation of a new user, whether it is met, tests that show it)
EXPECTATIONS = (
    ("force in newtons with a standard deviation", "yes", "tests/cli/test_start.py"),
    ("a live page in the browser", "yes", "tests/viewer/test_page.py"),
    ("complete types", "yes", "tests/test_package.py"),
    ("reproducible seeds", "yes", "tests/test_golden.py"),
    ("benchmarks against named peers", "yes", "tests/benchmarks/test_harness.py"),
    ("installation with pip", "partly: the wheels are built and tested, but not published", "tests/docs/test_readme.py"),
    ("sensible defaults", "yes", "tests/cli/test_defaults.py"),
    ("progress with the remaining time, without a terminal too", "yes", "tests/cli/test_console.py"),
    ("plots of every result", "yes", "tests/cli/test_help_examples.py"),
    ("documentation that is complete and tested", "yes", "tests/docs/test_blocks.py tests/docs/test_site.py"),
    ("effective configuration as a file", "yes", "tests/cli/test_defaults.py"),
    ("replay of recordings, SQLite bags included", "yes", "tests/io/test_sqlite_bag.py"),
    ("ROS 2", "yes", "tests/ros/test_node.py"),
    ("USB cameras with fixed focus and exposure", "yes", "tests/io/test_live.py"),
    ("RealSense and Orbbec cameras", "yes", "tests/io/test_depth_live.py tests/cli/test_recording_capture.py"),
    ("a citation", "yes", "tests/test_package.py"),
    ("errors that name the cause and the remedy", "yes", "tests/cli/test_misuse.py tests/cli/test_bad_files.py"),
    ("public data sets", "yes", "tests/docs/test_data_sets.py"),
    ("a demo within a minute", "yes", "tests/demo/test_recorded.py"),
    ("notebooks", "yes", "tests/docs/test_notebooks.py"),
)  # fmt: skip


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


def main() -> int:
    """Run one part and print its rows."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("clone", "wheels", "size", "expectations"))
    parser.add_argument("--dist", type=Path, default=ROOT / "dist", help="folder of the wheels (dist)")
    args = parser.parse_args()
    if args.what == "size":
        print_sizes()
    elif args.what == "expectations":
        for what, answer, tests in EXPECTATIONS:
            print(f"{what:<60}{answer:<10}  {tests}")
    else:
        with tempfile.TemporaryDirectory() as text:
            folder = Path(text)
            rows = clone_rows(folder) if args.what == "clone" else wheel_rows(folder, args.dist)
            for what, wall_s, cpu_s in rows:
                print(f"{what:<40}{wall_s:8.1f} s {cpu_s:8.1f} CPU-s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
