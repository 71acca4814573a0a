"""``visuohaptic objects build``: stiffness maps and features of whole classes of containers."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

__all__ = ["EPILOG", "add_arguments", "needs", "run"]

EPILOG = """\
reads   a YAML plan:
          seed: 1
          around: 48
          states: [{closed: false}, {closed: true, fill: 0.5}]
          nonlinear: {around: 32, heights: [1, 4, 8, 12, 16]}   # as --nonlinear; optional
          classes:
            - {class: bottle, variants: 50}
            - {class: mine.yaml, variants: 20}
writes  DIR/CLASS/CLASS-00000.npz ... and DIR/manifest.json with versions and hashes

Features i, I, II are of linear elasticity (I = i, II = 0) unless curves are asked for: a few
seconds an object.

Run it again after it was interrupted or killed: what is done is kept, and the content hash is that
of an uninterrupted build.

example: visuohaptic objects build classes.yaml --out objects --jobs 2
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("classes", type=Path, help="plan: classes, numbers of variants, seed")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: %(default)s)")
    parser.add_argument(
        "--nonlinear", action="store_true", help="features from force-deformation curves (i, I, II)"
    )
    parser.add_argument("--cluster", metavar="ADDRESS", help="dask scheduler, like tcp://10.0.0.1:8786")


def needs(args: Any) -> set[str]:
    """Modules beyond the core: of the cluster, where one is named.

    Parameters
    ----------
    args
        As parsed.
    """
    return {"distributed"} if args.cluster else set()


def run(args: Any) -> dict[str, Any]:
    """Build; the mapping is what ``--json`` prints."""
    import time

    from ....core.errors import InputError
    from ....deformation.maps.build_plan import load_plan, plan_jobs
    from ....deformation.maps.class_build import build

    if not 1 <= args.jobs <= 1024:
        raise InputError("--jobs", f"found {args.jobs}, expected 1 to 1024")
    begin = time.perf_counter()
    jobs = plan_jobs(*load_plan(args.classes, nonlinear=args.nonlinear))
    with args.progress(len(jobs), "objects") as bar:
        shown = 0

        def advance(done: int, _total: int) -> None:
            nonlocal shown
            bar.advance(done - shown)
            shown = done

        report = build(jobs, args.out, workers=args.jobs, cluster=args.cluster, progress=advance)
    return {
        "folder": str(args.out),
        "objects": report.objects,
        "computed": report.computed,
        "kept": report.objects - report.computed,
        "failed": [{"file": file, "reason": reason} for file, reason in report.failed],
        "content_sha256": report.content_sha256,
        "seconds": time.perf_counter() - begin,
    }
