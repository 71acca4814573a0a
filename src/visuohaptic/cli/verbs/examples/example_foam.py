"""``visuohaptic example foam``: a recording to try the sensor on.

reads
  nothing
writes, into --out
  strain_stress.csv          what a press recorded of the foam
  camera.yaml, sensor.yaml   the camera, and the strip in front of it
  rest.mp4, push.mp4         the untouched strip; a cylinder pressed into it and taken back
  truth.csv                  t_s, force_N, depth_m of the physics, to compare with

example
  visuohaptic example foam --out try
  visuohaptic calibrate foam try/strain_stress.csv --width 0.02 --height 0.01 --out try/foam.yaml --plot try/foam.png
  visuohaptic sense foam --config try/sensor.yaml --source try/rest.mp4 --zero
  visuohaptic sense foam --config try/sensor.yaml --source try/push.mp4 --csv try/run.csv --out try/run.mcap
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

__all__ = ["NEEDS", "add_arguments", "report_files", "run", "written"]

#: Modules beyond the core on its way.
NEEDS = ("av",)


def add_arguments(add: Any) -> None:
    """Arguments of the verb.

    Parameters
    ----------
    add
        Of the verb.
    """
    add("--out", Path, "folder", required=True)
    add("--seed", 1, "of the noise (1)")


def written(args: Any, write: Callable[..., Path], verb: str) -> dict[str, Any]:
    """Write the recording; the mapping is what ``--json`` prints.

    Parameters
    ----------
    args
        With ``out`` and ``seed``.
    write
        Called with the folder, the seed and where to report.
    verb
        Its words.
    """
    return report_files(args, write(args.out, seed=args.seed, say=args.report), verb)


def report_files(args: Any, folder: Path, verb: str) -> dict[str, Any]:
    """Say what an example has written.

    Parameters
    ----------
    args
        With where to report.
    folder
        Of the files.
    verb
        Its words.
    """
    files = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    args.report(f"written to {folder}: {', '.join(files)}")
    args.report(f"next: visuohaptic {verb} --help shows what to do with them")
    return {"folder": str(folder), "files": files}


def run(args: Any) -> dict[str, Any]:
    """Do it; the mapping is what ``--json`` prints."""
    from ....rigs.foam_example import write_example

    return written(args, write_example, "example foam")
