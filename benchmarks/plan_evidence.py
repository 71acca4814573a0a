"""Plans on floors generated independently of the planner: time, cost, bounds, and execution in physics.

    python -m benchmarks.plan_evidence resolution idle --seeds open --count 10 --report out.jsonl
    python -m benchmarks.plan_evidence all --seeds closed --count 100 --report closed.jsonl
                                      print the table of each campaign

Each planning call runs in a child process, on one thread, with a hard limit of CPU time and memory; times are CPU times. Rows
are saved as they are computed and are not repeated. Even seeds are open for tuning, odd ones are opened once, at the end.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from ._journal import Journal
from ._plan_campaigns import CAMPAIGNS
from ._plan_child import Planner
from ._seeds import add_seeds, seeds_of

__all__ = ["main"]


def print_rows(rows: list[dict[str, Any]]) -> None:
    """The rows of a table."""
    for row in rows:
        value = row["ours"]
        said = "-" if value is None else f"{value:.4g}"
        limits = "  ".join(f"{name} {row[name]:g}" for name in ("floor", "aim") if row.get(name) is not None)
        print(f"{row['name']:<58}{said:>10} {row['unit']:<5} {limits:<24} {row.get('note', '')}", flush=True)


def main(arguments: list[str] | None = None) -> None:
    """Run campaigns and print their tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("campaign", nargs="+", choices=[*CAMPAIGNS, "all"])
    add_seeds(parser, 10, "seeds of each campaign")
    parser.add_argument("--report", type=Path, help="file of rows; those that it has are not made again")
    parser.add_argument("--budget", type=float, default=20.0, help="CPU seconds for one planning call")
    parser.add_argument("--memory", type=float, default=4.0, help="GB for one planning process")
    given = parser.parse_args(arguments)
    journal = Journal(
        given.report, {"benchmark": "plan_evidence", "seeds": given.seeds, "budget_s": given.budget}
    )
    planner = Planner(memory_bytes=int(given.memory * 2**30), budget_s=given.budget)
    try:
        for name in CAMPAIGNS if "all" in given.campaign else given.campaign:
            campaign = CAMPAIGNS[name]
            rows = {}
            for key in campaign.keys(seeds_of(given.seeds, given.count, given.first)):
                full = f"{name}:{key}"
                if full not in journal:
                    journal.put(full, campaign.play(planner, key))
                    print(f"{full} {journal.rows[full]}"[:200], file=sys.stderr, flush=True)
                rows[key] = journal.rows[full]
            print_rows(campaign.table(rows))
    finally:
        planner.close()


if __name__ == "__main__":
    main()
