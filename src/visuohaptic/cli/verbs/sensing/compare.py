"""``visuohaptic compare``: compare a run with a scale, or with another run.

reads   RUN, a table that `sense foam` wrote (CSV or Parquet), and a reference: a second run, or the recording
        of a scale (CSV with t_s and mass_g, mass_kg or force_N; force_sigma_N where it is known)
writes  with --page, a page with both forces, their difference, and a check of the declared sigma

The clocks are aligned where the forces agree best; --offset 0 uses them as they are.
How to record a scale beside a strip: docs, Record a reference.

example: visuohaptic compare run.csv scale.csv --page compare.html
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .... import io, report
from ._reference import add_reference, checked_reference, reported


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("table", Path, "table of a run: .csv or .parquet", metavar="RUN")
    add_reference(add, "reference")


def run(args: Any) -> dict[str, Any]:
    """Compare; returns the mapping that ``--json`` prints."""
    reference = checked_reference(args, args.reference)
    table = io.read_force_table(args.table)
    record = report.ForceRecord(
        args.table.name, table.t_s, table.force_N, table.force_sigma_N, table.valid,
        tuple(reason.value for reason in table.reason),
    )  # fmt: skip
    return {"run": str(args.table), **reported(args, record, reference)}
