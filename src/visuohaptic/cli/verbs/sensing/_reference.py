"""The reference that a measured force is compared with: options, file and page of the verbs that compare."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from .... import report
from ....core.errors import InputError
from ....core.files import check_target
from ....core.files.plain_json import picked
from ....io import sinks


def add_reference(add: Any, reference: str) -> None:
    """Options of a reference.

    Parameters
    ----------
    add
        Of the verb.
    reference
        Name of the argument that names the file.
    """
    text = "what a scale or another sensor recorded: CSV with t_s and force_N, mass_g or mass_kg"
    add(reference, Path, text, metavar="REFERENCE")
    add("--page", Path, "page with the comparison to write (HTML)")
    add(
        "--offset", float, "time of the reference at time 0 of the run [s]; estimated by default", metavar="S"
    )
    add("--max-offset", 2.0, "maximum offset between the clocks [s] (2)", metavar="S")


def checked_reference(args: Any, path: Path) -> report.ForceRecord:
    """The reference, read before anything is measured.

    Parameters
    ----------
    args
        With ``page``, ``offset`` and ``max_offset``.
    path
        Of the reference.

    Raises
    ------
    InputError
        It cannot be read, or an option cannot be.
    """
    import numpy as np

    if args.page:
        check_target(args.page, (".html", ".htm"))
    if args.offset is not None and not math.isfinite(args.offset):
        raise InputError("--offset", f"found {args.offset:g}, expected a finite time")

    columns = sinks.read_reference_table(path)
    known = np.isfinite(columns["force_N"])
    return report.ForceRecord(path.name, columns["t_s"], columns["force_N"], columns["sigma_N"], known)


def reported(args: Any, run: report.ForceRecord, reference: report.ForceRecord) -> dict[str, Any]:
    """Compare, report, write the page; returns the mapping that ``--json`` prints.

    Parameters
    ----------
    args
        With ``page``, ``offset``, ``max_offset`` and ``report``.
    run
        What was measured.
    reference
        From :func:`checked_reference`.
    """

    found = report.compare_forces(run, reference, offset_s=args.offset, max_offset_s=args.max_offset)
    for line in found.lines():
        args.report(line)
    if args.page:
        args.report(f"page written to {report.write_comparison(found, args.page)}")
    return {
        "reference": reference.name,
        **picked(
            found,
            "compared read offset_s offset_sigma_s bias_N rms_N gain gain_sigma rms_over_sigma coverage_90",
        ),
        "page": str(args.page) if args.page else None,
    }
