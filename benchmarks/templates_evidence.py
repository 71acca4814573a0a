"""Wrong poses that the planar tracker reports as valid, on independent views: tilted to 60 degrees, 0-40 % covered.

``python -m benchmarks.templates_evidence --seeds open --count 450 --report views.jsonl`` prints their number,
the fraction of views tracked within 2 px, and the consistency of the declared covariance.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

import numpy as np
from tests.worlds.views import View, mapped, view

from benchmarks._journal import Journal
from visuohaptic.cli._arguments import Add
from visuohaptic.cli._workers import add_worker_arguments, chosen_workers
from visuohaptic.tracking.templates import EsmTemplate, align

#: A pose whose worst corner is further off than this is wrong [px].
WRONG_PX = 2.0


def measure(seen: View) -> dict:
    """Result of the tracker for one view."""
    found = align(EsmTemplate.from_image(seen.template), seen.image, seen.start)
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]) * (len(seen.template) - 1)
    off = (mapped(found.homography, square) - seen.corners).ravel()
    row = {
        "tilt_deg": float(np.rad2deg(seen.tilt_rad)),
        "covered": seen.covered,
        "start_px": seen.start_px,
        "valid": bool(found.valid),
        "reason": found.reason,
        "worst_px": float(np.hypot(*off.reshape(4, 2).T).max()),
    }
    if found.valid:
        row["chi2"] = float(off @ np.linalg.solve(found.corner_covariance, off) / 8)
    return row


def figures(rows: list[dict]) -> list[dict]:
    """Rows of the table."""
    worst = np.array([row["worst_px"] for row in rows])
    valid = np.array([row["valid"] for row in rows])
    wrong = valid & ~(worst <= WRONG_PX)
    chi2 = np.array([row["chi2"] for row, good in zip(rows, valid & ~wrong, strict=True) if good])
    parts = []
    for name, edges in (("tilt_deg", (0, 20, 40, 60)), ("covered", (0, 0.1, 0.2, 0.4))):
        value = np.array([row[name] for row in rows])
        for low, high in itertools.pairwise(edges):
            inside = (value >= low) & (value <= high)
            parts.append(
                f"{name} {low:g}-{high:g}: {valid[inside].sum()} of {inside.sum()} valid, {wrong[inside].sum()} wrong"
            )
    median = float(np.median(chi2)) if len(chi2) else float("nan")
    return [
        {
            "name": f"{len(rows)} views: kept valid beyond {WRONG_PX:g} px",
            "ours": 100.0 * float(wrong.mean()),
            "unit": "%",
            "floor": 1.0,
            "aim": 0.2,
            "note": "; ".join(parts),
        },
        {
            "name": "views that are followed within 2 px and valid",
            "ours": 100.0 * float((valid & ~wrong).mean()),
            "unit": "%",
            "note": f"{(~valid).sum()} refused, {(~valid & (worst <= WRONG_PX)).sum()} of them within 2 px",
        },
        {
            "name": "chi2 / 8 of the corners where right, median (0.92 if honest)",
            "ours": median,
            "unit": "",
            "note": f"root of the mean {float(np.sqrt(chi2.mean())) if len(chi2) else float('nan'):.2f}",
        },
    ]


def campaign(
    *, seeds: str = "open", count: int = 450, report: Path | None = None, workers: int | str = 1
) -> list[dict]:
    """Rows of all views; those in ``report`` are not measured again."""
    journal = Journal(report, {"campaign": "templates_evidence", "seeds": seeds})
    keys = [str(2 * i + (seeds == "closed")) for i in range(count)]
    journal.fill(_measured, {key: int(key) for key in keys}, workers)
    return [journal.rows[key] for key in keys]


def _measured(seed: int) -> dict:
    return measure(view(seed))


def run() -> list[dict]:
    """Rows of the table: closed seeds."""
    return figures(campaign(seeds="closed"))


def main() -> None:
    """Measure the views and print the figures."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.templates_evidence", description=__doc__)
    parser.add_argument("--seeds", choices=("open", "closed"), default="open")
    parser.add_argument("--count", type=int, default=450)
    parser.add_argument("--report", type=Path, help="JSON lines; a stopped campaign goes on where it was")
    add_worker_arguments(Add(parser))
    args = parser.parse_args()
    rows = campaign(seeds=args.seeds, count=args.count, report=args.report, workers=chosen_workers(args))
    for line in figures(rows):
        print(f"{line['name']}: {line['ours']:.3g} {line['unit']}  ({line['note']})")


if __name__ == "__main__":
    main()
