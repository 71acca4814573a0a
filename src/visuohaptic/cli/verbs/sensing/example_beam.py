"""``visuohaptic example beam``: a recording to try the beam sensor on.

reads
  nothing
writes, into --out
  sensor.yaml, beam.yaml     the sensor, and its rod as its data sheet has it
  camera.yaml, templates/    the camera, and the tags on base and rod
  rest.mp4, push.mp4         nothing touches the rod; forces along Y and Z, then a mixed load
  truth.csv                  t_s, fx_N, fy_N, fz_N, mx_Nm, my_Nm, mz_Nm of the physics, to compare with

example
  visuohaptic example beam --out try
  visuohaptic sense beam --config try/sensor.yaml --source try/rest.mp4 --zero
  visuohaptic sense beam --config try/sensor.yaml --source try/push.mp4 --csv try/run.csv --out try/run.mcap
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

__all__ = ["NEEDS", "add_arguments", "run"]

#: Modules beyond the core on its way.
NEEDS = ("av",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    parser.add_argument("--out", type=Path, required=True, help="folder")
    parser.add_argument("--seed", type=int, default=1, help="of the noise (1)")


def run(args: Any) -> dict[str, Any]:
    """Do it; the mapping is what ``--json`` prints."""
    from ....rigs.virtual_beam import write_beam_example

    folder = write_beam_example(args.out, seed=args.seed, say=args.report)
    files = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    args.report(f"written to {folder}: {', '.join(files)}")
    args.report("next: visuohaptic example beam --help shows what to do with them")
    return {"folder": str(folder), "files": files}
