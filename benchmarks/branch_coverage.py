"""Branch coverage of each package by its own tests.

    python -m benchmarks.branch_coverage --packages core io database report viewer cli --report coverage.jsonl
                                      prints the fraction of branches taken in each package, and its least covered files

Runs ``tests/PACKAGE`` under coverage.py and counts only the branches of ``src/visuohaptic/PACKAGE``: code executed by the tests of
other packages, or in processes that tests start, does not count. Compiled functions are excluded,
because coverage.py cannot trace them; tests compare them with plain twins. Needs ``coverage`` (dependency group
``test``).
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from ._journal import Journal
from .house import ROOT

_CONFIG = """
[run]
branch = true
data_file = {folder}/data
source = {source}
[report]
exclude_also =
    @(numba\\.)?(kernel|njit|jit)
    if TYPE_CHECKING
    ^\\s*\\.\\.\\.$
[json]
output = {folder}/report.json
"""


def measure(package: str) -> dict[str, Any]:
    """Branches and lines of one package, those executed, and its files with the most missed branches."""
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder, "config")
        source = ROOT / "src" / "visuohaptic" / package
        config.write_text(_CONFIG.format(folder=folder, source=source), encoding="utf-8")
        tests = ["-m", "pytest", "-q", "-p", "no:cacheprovider", f"tests/{package}"]
        for words in (["run", f"--rcfile={config}", *tests], ["json", "-q", f"--rcfile={config}"]):
            done = subprocess.run(
                [sys.executable, "-m", "coverage", *words],
                cwd=ROOT,
                capture_output=True,
                text=True,
                check=False,
            )
            last = (done.stdout.strip().splitlines() or [done.stderr[-300:]])[-1]
            if words[0] == "run":
                tested = last
        found = json.loads(Path(folder, "report.json").read_text(encoding="utf-8"))
    missing = {
        Path(name)
        .relative_to(source.relative_to(ROOT) if not Path(name).is_absolute() else source)
        .as_posix(): (file["summary"]["num_branches"] - file["summary"]["covered_branches"])
        for name, file in found["files"].items()
    }
    totals = found["totals"]
    return {
        "branches": totals["num_branches"],
        "taken": totals["covered_branches"],
        "lines": totals["num_statements"],
        "executed": totals["covered_lines"],
        "not taken": dict(sorted(missing.items(), key=lambda item: -item[1])[:5]),
        "tests": tested,
    }


def main() -> None:
    """Run, or continue, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--packages", nargs="+", required=True)
    parser.add_argument("--report", type=Path)
    args = parser.parse_args()
    journal = Journal(args.report, {"campaign": "coverage"})
    print(f"{'package':16}{'branches':>10}{'taken':>8}{'lines':>10}{'executed':>10}  most branches not taken")
    for package in args.packages:
        if package not in journal:
            journal.put(package, measure(package))
        row = journal.rows[package]
        print(
            f"{package:16}{row['branches']:>10}{row['taken'] / max(row['branches'], 1):>8.1%}{row['lines']:>10}"
            f"{row['executed'] / max(row['lines'], 1):>10.1%}  "
            + ", ".join(f"{name} {count}" for name, count in row["not taken"].items() if count)
        )
        print(f"{'':16}{row['tests']}", flush=True)


if __name__ == "__main__":
    main()
