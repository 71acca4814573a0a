"""``visuohaptic objects build``: compute stiffness maps and features of whole container classes.

reads   a YAML plan (see `visuohaptic defaults build`):
          seed: 1
          around: 48
          states: [{closed: false}, {closed: true, fill: 0.5}]
          nonlinear: {around: 32, heights: [1, 4, 8, 12, 16]}   # as --nonlinear; optional
          classes:
            - {class: bottle, variants: 50}
            - {class: mine.yaml, variants: 20}
writes  DIR/CLASS/CLASS-00000.npz ... and DIR/manifest.json with versions and hashes

The features i, I, II are those of linear elasticity (I = i, II = 0) unless curves are requested; a curve takes a few
seconds per object. After an interruption, run the same command again: finished objects are kept, and the
content hash equals that of an uninterrupted build.

example: visuohaptic objects build classes.yaml --out objects --workers 2
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .... import deformation
from ....core.files.plain_json import picked
from ..._workers import add_worker_arguments, chosen_workers


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("classes", Path, "plan: classes, numbers of variants, seed")
    add("--out", Path, "folder to write to", required=True)
    add_worker_arguments(add)
    add("--nonlinear", bool, "features from force-deformation curves (i, I, II)")


def run(args: Any) -> dict[str, Any]:
    """Build; returns the mapping that ``--json`` prints."""
    import time

    workers = chosen_workers(args)
    begin = time.perf_counter()
    jobs = deformation.plan_jobs(*deformation.load_plan(args.classes, nonlinear=args.nonlinear))
    with args.progress(len(jobs), "objects") as bar:
        shown = 0

        def advance(done: int, _total: int) -> None:
            nonlocal shown
            bar.advance(done - shown)
            shown = done

        report = deformation.build(jobs, args.out, workers=workers, progress=advance)
    return {
        "folder": str(args.out),
        **picked(report, "objects computed content_sha256"),
        "kept": report.objects - report.computed,
        "failed": [{"file": file, "reason": reason} for file, reason in report.failed],
        "seconds": time.perf_counter() - begin,
    }
