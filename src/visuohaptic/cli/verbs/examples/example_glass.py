"""``visuohaptic example glass``: a depth sequence with transparent bottles to detect and complete by touch.

reads
  nothing
writes, into --out
  scan/                      about 40 depth images around a table with clear, labelled bottles; with --clear,
                             clear vessels without labels, for `visuohaptic complete --clear`
  truth.csv                  x_m, y_m, radius_m, height_m of each bottle

example
  visuohaptic example glass --out try
  visuohaptic reconstruct try/scan --out try/model --voxel-m 0.006 --space -0.4 -0.4 -0.02 0.4 0.4 0.3
  visuohaptic complete try/model/surface.ply --region try/model/regions.json --out try/completed.ply --next
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ....core import files
from ....simulation import tabletop

#: Of the simulated views: their distance on a circle [m], width [px], and the errors of their poses [m], [rad].
_STEP_M, _WIDTH_PX, _SIGMA_M, _SIGMA_RAD = 0.12, 160, 0.001, 0.002


def add_arguments(add: Any) -> None:
    """Arguments of the verb."""
    add("--out", Path, "folder to write to", required=True)
    add("--clear", bool, "clear vessels without labels, for `complete --clear`")
    add("--seed", 2, "seed of the scene and its noise (2)")


def run(args: Any) -> dict[str, Any]:
    """Run the verb; returns the mapping that ``--json`` prints."""
    import numpy as np

    from .example_foam import report_next

    scene = tabletop.glass_scene(
        args.seed, kind="thick" if args.clear else "labelled", arc_deg=360, step_m=_STEP_M
    )
    args.out.mkdir(parents=True, exist_ok=True)
    views = scene.save(
        args.out / "scan",
        tabletop.DepthCamera.kinect(_WIDTH_PX),
        np.random.default_rng(args.seed),
        pose_sigma_m=_SIGMA_M,
        pose_sigma_rad=_SIGMA_RAD,
    )
    rows = []
    for solid in scene.glass:
        x, y, _ = solid.foot_m
        radius_m = float(np.max(solid.radius_m(np.linspace(0.0, solid.height_m, 50))))
        rows.append([f"{value:.4f}" for value in (x, y, radius_m, solid.height_m)])
    files.write_csv(args.out / "truth.csv", ("x_m", "y_m", "radius_m", "height_m"), rows)
    args.report(f"{views} views of {len(scene.glass)} bottles written to {args.out}")
    report_next(args, args.out, "example glass")
    return {"folder": str(args.out), "views": views, "bottles": len(scene.glass)}
