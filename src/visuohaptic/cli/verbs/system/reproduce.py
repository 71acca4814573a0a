"""``visuohaptic reproduce``: reproduce the dissertation's figures and tables.

reads   nothing: every experiment generates its own world from a seed
writes  a folder for each experiment with its data (CSV), plots (PNG) and result.json (our values
        and those of the dissertation, seed, versions), index.md with all of them, and experiments.csv
        with the resources that each of them used

Results of the same version and seed are kept. A failed experiment does not stop the others; its reason is
printed, and the exit code is 1.

example: visuohaptic reproduce figure-3.4 --out results/dissertation
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .... import reproduce
from ..._workers import add_worker_arguments, chosen_workers

#: Optional modules that the verb imports.
NEEDS = ("matplotlib",)
#: Fields of an experiment in the output of ``--json``.
_TOLD = ("name", "seconds", "cpu_seconds", "kept", "problem")


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("names", str, "figure-3.2, 3.4, table-6.1 ..., or all", nargs="+", metavar="NAME")
    add("--out", Path, "folder to write to, created if necessary", required=True)
    add("--seed", 0, "seed of everything random (0)")
    add("--quick", bool, "fewer samples, for a first look")
    add_worker_arguments(add, "one for each core")
    add("--gallery", Path, "also write gallery.md and images/gallery to this folder of the documentation", metavar="DOCS")  # fmt: skip
    add("--force", bool, "run again even if the same result is there")


def needs(args: Any) -> set[str]:
    """Optional modules that the experiments import.

    Parameters
    ----------
    args
        As parsed.
    """

    return {module for name in _selected(args.names) for module in reproduce.NEEDS.get(name, ())}


def _selected(names: list[str]) -> list[str]:
    return list(reproduce.EXPERIMENTS) if "all" in names else [reproduce.known_name(name) for name in names]


def run(args: Any) -> dict[str, Any]:
    """Run them, several at a time; returns the mapping that ``--json`` prints."""
    selected, workers = _selected(args.names), chosen_workers(args, 0)
    with args.progress(len(selected), "experiments") as progress:

        def tell(one: reproduce.ExperimentOutcome) -> None:
            state = f"failed: {one.problem}" if one.problem else "kept" if one.kept else "done"
            args.report(f"{one.name:<12} {one.seconds:6.1f} s  {state}")
            progress.advance(1, one.name)

        options = {name: getattr(args, name) for name in ("seed", "quick", "force")}
        outcomes = reproduce.reproduce_all(selected, args.out, workers=workers, on_done=tell, **options)
    index = reproduce.write_index(args.out)
    args.report(f"written to {index}")
    if args.gallery is not None:
        args.report(f"written to {reproduce.write_gallery(args.out, args.gallery)}")
    args.exit_code = 1 if any(one.problem for one in outcomes) else 0
    return {
        "index": str(index),
        "experiments": [{name: getattr(one, name) for name in _TOLD} for one in outcomes],
    }
