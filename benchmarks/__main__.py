"""``python -m benchmarks [names]``: run benchmarks, print one table, write ``results/bench.json``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from . import harness


def main() -> int:
    """Run the named benchmarks, or all but the campaigns."""
    known = harness.benchmark_names()
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument(
        "names",
        nargs="*",
        metavar="name",
        help=f"of {', '.join(known)}; by default all but the campaigns {', '.join(harness.CAMPAIGNS)}",
    )
    parser.add_argument(
        "--out", type=Path, default=Path("results/bench.json"), help="machine-readable result"
    )
    parser.add_argument("--list", action="store_true", help="print the names and stop")
    parser.add_argument(
        "--compare",
        nargs="+",
        type=Path,
        metavar="REPORT",
        help="run nothing: the figures of reports of two commits, run in turn, before and after",
    )
    args = parser.parse_args()
    if args.list:
        print("\n".join(known))
        return 0
    if args.compare:
        print(harness.comparison([harness.read_rows(path) for path in args.compare]))
        return 0
    if unknown := sorted(set(args.names) - set(known)):
        parser.error(f"unknown benchmark {unknown[0]!r}, expected one of {', '.join(known)}")
    harness.use_one_thread()
    report = harness.run(args.names or [name for name in known if name not in harness.CAMPAIGNS])
    print(harness.table(report))
    if not args.names:
        print(f"\nnot run, they take long: python -m benchmarks {' '.join(harness.CAMPAIGNS)}")
    args.out.parent.mkdir(parents=True, exist_ok=True)
    harness.save(args.out, report)
    print(f"\nwritten to {args.out}")
    return 1 if any(row.verdict == "failed" for row in report.rows) else 0


if __name__ == "__main__":
    sys.exit(main())
