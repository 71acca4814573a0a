"""Meshes, readings and few curves of containers, compared with walls computed by another theory.

    python -m benchmarks.shell_evidence readings unknown --seeds open --count 24 --cache shells --report out.json
                                      prints recognition rates, false unknowns and calibration of each campaign

``readings``: objects of six classes on which a classifier was trained in simulation, in range, up to 30 % outside the
ranges, and with gripper errors (5 mm in height, 3 degrees, gain 5 %, zeros, modulus 12 %, heavy tails), with
widths and by stiffness alone. ``unknown``: objects of twenty kinds that are not in the training set. ``few_curves``: six
objects learned from five curves each, by a machine, and by hand with a scatter of 10 % and without widths. ``meshes``:
triangulated containers of fifteen kinds whose stiffness is known, and five meshes that are not containers. ``bound``: the best possible detection of unknown classes by stiffness alone, with
classifiers trained on many members of the unknown kinds (``--count`` of each and condition, on open seeds only). ``orders``: the
fewest touches that would have been sufficient, in hindsight.

The worlds are ``tests/worlds/shells.py`` and ``oval_shells.py``. The odd half of the seeds is closed: for the
reported figures, not for tuning. An interrupted campaign is continued; training data and the stiffness of the
objects (2 s each) are kept in the folder ``--cache``, answers beside the report.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.worlds.shell_meshes import KINDS, REFUSED
from tests.worlds.shell_touches import CONDITIONS, known_object, unknown_object

from visuohaptic.cli._arguments import Add
from visuohaptic.cli._workers import add_worker_arguments, chosen_workers
from visuohaptic.core.files import write_text
from visuohaptic.core.resources import one_blas_thread

from ._journal import Journal
from ._seeds import add_seeds, seeds_of
from ._shell_bound import bound_figures, bound_rows, order_figures, order_row
from ._shell_meshes import mesh_figures, mesh_row, refused_row
from ._shell_readings import (
    VARIANTS,
    few_figures,
    few_row,
    known_row,
    reading_figures,
    train,
    unknown_figures,
    unknown_row,
)

CAMPAIGNS = ("readings", "unknown", "few_curves", "meshes", "bound", "orders")
#: Objects of a campaign, and the function evaluated for each.
ASKED = {
    "readings": (known_object, known_row),
    "unknown": (unknown_object, unknown_row),
    "orders": (known_object, order_row),
}
#: Floors and aims of right, false unknown and calibration error.
LIMITS = {
    "in range": ((0.97, 0.99), (0.02, 0.01), (0.05, 0.04)),
    "outside": ((0.93, 0.96), (0.04, 0.02), (0.07, 0.04)),
    "nuisances": ((0.90, 0.95), (0.07, 0.03), (0.08, 0.04)),
}
UNKNOWN_LIMITS = {True: (0.95, 0.99), False: (0.85, 0.95)}


def recognition(
    name: str,
    chosen: Sequence[int],
    cache: Path,
    *,
    journal: Path | None = None,
    conditions: Sequence[str] = tuple(CONDITIONS),
    widths: Sequence[bool] = (True, False),
    variants: int = VARIANTS,
) -> list[dict[str, Any]]:
    """Rows of ``readings``, ``unknown`` or ``orders``; those in the journal are not measured again."""
    done = Journal(journal, {"campaign": f"shell {name}", "variants": variants})
    classifier = None
    rows = []
    for seed in chosen:
        for condition in conditions:
            for use_width in widths:
                key = f"{seed} {condition} {'width' if use_width else 'plain'}"
                if key not in done:
                    classifier = classifier or train(cache, variants)
                    objects, asked = ASKED[name]
                    thing = objects(seed, condition, cache / "objects")
                    done.put(key, asked(classifier, thing, seed, use_width=use_width))
                rows.append({"seed": seed, "condition": condition, "width": use_width, **done.rows[key]})
        print(f"{name}: seed {seed}", flush=True)
    return rows


def few(
    chosen: Sequence[int], cache: Path | None = None, journal: Path | None = None
) -> list[dict[str, Any]]:
    """Rows of ``few_curves``."""
    done = Journal(journal, {"campaign": "shell few_curves"})
    for seed in chosen:
        if str(seed) not in done:
            done.put(str(seed), few_row(seed, cache and cache / "objects"))
    return [done.rows[str(seed)] for seed in chosen]


def meshes(
    chosen: Sequence[int], kinds: Sequence[str] = (), journal: Path | None = None, workers: int | str = 1
) -> list[dict[str, Any]]:
    """Rows of ``meshes``: every kind for every seed."""
    done = Journal(journal, {"campaign": "shell meshes"})
    tasks = {f"{seed} {kind}": (seed, kind) for seed in chosen for kind in kinds or (*KINDS, *REFUSED)}
    done.fill(_mesh_or_refused, tasks, workers)
    return [{"seed": seed, **done.rows[key]} for key, (seed, _) in tasks.items()]


def _mesh_or_refused(task: tuple[int, str]) -> dict[str, Any]:
    seed, kind = task
    return mesh_row(kind, seed) if kind in KINDS else refused_row(kind, seed)


def summary(name: str, rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Figures of a campaign."""
    if name == "few_curves":
        return few_figures(rows)
    if name == "meshes":
        return mesh_figures(rows)
    if name == "bound":
        return bound_figures(rows)
    figures = []
    for use_width in (True, False):
        for condition in CONDITIONS:
            some = [row for row in rows if row["condition"] == condition and row["width"] == use_width]
            if not some:
                continue
            label = f"{condition}, {'with widths' if use_width else 'stiffness alone'}"
            if name == "orders":
                figures += order_figures(some, label)
            elif name == "readings":
                figures += reading_figures(some, label, LIMITS[condition])
            else:
                figures += unknown_figures(some, f"unknown, {label}", UNKNOWN_LIMITS[use_width])
    return figures


