"""Branch coverage of each package by its own tests.

    python -m benchmarks.branch_coverage --packages core io database report viewer cli --report coverage.jsonl
                                      prints the fraction of branches taken in each package, and its least covered files
    python -m benchmarks.branch_coverage --packages navigation --seconds 300 --report coverage.jsonl
                                      a slice; the next one continues it

Runs ``tests/PACKAGE`` under coverage.py and counts only the branches of ``src/visuohaptic/PACKAGE``: code executed by the tests of
other packages does not count; code in processes that the tests start does, unless they are killed. Compiled functions are excluded,
because coverage.py cannot trace them; tests compare them with plain twins. What each file of tests executes is kept beside the
report until that file or the package changes; the figure of a package of which some files were not run is a lower bound.
Needs ``coverage`` (dependency group ``test``).
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from ._covered import IMPORTED, VARIABLE
from ._journal import Journal
from .house import ROOT

_CONFIG = """
[run]
branch = true
source = {source}
disable_warnings = no-data-collected
[report]
exclude_also =
    @(numba\\.)?(kernel|njit|jit)
    if TYPE_CHECKING
    ^\\s*\\.\\.\\.$
"""


def _digest(*paths: Path) -> str:
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in paths)).hexdigest()[:12]


def measure(package: str, folder: Path, seconds: float = 1e9, root: Path = ROOT) -> dict[str, Any]:
    """Branches and lines of one package, those executed, and its files with the most missed branches.

    Parameters
    ----------
    package
        Name of the package.
    folder
        Keeps the data of each file of tests.
    seconds
        CPU time after which no file of tests is begun [s].
    root
        Folder of the project.
    """
    import coverage

    source = root / "src" / "visuohaptic" / package
    own = _digest(*sorted(source.rglob("*.py")))
    data = {
        path.relative_to(root).as_posix(): folder / f"{package}-{path.stem}-{_digest(path)}-{own}"
        for path in sorted((root / "tests" / package).rglob("test_*.py"))
    }
    missing = {name: str(path) for name, path in data.items() if not path.exists()}
    imported = folder / f"{package}-{IMPORTED}-{own}"
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        config = Path(temporary, "config")
        config.write_text(_CONFIG.format(source=source), encoding="utf-8")
        tested = "no tests"
        if missing:
            given = {"config": str(config), "files": missing | {IMPORTED: str(imported)}, "seconds": seconds}
            words = [
                sys.executable,
                "-m",
                "pytest",
                "-q",
                "-p",
                "no:cacheprovider",
                "-p",
                "benchmarks._covered",
            ]
            done = subprocess.run(
                [*words, f"tests/{package}"],
                cwd=root,
                env=os.environ | {VARIABLE: json.dumps(given)},
                capture_output=True,
                text=True,
                check=False,
            )
            tested = (done.stdout.strip().splitlines() or [done.stderr[-300:]])[-1]
        together = coverage.Coverage(data_file=None, config_file=str(config), messages=False)
        finished = [path for path in data.values() if path.exists()]
        together.combine([str(path) for path in [imported, *finished] if path.exists()], keep=True)
        report = Path(temporary, "report.json")
        together.json_report(outfile=str(report))
        found = json.loads(report.read_text(encoding="utf-8"))
    totals = found["totals"]
    if "num_branches" not in totals:
        raise SystemExit(f"branch_coverage: {package} was not imported by its tests ({tested})")
    not_taken = {
        Path(root, name).relative_to(source).as_posix(): (
            file["summary"]["num_branches"] - file["summary"]["covered_branches"]
        )
        for name, file in found["files"].items()
    }
    return {
        "branches": totals["num_branches"],
        "taken": totals["covered_branches"],
        "lines": totals["num_statements"],
        "executed": totals["covered_lines"],
        "not taken": dict(sorted(not_taken.items(), key=lambda item: -item[1])[:5]),
        "files": len(finished),
        "of files": len(data),
        "tests": tested,
    }


def main() -> None:
    """Run, or continue, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--packages", nargs="+", required=True)
    parser.add_argument("--seconds", type=float, default=1e9, help="of the processor, of each package")
    parser.add_argument("--report", type=Path, default=Path("results/coverage.jsonl"))
    args = parser.parse_args()
    journal = Journal(args.report, {"campaign": "coverage"})
    print(f"{'package':16}{'branches':>10}{'taken':>8}{'lines':>10}{'executed':>10}  most branches not taken")
    for package in args.packages:
        journal.put(package, measure(package, args.report.with_suffix(".data"), args.seconds))
        row = journal.rows[package]
        print(
            f"{package:16}{row['branches']:>10}{row['taken'] / max(row['branches'], 1):>8.1%}{row['lines']:>10}"
            f"{row['executed'] / max(row['lines'], 1):>10.1%}  "
            + ", ".join(f"{name} {count}" for name, count in row["not taken"].items() if count)
        )
        print(f"{'':16}{row['files']} of {row['of files']} files of tests; {row['tests']}", flush=True)


if __name__ == "__main__":
    main()