def run() -> list[dict[str, Any]]:
    """A slice: six open objects."""
    with TemporaryDirectory() as folder:
        return summary("readings", recognition("readings", range(0, 12, 2), Path(folder), widths=(True,)))


def main() -> None:
    """Run the campaigns named on the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.shell_evidence",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("campaigns", nargs="*", default=["readings", "unknown"], choices=CAMPAIGNS)
    add_seeds(parser, 24, "objects")
    parser.add_argument("--conditions", nargs="+", choices=list(CONDITIONS), default=list(CONDITIONS))
    parser.add_argument("--no-width", action="store_true", help="by stiffness alone only")
    parser.add_argument("--width", action="store_true", help="with widths only")
    parser.add_argument(
        "--kinds", nargs="+", default=[], choices=[*KINDS, *REFUSED], help="only these meshes"
    )
    parser.add_argument("--variants", type=int, default=VARIANTS, help="training objects of a class")
    parser.add_argument("--cache", type=Path, help="folder that keeps training data and objects")
    parser.add_argument("--report", type=Path, help="JSON with all rows and figures")
    add_worker_arguments(Add(parser))
    arguments = parser.parse_args()
    widths = [use for use in (True, False) if not (arguments.no_width if use else arguments.width)]
    chosen = seeds_of(arguments.seeds, arguments.count, arguments.first)
    report: dict[str, Any] = {}
    with TemporaryDirectory() as scratch, one_blas_thread():
        cache = arguments.cache or Path(scratch)
        for name in arguments.campaigns:
            journal = arguments.report and arguments.report.with_name(
                f"{arguments.report.stem}_{name}_{arguments.seeds}.jsonl"
            )
            if name == "few_curves":
                rows = few(chosen, cache, journal)
            elif name == "meshes":
                rows = meshes(chosen, arguments.kinds, journal, chosen_workers(arguments))
            elif name == "bound":
                rows = bound_rows(arguments.count, cache / "members")
            else:
                rows = recognition(
                    name, chosen, cache, journal=journal, conditions=arguments.conditions,
                    widths=widths, variants=arguments.variants,
                )  # fmt: skip
            report[name] = {"rows": rows, "figures": summary(name, rows)}
            for row in report[name]["figures"]:
                limits = f"floor {row['floor']}  aim {row['aim']}"
                print(f"{row['name']:58s} {row['ours']:7.3f}  {limits}  {row['note']}")
    if arguments.report:
        write_text(arguments.report, json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
